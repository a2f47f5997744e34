"""The page of a plan or of a diagnosis as a widget of a notebook: a frame that holds it, without a server."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, cast

from needleplan.artifacts import write_whole
from needleplan.errors import InputError, Mistake
from needleplan.page._answers import Opened, Page
from needleplan.page._diagnosis_answers import DiagnosisPage
from needleplan.page._diagnosis_file import DiagnosisFile, is_diagnosis
from needleplan.page._server import AnyPage
from needleplan.page._space_answers import SpacePage
from needleplan.planning import Entry, PolicyTable, Pose, SpaceTable
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

    from needleplan.diagnosis import Diagnosis

__all__ = ["PlanView", "view"]

# Heights (pixels) of the frame: default, and limits beyond which a page cannot be used.
_HEIGHT, _LOWEST, _HIGHEST = 760, 200, 4000


@dataclass(frozen=True)
class PlanView:
    """The page of one plan or diagnosis; a notebook shows it as an interactive frame.

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
    plan: PolicyTable | SpaceTable | Scenario | Diagnosis | str | os.PathLike[str],
    start: Entry[Pose] | Pose | Sequence[float] | None = None,
    *,
    height_px: int = _HEIGHT,
) -> PlanView:
    """Return the page of a plan or of a diagnosis, which a notebook shows as an interactive frame.

    The page of a plan has its executions and the values under the pointer. It holds a copy of the plan: it does not
    plan again. `needleplan view` opens a page that does. The page of a diagnosis has the curves of every trial before
    and after.

    Parameters
    ----------
    plan : PolicyTable, SpaceTable, Scenario, Diagnosis, str or path
        The plan, in the plane or in 3D; or a scenario, a scenario file or the name of a shipped one, which is
        solved; or a diagnosis, or the folder that `needleplan diagnose` has written.
    start : Entry, Pose or sequence of float, optional
        Where the needle begins. Default: the best entry on the left edge. In 3D the page has the ranked entries.
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
    DataError
        If a folder holds no diagnosis, or the diagnosis is damaged.
    InputError
        If the height is outside of its range, or a start is given with a 3D plan or with a diagnosis.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.view(npl.plan("four_obstacles"), height_px=600)
    PlanView(title='Four obstacles', height_px=600)
    """
    if not _LOWEST <= height_px <= _HIGHEST:
        rule = f"must be a number of pixels from {_LOWEST} to {_HIGHEST}"
        raise InputError(Mistake("height_px", f"{height_px}", rule))
    found = _diagnosis(plan)
    if found is not None:
        if start is not None:
            raise InputError(Mistake("start", str(start), "must not be given with a diagnosis"))
        page = DiagnosisPage(found)
        return PlanView(_html(page), page.start()["title"], height_px)
    if isinstance(plan, SpaceTable):
        if start is not None:
            raise InputError(Mistake("start", str(start), "must not be given in 3D: the page has the ranked entries"))
        return PlanView(_html(SpacePage(plan, "")), plan.scenario.title or "A plan", height_px)
    pose = start.pose if isinstance(start, Entry) else None if start is None else Pose.of(start)
    if isinstance(plan, PolicyTable):
        opened = Opened(plan.scenario, "", plan, pose)
    elif isinstance(plan, Scenario):
        opened = Opened(plan, "", start=pose)
    else:
        file = cast("str | os.PathLike[str]", plan)
        opened = Opened(Scenario.read(file), os.fspath(file), start=pose)
    return PlanView(_html(Page(opened)), opened.scenario.title or "A plan", height_px)


def _diagnosis(given: PolicyTable | SpaceTable | Scenario | Diagnosis | str | os.PathLike[str]) -> DiagnosisFile | None:
    """Return the diagnosis that was given, as an object or as a folder; None for something else."""
    if isinstance(given, str | os.PathLike):
        return DiagnosisFile.read(given) if is_diagnosis(os.fspath(given)) else None
    module = sys.modules.get("needleplan.diagnosis")  # a diagnosis cannot be there without its module
    if module is None or not isinstance(given, module.Diagnosis):
        return None
    from needleplan.reports.diagnosis import next_trials_of, whole_document

    return DiagnosisFile.of(*whole_document(given, next_trials_of(given)))


def _html(page: AnyPage) -> bytes:
    try:
        return page.page(page.start())
    finally:
        page.close()
