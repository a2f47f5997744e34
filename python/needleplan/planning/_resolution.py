"""Whether the grid of a plan resolves what the plan uses, and whether executions keep its promise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import ShortRepr
from needleplan.planning._lattice import heading_variance, success_refinement
from needleplan.planning._success import Success, SuccessSource
from needleplan.scenario import Scenario, Transition

if TYPE_CHECKING:
    from collections.abc import Iterator

    from shapely.geometry.base import BaseGeometry

    from needleplan.planning._contract import Table
    from needleplan.planning._execution import Path, Rollouts
    from needleplan.planning._poses import Entry, Pose

__all__ = ["PROMISE_RUNS", "Resolution", "disagrees", "resolution", "resolution_of", "what_helps"]

PROMISE_RUNS = 500
"""Number of executions by which a plan checks its promise."""

# Difference of predicted and realised success below which nothing is remarked.
_POINTS = 0.02

# Standard deviations of the realised success within which a difference counts as chance.
_CHANCE = 3.0

# Cells of the grid across a passage, or across the target, below which it is not resolved.
_CELLS = 2.0


@dataclass(frozen=True, repr=False)
class Resolution(ShortRepr):
    """Resolution of the grid of a plan, and the predicted success beside that of executions.

    Attributes
    ----------
    predicted : float
        Success probability of the entry, by the table.
    realised : Success
        Success of executions from the entry.
    target_cells : float
        Diameter of the target, in cells of the solve across the path.
    passage_mm : float
        Width of the narrowest passage between obstacles, or an obstacle and the border, on the path without noise from
        the entry; inf without obstacles beside it.
    passage_cells : float
        The same in cells of the solve.
    noise_ratio : float
        Variance of the heading of a step in the solve, divided by that of `motion.tip_noise`; inf if only the solve has
        noise.
    warnings : tuple of str
        What is not resolved, and what helps; empty if all is well.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> npl.planning.resolution(table, table.best_entry()).warnings
    ()
    """

    predicted: float
    realised: Success
    target_cells: float
    passage_mm: float
    passage_cells: float
    noise_ratio: float
    warnings: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """Return the JSON record: all numbers by name, None for infinite numbers.

        Returns
        -------
        dict

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> npl.planning.resolution(table, table.best_entry()).record()["noise_ratio"]
        1.0
        """
        numbers = {name: getattr(self, name) for name in ("target_cells", "passage_mm", "passage_cells", "noise_ratio")}
        finite = {name: number if math.isfinite(number) else None for name, number in numbers.items()}
        return {**self.realised.record("realised"), **finite, "warnings": list(self.warnings)}


def resolution(table: Table, entry: Entry[Pose] | Pose, runs: int = PROMISE_RUNS, seed: int = 0) -> Resolution:
    """Check whether the grid of a table is fine enough for the target, passages and tip noise from an entry.

    Parameters
    ----------
    table : PolicyTable
        A table of the plane.
    entry : Entry or Pose
        Where the executions begin.
    runs, seed : int, optional
        Number of executions, and seed of their noise.

    Returns
    -------
    Resolution

    Raises
    ------
    PoseError, InputError
        If the entry lies outside the workspace, or a number is out of range.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> checked = npl.planning.resolution(table, table.best_entry())
    >>> abs(checked.predicted - checked.realised.value) < 0.05
    True
    """
    return resolution_of(table, table.rollout(entry, runs, seed))


def resolution_of(table: Table, found: Rollouts[Pose]) -> Resolution:
    """Check the grid of a table as `resolution` does, by executions that were made before.

    Parameters
    ----------
    table : PolicyTable
        A table of the plane.
    found : Rollouts
        Executions of the table from one pose.

    Returns
    -------
    Resolution

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> npl.planning.resolution_of(table, table.rollout(table.best_entry(), runs=2000)).warnings
    ()
    """
    scenario: Scenario = table.scenario
    runs = found.runs
    low, high = found.interval
    interval = min(low, found.success), max(high, found.success)  # the limits at 0 and 1 are rounded
    realised = Success(found.success, interval, SuccessSource.EXECUTIONS, runs)
    path: Path = table.path(found.start)
    target_cells = 2 * scenario.target.radius_mm / _cell_mm(scenario, float(path.poses[-1][2]))
    passage_mm, passage_cells = min(_passages(scenario, path), key=lambda pair: pair[1], default=(math.inf, math.inf))
    true, solved = heading_variance(scenario)
    ratio = solved / true if true > 0 else math.inf if solved > 0 else 1.0
    warnings = []
    if target_cells < _CELLS:
        finer = _finer(scenario, target_cells, 2 * scenario.target.radius_mm)
        warnings.append(f"the target is {target_cells:.2g} cells of the grid wide; {finer}")
    if passage_cells < _CELLS:
        warnings.append(
            f"the narrowest passage on the path is {passage_mm:.2g} mm wide, {passage_cells:.2g} cells of the grid; "
            f"{_finer(scenario, passage_cells, passage_mm)}"
        )
    if 1 < ratio < math.inf:
        warnings.append(
            f"a step of the solve has {ratio:.2g} times the variance of tip_noise; more motion.headings help"
        )
    if disagrees(found):
        warnings.append(
            f"{runs:,} executions realise {100 * found.success:.1f} % where the table promises "
            f"{100 * found.predicted_success:.1f} %" + ("" if warnings else f"; {what_helps(scenario)}")
        )
    return Resolution(
        found.predicted_success, realised, target_cells, passage_mm, passage_cells, ratio, tuple(warnings)
    )


def disagrees(found: Rollouts[Any]) -> bool:
    """Return whether executions differ from their prediction by more than chance and two percentage points.

    Parameters
    ----------
    found : Rollouts
        Executions from one pose.

    Returns
    -------
    bool

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> npl.planning.disagrees(table.rollout(table.best_entry(), runs=500))
    False
    """
    share = (found.predicted_success * found.runs + 1) / (found.runs + 2)
    chance = _CHANCE * math.sqrt(share * (1 - share) / found.runs)
    return abs(found.predicted_success - found.success) > max(chance, _POINTS)


def what_helps(scenario: Scenario) -> str:
    """Return the setting that brings predictions closer to executions, with a value beyond the scenario's value.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the table.

    Returns
    -------
    str
        A setting with its value.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.planning.what_helps(npl.Scenario.read("four_obstacles"))
    'grid.success_refinement = 3 brings them closer'
    """
    grid, motion = scenario.grid, scenario.motion
    if grid.transition is Transition.NEAREST:
        return 'grid.transition = "interpolated" brings them closer'
    noise_deg, apart_deg = motion.tip_noise_step_deg, 360 / motion.headings
    if noise_deg is not None and noise_deg < apart_deg:
        return f"motion.headings = {2 * motion.headings}, with motion.step_mm, brings them closer"
    if (times := success_refinement(scenario)) < 3:
        return f"grid.success_refinement = {times + 1} brings them closer"
    if (times := grid.refinement or 1) < 3:
        return f"grid.refinement = {times + 1} brings them closer"
    return f"half of grid.spacing_mm, {_halved(grid.spacing_mm)}, brings them closer"


def _finer(scenario: Scenario, cells: float, width_mm: float) -> str:
    """Return the refinement with which a width has enough cells, or that no grid helps.

    If one noise step moves the end of the next step further than the width, success depends on the exact pose: each of
    the few headings that the noise allows reaches the target or misses it.
    """
    aside_mm = scenario.motion.noise_step_rad * scenario.step_mm
    if scenario.motion.tip_noise[0] < 1 and width_mm < aside_mm:
        return f"a noise step moves the tip {aside_mm:.2g} mm aside: no grid resolves it, executions show its success"
    times = math.ceil((scenario.grid.refinement or 1) * _CELLS / cells)
    if times <= 9:
        return f"grid.refinement = {times} resolves it"
    spacing = (size * cells / (scenario.grid.refinement or 1) / _CELLS for size in scenario.grid.spacing_mm)
    return f"a grid.spacing_mm of [{', '.join(f'{size:.2g}' for size in spacing)}] resolves it"


def _halved(spacing_mm: tuple[float, float]) -> str:
    return f"[{spacing_mm[0] / 2:g}, {spacing_mm[1] / 2:g}]"


def _cell_mm(scenario: Scenario, heading_rad: float) -> float:
    """Return the width (mm) of a cell of the solve across a heading."""
    dx, dy = scenario.grid.spacing_mm
    return (abs(math.sin(heading_rad)) * dx + abs(math.cos(heading_rad)) * dy) / (scenario.grid.refinement or 1)


def _passages(scenario: Scenario, path: Path) -> Iterator[tuple[float, float]]:
    """Yield the width (mm, and in cells) between obstacles on both sides of each pose of a path, across its heading."""
    import shapely

    space = scenario.workspace
    half_mm = 0.5 * (scenario.needle.diameter_mm or 0.0)
    taken = shapely.union_all([obstacle.region().buffer(half_mm) for obstacle in scenario.obstacles])
    reach = space.width_mm + space.height_mm
    border = shapely.box(0, 0, space.width_mm, space.height_mm).exterior
    for x, y, heading, _ in path.poses[1:-1].tolist():
        across = -math.sin(heading), math.cos(heading)
        sides = [_free_mm((x, y), across, side * reach, (taken, border)) for side in (-1, 1)]
        if any(is_obstacle for _, is_obstacle in sides):
            width = sum(free for free, _ in sides)
            yield width, width / _cell_mm(scenario, heading)


def _free_mm(
    at: tuple[float, float], across: tuple[float, float], reach: float, met: tuple[BaseGeometry, BaseGeometry]
) -> tuple[float, bool]:
    """Return the distance (mm) to the first obstacle or border on one side, and whether it is an obstacle."""
    import shapely

    point = shapely.Point(at)
    ray = shapely.LineString([at, (at[0] + reach * across[0], at[1] + reach * across[1])])
    obstacle, border = (
        math.inf if (crossing := ray.intersection(each)).is_empty else float(shapely.distance(point, crossing))
        for each in met
    )
    return min(obstacle, border), obstacle < border
