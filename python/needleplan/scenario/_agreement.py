"""Rules between the parts of a scenario: each function yields one mistake for each violation.

In `obstacles` and `tissues`, an entry that could not be read is None.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from needleplan.config import shown
from needleplan.errors import Mistake
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._parts import (
    Grid,
    Method,
    Needle,
    Objective,
    Solver,
    Target,
    TipMotion,
    Tissue,
    Transition,
    Workspace,
)

__all__ = ["BETWEEN"]

# Largest number of different radii, limited by memory: the solver stores 2 displacements per heading and radius.
_MOST_RADII = 200

# Largest number of grid points along one axis; below 2^31, so that the points can be numbered.
_MOST_POINTS = 1_000_000_000


def _target_in_workspace(workspace: Workspace, target: Target) -> Iterator[Mistake]:
    x, y = target.center_mm
    if not (0 <= x <= workspace.width_mm and 0 <= y <= workspace.height_mm):
        rule = f"must lie in the workspace, [0, {workspace.width_mm:g}] x [0, {workspace.height_mm:g}]"
        yield Mistake("target.center_mm", shown(target.center_mm), rule)


def _target_clear_of_obstacles(target: Target, obstacles: tuple[Obstacle | None, ...]) -> Iterator[Mistake]:
    for number, obstacle in enumerate(obstacles, start=1):
        if obstacle and obstacle.touches(*target.center_mm):
            name = f' ("{obstacle.name}")' if obstacle.name else ""
            margin = " or its margin" if obstacle.margin_mm else ""
            rule = f"must not lie in or on an obstacle; it does in obstacle {number}{name}{margin}"
            yield Mistake("target.center_mm", shown(target.center_mm), rule)


def _layers_in_workspace(workspace: Workspace, needle: Needle) -> Iterator[Mistake]:
    for number, layer in enumerate(needle.layers, start=1):
        if layer.from_mm > workspace.width_mm:
            rule = f"must lie in the workspace, from 0 to {workspace.width_mm:g}"
            yield Mistake(f"needle.layer {number}.from_mm", shown(layer.from_mm), rule)


def _few_radii(needle: Needle, tissues: tuple[Tissue | None, ...], objective: Objective) -> Iterator[Mistake]:
    radii = {tissue.curvature_radius_mm for tissue in tissues if tissue}
    radii |= {needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in needle.layers)}
    # With a price of clearance, every radius occurs close to obstacles and far from them.
    most = _MOST_RADII // 2 if objective.clearance_per_mm else _MOST_RADII
    if len(radii) > most:
        priced = " with objective.clearance_per_mm" if objective.clearance_per_mm else ""
        rule = f"must take at most {most} different values in needle, layers and tissues{priced}, not {len(radii)}"
        yield Mistake("curvature_radius_mm", "", rule)


def _step_turns_little(needle: Needle, tissues: tuple[Tissue | None, ...], motion: TipMotion) -> Iterator[Mistake]:
    radii = [needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in needle.layers)]
    radii += [tissue.curvature_radius_mm for tissue in tissues if tissue]
    if motion.step_mm is None:
        if math.inf in radii:
            yield Mistake("curvature_radius_mm", "inf", "needs motion.step_mm, the length of a step on a straight path")
    elif motion.step_mm > math.pi / 2 * min(radii):
        rule = f"must be at most {math.pi / 2 * min(radii):.6g}, a turn by 90 degrees with the smallest radius"
        yield Mistake("motion.step_mm", shown(motion.step_mm), rule)


def _straight_has_steps(motion: TipMotion, objective: Objective) -> Iterator[Mistake]:
    if objective.straight_per_mm is not None and motion.straight_curvature_share is None:
        rule = "is a price of straight steps: set motion.straight_curvature_share, or leave the price out"
        yield Mistake("objective.straight_per_mm", shown(objective.straight_per_mm), rule)


def _spacing_in_workspace(workspace: Workspace, grid: Grid) -> Iterator[Mistake]:
    sizes = (workspace.width_mm, workspace.height_mm)
    if any(spacing > size for spacing, size in zip(grid.spacing_mm, sizes, strict=True)):
        rule = f"must not exceed the workspace, {workspace.width_mm:g} x {workspace.height_mm:g} mm"
        yield Mistake("grid.spacing_mm", shown(grid.spacing_mm), rule)
    elif any(spacing * _MOST_POINTS < size for spacing, size in zip(grid.spacing_mm, sizes, strict=True)):
        rule = (
            f"must be at least {max(sizes) / _MOST_POINTS:.3g}: a grid has at most {_MOST_POINTS:,} points along x or y"
        )
        yield Mistake("grid.spacing_mm", shown(grid.spacing_mm), rule)


def _target_on_grid(workspace: Workspace, target: Target, grid: Grid) -> Iterator[Mistake]:
    outside = any(_target_in_workspace(workspace, target)) or any(_spacing_in_workspace(workspace, grid))
    if grid.transition is not Transition.NEAREST or outside:
        return
    gap = [
        coordinate - min(round(coordinate / spacing), points - 1) * spacing
        for coordinate, spacing, points in zip(target.center_mm, grid.spacing_mm, grid.points(workspace), strict=True)
    ]
    distance = math.sqrt(gap[0] ** 2 + gap[1] ** 2)
    if distance > target.radius_mm:
        rule = (
            f'must be at least {distance:g}, the distance to the nearest grid point: with transition = "nearest" '
            'the tip is on grid points only; enlarge the radius, refine grid.spacing_mm or use "interpolated"'
        )
        yield Mistake("target.radius_mm", shown(target.radius_mm), rule)


def _partitions_hold_points(workspace: Workspace, grid: Grid, solver: Solver) -> Iterator[Mistake]:
    if solver.method is not Method.PPVI or not solver.partitions or any(_spacing_in_workspace(workspace, grid)):
        return
    points = grid.points(workspace)
    if any(number > most for number, most in zip(solver.partitions, points, strict=True)):
        rule = f"must not exceed the grid, {points[0]} x {points[1]} points"
        yield Mistake("solver.partitions", shown(solver.partitions), rule)


BETWEEN = (
    _target_in_workspace,
    _target_clear_of_obstacles,
    _layers_in_workspace,
    _few_radii,
    _step_turns_little,
    _straight_has_steps,
    _spacing_in_workspace,
    _target_on_grid,
    _partitions_hold_points,
)
"""All rules between the parts, in the order in which their mistakes are reported."""
