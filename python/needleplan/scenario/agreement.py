"""Rules between the parts of a scenario, each its own sentence.

A rule looks only at parts that are there, so that the mistakes of a file can be told all at once although some of its
parts could not be read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from needleplan.errors import Mistake
from needleplan.scenario.choices import Method, Transition
from needleplan.scenario.parts import (
    Grid,
    Motion,
    Needle,
    Objective,
    Obstacle,
    Solver,
    Target,
    Tissue,
    Workspace,
)
from needleplan.scenario.polygon import contains
from needleplan.scenario.rules import shown

__all__ = ["disagreements"]

_MOST_RADII = 200


def disagreements(parts: Mapping[str, Any]) -> list[Mistake]:
    """Return the mistakes that lie between `parts`, which are named as the fields of a scenario; some may be absent."""
    workspace, target, grid = parts.get("workspace"), parts.get("target"), parts.get("grid")
    mistakes: list[Mistake] = []
    if workspace and target:
        mistakes += _target_in_workspace(workspace, target)
    if target:
        mistakes += _target_clear_of_obstacles(target, parts.get("obstacles", ()))
    if workspace and parts.get("needle"):
        mistakes += _layers_in_workspace(workspace, parts["needle"])
    mistakes += _few_radii(parts.get("needle"), parts.get("tissues", ()))
    if workspace and grid:
        mistakes += _spacing_in_workspace(workspace, grid)
    if workspace and grid and target and not mistakes:
        mistakes += _target_on_grid(workspace, grid, target)
    if workspace and grid and parts.get("solver"):
        mistakes += _partitions_hold_points(workspace, grid, parts["solver"])
    if parts.get("motion"):
        mistakes += _noise_within_a_turn(parts["motion"])
    if parts.get("objective"):
        mistakes += _endless_insertion_costs(parts["objective"])
    return mistakes


def _target_in_workspace(workspace: Workspace, target: Target) -> Iterator[Mistake]:
    x, y = target.center_mm
    if not (0 <= x <= workspace.width_mm and 0 <= y <= workspace.height_mm):
        rule = f"must lie in the workspace, [0, {workspace.width_mm:g}] x [0, {workspace.height_mm:g}]"
        yield Mistake("target.center_mm", shown(target.center_mm), rule)


def _target_clear_of_obstacles(target: Target, obstacles: tuple[Obstacle | None, ...]) -> Iterator[Mistake]:
    for number, obstacle in enumerate(obstacles, start=1):
        if obstacle and contains(obstacle.polygon_mm, target.center_mm):
            name = f' ("{obstacle.name}")' if obstacle.name else ""
            rule = f"must not lie in or on an obstacle; it does in obstacle {number}{name}"
            yield Mistake("target.center_mm", shown(target.center_mm), rule)


def _layers_in_workspace(workspace: Workspace, needle: Needle) -> Iterator[Mistake]:
    for number, layer in enumerate(needle.layers, start=1):
        if layer.from_mm > workspace.width_mm:
            rule = f"must lie in the workspace, from 0 to {workspace.width_mm:g}"
            yield Mistake(f"needle.layer {number}.from_mm", shown(layer.from_mm), rule)


def _few_radii(needle: Needle | None, tissues: tuple[Tissue | None, ...]) -> Iterator[Mistake]:
    """Every radius has displacements of its own, headings times bevels of them, in the solver."""
    radii = {tissue.curvature_radius_mm for tissue in tissues if tissue}
    if needle:
        radii |= {needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in needle.layers)}
    if len(radii) > _MOST_RADII:
        rule = f"must take at most {_MOST_RADII} different values in needle, layers and tissues, not {len(radii)}"
        yield Mistake("curvature_radius_mm", "", rule)


def _spacing_in_workspace(workspace: Workspace, grid: Grid) -> Iterator[Mistake]:
    sizes = (workspace.width_mm, workspace.height_mm)
    if any(spacing > size for spacing, size in zip(grid.spacing_mm, sizes, strict=True)):
        rule = f"must not exceed the workspace, {workspace.width_mm:g} x {workspace.height_mm:g} mm"
        yield Mistake("grid.spacing_mm", shown(grid.spacing_mm), rule)


def _target_on_grid(workspace: Workspace, grid: Grid, target: Target) -> Iterator[Mistake]:
    if grid.transition is not Transition.NEAREST:
        return
    gap = [
        coordinate - min(round(coordinate / spacing), points - 1) * spacing
        for coordinate, spacing, points in zip(target.center_mm, grid.spacing_mm, grid.points(workspace), strict=True)
    ]
    distance = (gap[0] ** 2 + gap[1] ** 2) ** 0.5
    if distance > target.radius_mm:
        rule = (
            f'must be at least {distance:g}, the distance to the nearest grid point: with transition = "nearest" '
            'the tip is on grid points only; enlarge it, refine grid.spacing_mm or take "interpolated"'
        )
        yield Mistake("target.radius_mm", shown(target.radius_mm), rule)


def _partitions_hold_points(workspace: Workspace, grid: Grid, solver: Solver) -> Iterator[Mistake]:
    points = grid.points(workspace)
    if solver.method is not Method.PPVI or not solver.partitions:
        return
    if any(number > most for number, most in zip(solver.partitions, points, strict=True)):
        rule = f"must not exceed the grid, {points[0]} x {points[1]} points"
        yield Mistake("solver.partitions", shown(solver.partitions), rule)


def _noise_within_a_turn(motion: Motion) -> Iterator[Mistake]:
    reach = len(motion.tip_noise) - 1
    if 2 * reach >= motion.headings:
        rule = f"must be more than {2 * reach}, so that the tip noise stays below half a turn"
        yield Mistake("motion.headings", shown(motion.headings), rule)


def _endless_insertion_costs(objective: Objective) -> Iterator[Mistake]:
    if objective.discount == 1 and objective.insertion_per_mm == 0:
        rule = "must be above 0 where the discount is 1: circling for ever would be free"
        yield Mistake("objective.insertion_per_mm", shown(objective.insertion_per_mm), rule)
