"""The page of a plan as a widget of a notebook: a frame that holds the exported page, without a server."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

from needleplan.artifacts import write_whole
from needleplan.errors import InputError, Mistake
from needleplan.page._answers import Opened, Page
from needleplan.page._space_answers import SpacePage
from needleplan.planning import Entry, PolicyTable, Pose, SpaceTable
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["PlanView", "view"]

# Heights (pixels) of the frame: default, and limits beyond which a page cannot be used.
_HEIGHT, _LOWEST, _HIGHEST = 760, 200, 4000


@dataclass(frozen=True)
class PlanView:
    """The page of one plan; a notebook shows it as an interactive frame.

    Parameters
    ----------
    html : bytes
        The page as one file, which loads nothing from elsewhere.
    title : str
        What the frame shows, for screen readers.
    height_px : int
        Height of the frame in pixels.
    """

    html: bytes = field(repr=False)
    title: str
    height_px: int

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the page to a file, which a browser opens without a server.

        Parameters
        ----------
        path : str or path
            The file. An existing file is replaced.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        write_whole(path, self.html)

    def _repr_html_(self) -> str:
        content = escape(self.html.decode(), quote=True)
        style = f"width: 100%; height: {self.height_px}px; border: 0"
        return f'<iframe title="{escape(self.title, quote=True)}" style="{style}" srcdoc="{content}"></iframe>'


def view(
    plan: PolicyTable | SpaceTable | Scenario | str | os.PathLike[str],
    start: Entry | Pose | Sequence[float] | None = None,
    *,
    height_px: int = _HEIGHT,
) -> PlanView:
    """Return the page of a plan, which a notebook shows as an interactive frame.

    The page has the plan, its executions and the values under the pointer. It holds a copy of the plan: it does not
    plan again. `needleplan view` opens a page that does.

    Parameters
    ----------
    plan : PolicyTable, SpaceTable, Scenario, str or path
        The plan, in the plane or in space; or a scenario, a scenario file or the name of a shipped one, which is
        solved.
    start : Entry, Pose or sequence of float, optional
        Where the needle begins. Default: the best entry on the left edge. In space the page has the ranked entries.
    height_px : int, default 760
        Height of the frame in pixels, from 200 to 4000.

    Returns
    -------
    PlanView
        The page; `.write(path)` writes it to a file.

    Raises
    ------
    ScenarioError
        If a scenario file cannot be read or breaks a rule.
    PoseError
        If `start` is no pose, or lies outside of the workspace.
    InputError
        If the height is outside of its range, or a start is given with a plan in space.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.view(npl.plan("four_obstacles"), height_px=600)
    PlanView(title='Four obstacles', height_px=600)
    """
    if not _LOWEST <= height_px <= _HIGHEST:
        rule = f"must be a number of pixels from {_LOWEST} to {_HIGHEST}"
        raise InputError(Mistake("height_px", f"{height_px}", rule))
    if isinstance(plan, SpaceTable):
        if start is not None:
            raise InputError(
                Mistake("start", str(start), "must not be given in space: the page has the ranked entries")
            )
        return PlanView(_html(SpacePage(plan, "")), plan.scenario.title or "A plan", height_px)
    pose = start.pose if isinstance(start, Entry) else None if start is None else Pose.of(start)
    if isinstance(plan, PolicyTable):
        opened = Opened(plan.scenario, "", plan, pose)
    elif isinstance(plan, Scenario):
        opened = Opened(plan, "", start=pose)
    else:
        opened = Opened(Scenario.read(plan), os.fspath(plan), start=pose)
    return PlanView(_html(Page(opened)), opened.scenario.title or "A plan", height_px)


def _html(page: Page | SpacePage) -> bytes:
    try:
        return page.page(page.start())
    finally:
        page.close()
