"""Insertions without feedback: sequences of moves, true paths of the tip, and ends of paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from needleplan.control import ScenarioGeometry
from needleplan.models import Torsion
from needleplan.planning import Action, PolicyTable, Pose
from needleplan.scenario import Scenario
from needleplan.signals import Array
from needleplan.simulation import Plant, Setup

__all__ = ["Moves", "PathEnd", "aimed_at_target", "execute_moves", "path_end", "planned_moves"]


@dataclass(frozen=True)
class PathEnd:
    """The end of a path relative to the target of a scenario, and the obstacles on the path.

    `error_mm` is the distance of the end from the centre of the target, in the plane of the plan; `aside_mm` is their
    distance across this plane. `touched` names the first obstacle on the path, or is empty; `left` is True if
    the path left the workspace.
    """

    error_mm: float
    aside_mm: float
    touched: str
    left: bool

    @property
    def distance_mm(self) -> float:
        """Distance (mm) of the end from the centre of the target in 3D."""
        return math.hypot(self.error_mm, self.aside_mm)


def path_end(scenario: Scenario, path_mm: Array, target_mm: tuple[float, float, float] | None = None) -> PathEnd:
    """Return the end of a path (mm), shape (n, 3), relative to the target and the obstacles of a scenario.

    `target_mm` is the centre of a target that the needle has displaced; None: that of the scenario.
    """
    scene, places = _scene(scenario), path_mm[:, :2].tolist()
    touched = next((name for place in places if (name := scene.touches(*place))), "")
    left = any(scene.outside(*place) for place in places)
    x, y, z = target_mm or (*scenario.target.center_mm, 0.0)
    (end_x, end_y), aside = places[-1], abs(float(path_mm[-1, 2]) - z)
    return PathEnd(math.hypot(end_x - x, end_y - y), aside, touched, left)


@lru_cache(maxsize=16)
def _scene(scenario: Scenario) -> ScenarioGeometry:
    return ScenarioGeometry(scenario)


_AT_REST_S = 0.1
"""Pause after a move (s), as long as the control loop waits for four frames of the tracker."""

# Sampling interval of the true path (s).
_EVERY_S = 0.02

# Distance along an arc (mm) below which the point closest to the target counts as the beginning of the arc.
_CLOSE_MM = 0.05


@dataclass(frozen=True)
class Moves:
    """Commands to the stage: lengths of insertions (mm), and the bevel side (-1 or +1) before each insertion."""

    lengths_mm: tuple[float, ...]
    bevels: tuple[int, ...]

    @property
    def turns(self) -> int:
        """Number of rotations after the first insertion."""
        return len(self.lengths_mm) - 1


def planned_moves(table: PolicyTable, start: Pose) -> Moves:
    """Return the moves along the planned path, which end at its point closest to the centre of the target.

    The control loop stops at the same point.
    """
    scene, path = ScenarioGeometry(table.scenario), table.path(start)
    lengths, bevels = [0.0], [start.bevel]
    actions = path.actions.tolist()
    for number, (row, action) in enumerate(zip(path.poses[:-1].tolist(), actions, strict=True), start=1):
        pose = Pose.wound(row)
        bevel = -pose.bevel if action == Action.ROTATE.code else pose.bevel
        step = scene.step_mm(pose.x_mm, pose.y_mm)
        if bevel != bevels[-1]:
            bevels.append(bevel)
            lengths.append(0.0)
        # The path ends on the rim of the target, within its last step; the closest point may lie behind this step.
        reach = 2 * step if number == len(actions) else step
        along, distance = scene.closest(
            pose.x_mm, pose.y_mm, pose.heading_rad, bevel / scene.radius_mm(pose.x_mm, pose.y_mm), reach
        )
        if _CLOSE_MM <= along < reach and distance <= table.scenario.target.radius_mm:
            lengths[-1] += along
            break
        lengths[-1] += step
    return Moves(tuple(lengths), tuple(bevels))


def aimed_at_target(setup: Setup, table: PolicyTable, *, bending: bool) -> tuple[Setup, Moves]:
    """Return a setup with the needle heading towards the centre of the target, and one move of the distance to it.

    If `bending` is False, the needle of the returned setup does not bend.
    """
    entry, (x, y) = setup.entry, table.scenario.target.center_mm
    heading = math.atan2(y - entry.y_mm, x - entry.x_mm)
    setup = replace(setup, entry=replace(entry, heading_rad=heading))
    if not bending:
        setup = replace(setup, scenario=None, plan_curvature_per_mm=0.0)
    return setup, Moves((math.hypot(x - entry.x_mm, y - entry.y_mm),), (1,))


def execute_moves(
    plant: Plant,
    moves: Moves,
    velocity_mm_s: float,
    velocity_rad_s: float,
    torsion: Torsion | None,
    roll: Callable[[int, float], float] = lambda bevel, depth_mm: 0.0 if bevel > 0 else math.pi,  # noqa: ARG005
) -> Array:
    """Execute the moves, and return the true path of the tip in the tissue (mm), shape (n, 3).

    The torsional lag of the tip is compensated as in the control loop, unless `torsion` is None. `roll(bevel,
    depth_mm)` returns the roll (rad) at which the needle bends to a bevel side; `depth_mm` is the middle depth of a
    move. By default, the roll is 0 to the left and pi to the right.
    """
    shaft_mm = plant.setup.shaft.length_mm
    path: list[tuple[float, float, float]] = []
    depth_mm = roll_rad = 0.0
    for length_mm, bevel in zip(moves.lengths_mm, moves.bevels, strict=True):
        wanted = roll(bevel, depth_mm + length_mm / 2)
        if wanted != roll_rad:
            goals = [wanted]
            if torsion is not None:
                goals = torsion.compensated_rad(roll_rad, wanted, shaft_mm - depth_mm, depth_mm)[1:].tolist()
            for goal in goals:
                plant.rotate(goal, velocity_rad_s)
                path += _until_rest(plant)
            roll_rad = wanted
        depth_mm += length_mm
        plant.insert(depth_mm, velocity_mm_s)
        path += _until_rest(plant)
    return np.array(path)


def _until_rest(plant: Plant) -> Iterator[tuple[float, float, float]]:
    every = max(round(_EVERY_S / plant.interval_s), 1)
    left = round(_AT_REST_S / plant.interval_s)
    while left:
        plant.step()
        left -= not plant.moving
        if plant.ticks % every == 0 and plant.path_mm >= 0:
            yield plant.tip().position_mm
    if plant.path_mm >= 0:
        yield plant.tip().position_mm
