"""Guidance in 3D: any roll of the bevel, and straight steps.

A decision of the table is a direction across the tangent to which the needle shall bend. The base rolls by the angle
between this direction and the estimated direction of the bevel, which the torsional lag and the turning of the frame
along the path have moved. A smaller angle than `roll_tolerance_rad` is not worth a stop. The loop decides
anew before the end of the planned step, because the tip leaves the planned arc all along: see `decisions_per_step`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from needleplan.anatomy import FREE, OBSTACLE, OUTSIDE, TARGET, SpaceScenario
from needleplan.control._guidance import PlanGuidance, RunEnd, RunStart, Segment, StepChoice, straight_arcs
from needleplan.control._needle import NeedleState
from needleplan.control._options import Options
from needleplan.control._report import InsertionOutcome, SpaceErrors, TipErrors
from needleplan.control._scene import GAIN_MM, NEARLY_MM
from needleplan.control._space_target import SpaceTarget
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipEstimate, TipFilter, TipSettings
from needleplan.models.path import Vector
from needleplan.planning import (
    Action,
    Pose,
    SpaceDecision,
    SpacePose,
    SpaceTable,
    SpaceTask,
    bend_direction,
    step_points,
)
from needleplan.signals import Array

__all__ = ["SpaceGuidance"]

# Roll of the base (rad) beyond which the needle rolls the other way, so that its cables are not wound up.
_MOST_ROLL_RAD = 4 * math.pi
# Distance (mm) from the centroid by which another roll must be better than the present one near the target.
_WORTH_MM = 0.5
_OBSTACLE_NAME = "an obstacle or its margin"


class SpaceGuidance(PlanGuidance):
    """Guidance by a 3D policy table. Positions are in the frame of the lattice."""

    def __init__(self, table: SpaceTable, options: Options, whole: SpaceTable | None = None) -> None:
        self._table, self._options = table, options
        self._whole = whole or table  # the first table; a plan during the insertion holds from its pose on only
        self._scenario: SpaceScenario = table.scenario
        self._advance = max(round(self._scenario.advance / options.decisions_per_step), 1)
        # Cached attributes that take long to compute are computed here, before anything moves.
        _ = table.digest, self._scenario.target_mm, self._scenario.target_reach_mm
        self._target_at_rest = SpaceTarget(self._scenario, (1.0, 0.0, 0.0), 0.0)

    @property
    def table(self) -> SpaceTable:
        """The policy table."""
        return self._table

    def follow(self, table: Any) -> Self:
        """Return the guidance by a new table."""
        return type(self)(table, self._options, self._whole)

    def tip_filter(
        self, registration: Registration, entry: tuple[float, ...], settings: TipSettings, *sensors: Any
    ) -> TipFilter:
        """Return a tip filter with the planned curvature; the settings hold the noise of the tip."""
        return TipFilter(registration, entry, self._scenario.planned_per_mm, settings, *sensors)

    def begin(self, entry: tuple[float, ...], needle: NeedleState) -> RunStart:  # noqa: ARG002
        """Return the planned path. The first step rolls the bevel."""
        x, y, heading, z, elevation = entry
        level = math.cos(elevation)
        pose = SpacePose(x, y, z, level * math.cos(heading), level * math.sin(heading), math.sin(elevation))
        planned = self._table.path(pose).points_mm
        decision = self._table.lookup(pose)
        if decision.success < self._options.least_success:
            return RunStart(planned, refused=self._given_up(self._target_at_rest, pose, decision))
        return RunStart(planned)

    def choose(self, needle: NeedleState, left_mm: float, room_mm: float) -> StepChoice:
        """Return the decision for the pose at the end of the present insertion."""
        tip = needle.tip_ahead(left_mm if abs(left_mm) > 1e-6 else 0.0)
        pose = SpacePose(*tip.position_mm, *tip.tangent)
        moving = left_mm > NEARLY_MM
        # A tangent beyond the cone is no danger. The decision is that at the rim.
        known = self._table.clamped(pose)
        table = self._table if self._table.contains(known) else self._whole
        target = self._target(tip)
        inside, outside = target.code(pose) == TARGET, self.outside(pose) or not table.contains(known)
        if moving and (inside or outside):
            return StepChoice(pose, needs_rest=True)
        if inside:
            return self._into_target(target, pose, tip, room_mm)
        if outside:
            return StepChoice(
                pose, end=(InsertionOutcome.OUTSIDE, f"{self.place(pose)}, outside the lattice or its cone")
            )
        decision = table.lookup(known)
        if decision.success < self._options.least_success:
            return StepChoice(pose, needs_rest=True) if moving else self._beside(target, needle, tip, decision, room_mm)
        wanted = self._direction(target, pose, tip, decision)
        if wanted is None:
            return self._straight(target, needle, pose, decision, room_mm)
        turn = tip.turn_towards(wanted)
        rolls = abs(turn) > self._options.roll_tolerance_rad
        if rolls and moving:
            return StepChoice(pose, needs_rest=True)
        direction = wanted if rolls else tip.bend_direction
        length, last = self._length(target, pose, direction, tip.curvature_factor, room_mm)
        roll = self._base_roll(needle.roll_rad + turn) if rolls else None
        return self._made(pose, decision, (Segment(roll, length),), Action.ROTATE if rolls else Action.INSERT, last)

    def outside(self, position_mm: Sequence[float]) -> bool:
        """Return whether a position is outside of the lattice or of the body."""
        return self._target_at_rest.code(position_mm) == OUTSIDE

    def touches(self, position_mm: Sequence[float]) -> str:
        """Return "an obstacle or its margin" if the position is in one, else an empty text."""
        return _OBSTACLE_NAME if self._target_at_rest.code(position_mm) == OBSTACLE else ""

    def place(self, position_mm: Sequence[float]) -> str:
        """Return a text that states a position in RAS, for messages."""
        r, a, s = self._scenario.grid.frame.world(np.array(position_mm[:3], float)).tolist()
        return f"the tip is at R {r:.2f} mm, A {a:.2f} mm, S {s:.2f} mm"

    def off_plan_mm(self, tip: TipEstimate) -> float:  # noqa: ARG002
        """Return 0: a 3D plan has no plane."""
        return 0.0

    def mismatch(self, needle: NeedleState, pose: Pose | SpacePose) -> tuple[float, float, float]:
        """Return the expected mean curvature up to the target, its standard deviation, and the planned one (1/mm)."""
        assert isinstance(pose, SpacePose)
        return *needle.curvature_ahead(self._target_at_rest.distance_mm(pose)), self._scenario.planned_per_mm(
            *pose.position_mm
        )

    def rescaled(self, factor: float, pose: Pose | SpacePose) -> SpaceTask:
        """Return the planning problem from `pose` to the target, with all planned curvatures multiplied by `factor`.

        Raises ScenarioError if the changed scenario breaks a rule.
        """
        assert isinstance(pose, SpacePose)
        return SpaceTask(self._scenario.rescaled(factor), pose)

    def errors(self, tip: TipEstimate | None, planned_mm: Array) -> TipErrors:
        """Return the errors of the last estimate of the tip, relative to the end of the planned path."""
        reach = self._scenario.target_reach_mm
        if tip is None:
            return TipErrors(reach)
        tangent = np.array(tip.tangent)
        planned = planned_mm[-1] - planned_mm[-2] if len(planned_mm) > 1 else tangent
        planned = planned / np.linalg.norm(planned)
        target = self._target(tip)
        apart = np.array(tip.position_mm) - target.center_mm
        along = float(apart @ planned)
        r, a, s = ((apart - along * planned) @ self._scenario.grid.frame.axes).tolist()
        angle = math.atan2(float(np.linalg.norm(np.cross(planned, tangent))), float(planned @ tangent))
        return TipErrors(
            reach, math.hypot(r, a, s), float(np.linalg.norm(apart)), target.outside_mm(tip.position_mm),
            space=SpaceErrors((r, a, s), along, angle),
        )  # fmt: skip

    def _target(self, tip: TipEstimate) -> SpaceTarget:
        """Return the target where the push of the needle moves it when the tip arrives as it is."""
        if self._options.push is None:
            return self._target_at_rest
        apart = np.subtract(self._scenario.target_mm, tip.position_mm)
        beyond = self._options.push.beyond_mm(apart, np.array(tip.tangent))
        return SpaceTarget(self._scenario, tip.tangent, beyond)

    def _base_roll(self, roll_rad: float) -> float:
        """Return an equivalent roll of the base (rad) that does not wind up the needle."""
        return roll_rad if abs(roll_rad) <= _MOST_ROLL_RAD else math.remainder(roll_rad, 2 * math.pi)

    def _direction(
        self, target: SpaceTarget, pose: SpacePose, tip: TipEstimate, decision: SpaceDecision
    ) -> Vector | None:
        """Return the direction to which the needle shall bend; None: straight on.

        Steps that end in the target are nearly equally good for the table. Of these, the one that passes closest to the
        centroid is chosen, from the rolls of the table and the present one.
        """
        decided = None if decision.roll_rad is None else bend_direction(pose.tangent, decision.roll_rad)
        file = self._scenario.file
        rolls = 2 * math.pi * np.arange(file.lattice.rolls) / file.lattice.rolls
        ways: list[Vector | None] = [
            decided,
            tip.bend_direction,
            *(bend_direction(pose.tangent, roll) for roll in rolls),
        ]
        ways += [None] * file.needle.straight_steps
        if not target.near(pose):
            return decided
        scales = [0.0 if way is None else tip.curvature_factor for way in ways]
        directions = [way or (0.0, 0.0, 0.0) for way in ways]
        _, points = step_points(self._scenario, pose, directions, scales, self._scenario.advance)
        codes = target.codes_along(points)
        met = (codes != FREE).argmax(1)
        hits = codes[np.arange(len(ways)), met] == TARGET
        if not hits[0]:
            return decided
        apart = np.where(hits, np.linalg.norm(points - target.center_mm, axis=2).min(1), math.inf)
        apart[1] -= _WORTH_MM  # the present roll needs no rotation
        return ways[int(apart.argmin())]

    def _length(
        self, target: SpaceTarget, pose: SpacePose, direction: Sequence[float], scale: float, room_mm: float
    ) -> tuple[float, bool]:
        """Return the length (mm) of the next step, at most `room_mm`, and whether this step is the last one.

        The last step ends at `room_mm`, or in the target at the point closest to its centroid.
        """
        (lengths,), (points,) = step_points(self._scenario, pose, [direction], [scale], self._advance)
        codes = target.codes_along(points[None])[0]
        met = int((codes != FREE).argmax()) if (codes != FREE).any() else len(codes)
        if met < len(codes) and codes[met] == TARGET:
            # Beyond the target, points that are not free end the part that counts.
            after = (codes[met:] == OBSTACLE) | (codes[met:] == OUTSIDE)
            end = met + (int(after.argmax()) if after.any() else len(after))
            apart = np.linalg.norm(points[met:end] - target.center_mm, axis=1)
            apart[codes[met:end] != TARGET] = math.inf
            at = met + int(apart.argmin())
            if lengths[at] <= room_mm and (at < len(lengths) - 1 or lengths[at] <= NEARLY_MM):
                return float(lengths[at]), True
        length = float(lengths[-1])
        return (room_mm, True) if room_mm < length else (length, False)

    def _into_target(self, target: SpaceTarget, pose: SpacePose, tip: TipEstimate, room_mm: float) -> StepChoice:
        """Return the end of the insertion in the target, or a last step that brings the tip closer to its centroid."""
        length, last = self._length(target, pose, tip.bend_direction, tip.curvature_factor, room_mm)
        if length < 2 * NEARLY_MM:
            distance = target.distance_mm(pose)
            return StepChoice(
                pose, end=(InsertionOutcome.TARGET, f"the tip is {distance:.2f} mm from the target's centre")
            )
        decision = SpaceDecision(0, None, 0.0, 1.0)
        return self._made(pose, decision, (Segment(None, length),), Action.INSERT, last)

    def _straight(
        self, target: SpaceTarget, needle: NeedleState, pose: SpacePose, decision: SpaceDecision, room_mm: float
    ) -> StepChoice:
        """Return a straight step, as three arcs whose turns cancel."""
        length, last = self._length(target, pose, (0.0, 0.0, 0.0), 0.0, room_mm)
        there, back = self._base_roll(needle.roll_rad + math.pi), self._base_roll(needle.roll_rad)
        return self._made(pose, decision, straight_arcs(length, there, back), Action.STRAIGHT, last)

    def _beside(
        self, target: SpaceTarget, needle: NeedleState, tip: TipEstimate, decision: SpaceDecision, room_mm: float
    ) -> StepChoice:
        """Return a last step that brings the tip closer to a near target, or the end of the insertion."""
        pose = SpacePose(*tip.position_mm, *tip.tangent)
        if not target.near(pose):
            return StepChoice(pose, end=self._given_up(target, pose, decision))
        rolls = self._scenario.file.lattice.rolls
        ways = [bend_direction(pose.tangent, 2 * math.pi * each / rolls) for each in range(rolls)]
        scales = np.full(rolls, tip.curvature_factor)
        lengths, points = step_points(self._scenario, pose, ways, scales, self._scenario.advance)
        apart = np.linalg.norm(points - target.center_mm, axis=2)
        codes = target.codes_along(points)
        best, gained = None, GAIN_MM
        for number, at in enumerate(apart.argmin(1).tolist()):
            free = np.isin(codes[number, : at + 1], (FREE, TARGET)).all()
            if free and lengths[number, at] <= room_mm and apart[number, 0] - apart[number, at] > gained:
                best = (ways[number], float(lengths[number, at]))
                gained = float(apart[number, 0] - apart[number, at])
        if best is None:
            return StepChoice(pose, end=self._given_up(target, pose, decision))
        direction, length = best
        roll = self._base_roll(needle.roll_rad + tip.turn_towards(direction))
        return self._made(pose, decision, (Segment(roll, length),), Action.ROTATE, last=True)

    def _made(
        self, pose: SpacePose, decision: SpaceDecision, segments: tuple[Segment, ...], action: Action, last: bool
    ) -> StepChoice:  # fmt: skip
        cell = np.floor(np.array(pose.position_mm) / self._scenario.grid.frame.spacing_mm + 0.5).astype(int).tolist()
        return StepChoice(
            pose, action=action, value=decision.value, success=decision.success, state=(*cell, decision.action),
            segments=segments, last=last,
        )  # fmt: skip

    def _given_up(self, target: SpaceTarget, pose: SpacePose, decision: SpaceDecision) -> RunEnd:
        promise = f"the success probability of the table is {decision.success:.2%} at {pose}; {self.place(pose)}"
        if target.near(pose):
            distance = f"the tip is {target.distance_mm(pose):.2f} mm from the centre of the target, beside it"
            return InsertionOutcome.MISSED, f"{distance}; {promise}"
        return InsertionOutcome.UNREACHABLE, promise
