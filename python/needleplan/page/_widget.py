"""The page of a plan or of a diagnosis as a widget of a notebook: a frame that holds it, without a server."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING

from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.artifacts import FileKind, file_format, write_whole
from needleplan.errors import InputError, Mistake
from needleplan.page._answers import Opened, Page
from needleplan.page._diagnosis_answers import DiagnosisPage
from needleplan.page._diagnosis_file import DiagnosisFile, is_diagnosis
from needleplan.page._server import AnyPage
from needleplan.page._space_answers import SpacePage
from needleplan.planning import Entry, PolicyTable, Pose, SpaceTable, Table, read_problem
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from needleplan.diagnosis import Diagnosis

__all__ = ["PlanView", "page_of", "view"]

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
    plan: Table | Scenario | Anatomy | Diagnosis | str | os.PathLike[str],
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
    plan : Table, Scenario, Anatomy, Diagnosis, str or path
        The plan, in the plane or in 3D; or a scenario or an anatomy, which is solved; or a diagnosis; or the path of
        one of them, the folder that `needleplan diagnose` has written, or the name of a shipped scenario.
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
    if not isinstance(height_px, int) or not _LOWEST <= height_px <= _HIGHEST:
        rule = f"must be a number of pixels from {_LOWEST} to {_HIGHEST}"
        raise InputError(Mistake("height_px", f"{height_px}", rule))
    found = _diagnosis(plan)
    if found is not None:
        if start is not None:
            raise InputError(Mistake("start", str(start), "must not be given with a diagnosis"))
        page = DiagnosisPage(found)
        return PlanView(_html(page), page.title, height_px)
    opened, source = (_read(plan), os.fspath(plan)) if isinstance(plan, str | os.PathLike) else (plan, "")
    shown = page_of(opened, source, start)
    return PlanView(_html(shown), shown.title or "A plan", height_px)


def _read(path: str | os.PathLike[str]) -> Table | Scenario | Anatomy:
    return Table.read(path) if file_format(path).kind is FileKind.TABLE else read_problem(path)


_Start = Entry[Pose] | Pose | Sequence[float] | None


@singledispatch
def page_of(plan: object, source: str = "", start: _Start = None) -> AnyPage:  # noqa: ARG001
    """Return the page of a table, a scenario or an anatomy.

    Parameters
    ----------
    plan : object
        Table, scenario or anatomy.
    source : str, optional
        File from which it was read.
    start : Pose, Entry or sequence of float, optional
        Pose or entry at which the shown path begins, in the plane.

    Returns
    -------
    Page or SpacePage

    Raises
    ------
    InputError
        The start is wrong, or `plan` is something else.
    """
    rule = "must be a table, a scenario, an anatomy, a diagnosis, or the path of one of them"
    raise InputError(Mistake("plan", f"<{type(plan).__name__}>", rule))


@page_of.register(PolicyTable)
def _of_table(table: PolicyTable, source: str = "", start: _Start = None) -> AnyPage:
    return Page(Opened(table.scenario, source, table, _pose(start)))


@page_of.register(Scenario)
def _of_scenario(scenario: Scenario, source: str = "", start: _Start = None) -> AnyPage:
    return Page(Opened(scenario, source, start=_pose(start)))


@page_of.register(SpaceTable)
def _of_space_table(table: SpaceTable, source: str = "", start: _Start = None) -> AnyPage:
    _require_no_start(start)
    return SpacePage(table.scenario, source, table=table)


@page_of.register(Anatomy)
def _of_anatomy(anatomy: Anatomy, source: str = "", start: _Start = None) -> AnyPage:
    _require_no_start(start)
    return SpacePage(next(iter(SpaceScenario.of_targets(anatomy).values())), source, anatomy)


def _pose(start: _Start) -> Pose | None:
    return start.pose if isinstance(start, Entry) else None if start is None else Pose.of(start)


def _require_no_start(start: _Start) -> None:
    if start is not None:
        rule = "holds for a plan in a plane; in 3D, choose an entry in the page"
        raise InputError(Mistake("start", str(start), rule))


def _diagnosis(given: object) -> DiagnosisFile | None:
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
