"""The figure of a plan: path and executions beside the success probability."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from needleplan.plotting import legend_below, save, sheet

if TYPE_CHECKING:
    from needleplan.planning._poses import Entry, Pose
    from needleplan.planning._table import PolicyTable

__all__ = ["draw_plan"]

_NOISY_PATHS = 40  # number of executions with noise in the figure


def draw_plan(table: PolicyTable, start: Entry[Pose] | Pose, file: str | os.PathLike[str]) -> None:
    """Draw the path and 40 executions from a start, beside the success probability of every position.

    Parameters
    ----------
    table : PolicyTable
        The plan.
    start : Entry or Pose
        Where the needle begins.
    file : str or path
        The file, which must end in .png, .pdf or .svg. An existing file is replaced.

    Raises
    ------
    PoseError
        If `start` lies outside of the workspace.
    OutputError
        If the file has another ending or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import needleplan as npl
    >>> from needleplan.planning import draw_plan
    >>> table = npl.plan("four_obstacles")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     draw_plan(table, table.best_entry(), Path(folder) / "plan.png")
    """
    figure, (executions, success) = sheet(table.scenario.workspace, 2)
    table.rollout(start, runs=_NOISY_PATHS).plot(executions)
    legend_below(table.path(start).plot(executions, scene=False))
    table.plot(success)
    save(figure, file)
