"""Plans in 3D: of a whole lattice, or of the part that a needle on its way can still use."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy import SpaceScenario
from needleplan.errors import ScenarioError
from needleplan.planning._lattice import Progress, compiled_call
from needleplan.planning._space_file import SpaceContent, solved_in_file
from needleplan.planning._space_part import PartialSpace, part_ahead
from needleplan.planning._space_places import exceeds_memory
from needleplan.planning._space_pose import SpacePose
from needleplan.planning._space_problem import space_of
from needleplan.planning._space_table import SpaceTable

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["SpaceTask", "plan_ahead", "plan_space"]


@dataclass(frozen=True)
class SpaceTask:
    """A plan to make during an insertion: a scenario, and the pose from which on it is needed."""

    scenario: SpaceScenario
    start: SpacePose


def plan_ahead(task: SpaceTask, *, threads: int | None = None) -> SpaceTable:
    """Plan again during an insertion, only where the needle can still get to.

    The solver works on the box that holds all paths from the pose to the target; `_space_part.py` gives its equation.

    Parameters
    ----------
    task : SpaceTask
        Scenario, and the present pose of the tip.
    threads : int, optional
        Number of threads of the solver. Default: all processors.

    Returns
    -------
    SpaceTable
        Table of the scenario; outside of the box it has no values.
    """
    part, corner = part_ahead(task.scenario, task.start.position_mm)
    solved, grid = space_of(part).solve(threads=threads), part.grid
    spacing = grid.frame.spacing_mm
    box = PartialSpace(solved, corner.astype(np.float64) * spacing, spacing, grid.frame.shape, grid.voxel_mm)
    return SpaceTable(task.scenario, box)


def plan_space(
    scenario: SpaceScenario,
    *,
    file: str | os.PathLike[str] | None = None,
    sign_key: bytes | None = None,
    streamed: bool | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SpaceTable:
    """Solve a scenario in space.

    Parameters
    ----------
    scenario : SpaceScenario
        What is planned.
    file : path, optional
        File that the table is written to, as by `SpaceTable.write`, with what executions show of its best entries.
        Default: none.
    sign_key : bytes, optional
        Secret key that signs the file. Default: not signed.
    streamed : bool, optional
        Whether each slice is written to `file`, or to a temporary file, when it is finished, so that the tables need no
        memory. Default: if they need more than half of the available memory.
    threads : int, optional
        Number of threads. Default: all processors.
    progress : callable, optional
        Called with reports of the solver. Default: none.

    Returns
    -------
    SpaceTable
        Mapped from the file if `streamed`.

    Raises
    ------
    ScenarioError
        If the problem cannot be compiled.
    OutputError
        If the file cannot be written, or `progress` ended a solve that writes a file. A file that was there before is
        then unchanged.
    """
    space = space_of(scenario)
    if exceeds_memory(tuple(space.shape)) if streamed is None else streamed:
        content = solved_in_file(
            scenario, space, file, sign_key, estimates=_estimates, threads=threads, progress=progress
        )
        return SpaceTable.of_content(content)
    table = SpaceTable(scenario, compiled_call(ScenarioError, space.solve, threads=threads, progress=progress))
    if file is not None:
        table.best_entry()
        table.write(file, sign_key=sign_key, force=True)
    return table


def _estimates(content: SpaceContent) -> NDArray[np.float64]:
    """Return the rows of the estimates that decide on the best entry."""
    table = SpaceTable.of_content(content)
    table.best_entry()
    return table.estimates.rows()
