"""Guidance in a plane: both sides of the bevel, straight steps, and small rolls that keep the tip in the plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from needleplan.control._guidance import PlanGuidance, RunEnd, RunStart, Segment, StepChoice, straight_arcs
from needleplan.control._needle import NeedleState
from needleplan.control._options import Options
from needleplan.control._plane import in_plane_per_mm, plane_roll_rad
from needleplan.control._replanning import rescaled
from needleplan.control._report import InsertionOutcome, TipErrors
from needleplan.control._scene import NEARLY_MM, Approach, ScenarioGeometry, state_of
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipEstimate, TipFilter, TipSettings
from needleplan.models import arc_step
from needleplan.planning import Action, Decision, PolicyTable, Pose, SpacePose
from needleplan.scenario import Scenario
from needleplan.signals import Array

__all__ = ["PlaneGuidance"]


class PlaneGuidance(PlanGuidance):
    """Guidance by a policy table in the plane."""

    def __init__(self, table: PolicyTable, options: Options) -> None:
        self._table, self._options = table, options
        self.scene: ScenarioGeometry = ScenarioGeometry(table.scenario)
        self._plane_rad: float | None = None  # roll of the bevel out of the plane; None: never corrected
        # Cached attributes that take long to compute are computed here, before anything moves.
        _ = table.lattice, table.digest, self.scene.touches(0.0, 0.0)

    @property
    def table(self) -> PolicyTable:
        """The policy table."""
        return self._table

    def follow(self, table: Any) -> Self:
        """Return a guidance that uses a new table and keeps the present roll out of the plane."""
        guidance = type(self)(table, self._options)
        guidance._plane_rad = self._plane_rad
        return guidance

    def tip_filter(
        self, registration: Registration, entry: tuple[float, ...], settings: TipSettings, *sensors: Any
    ) -> TipFilter:
        """Return a tip filter with the planned curvature."""
        return TipFilter.for_scenario(self.scene.scenario, registration, entry, settings, *sensors)

    def begin(self, entry: tuple[float, ...], needle: NeedleState) -> RunStart:
        """Return the planned path, and the base roll (rad) for the cheaper side of the bevel.

        The roll is None if the bevel already has this side. The start is refused if the success is too low.
        """
        x, y = self.scene.clamped(*entry[:2])
        start = self._table.start((x, y, entry[2]))
        planned = self._table.path(start).points_mm
        decision = self._table.lookup(*start)
        if decision.success < self._options.least_success:
            return RunStart(planned, refused=self._given_up(start, decision))
        turned = start.bevel != needle.bevel
        return RunStart(planned, (0.0 if start.bevel > 0 else math.pi) if turned else None)

    def choose(self, needle: NeedleState, left_mm: float, room_mm: float) -> StepChoice:
        """Return the decision for the pose at the end of the present insertion."""
        tip, scene, options = needle.tip, self._scene_at(needle.tip), self._options
        pose = self._pose_after(needle, left_mm)
        approach = Approach(scene, in_plane_per_mm(tip))
        inside, outside = approach.inside(pose), scene.outside(pose.x_mm, pose.y_mm)
        decision = None if inside or outside else self._table.lookup(*pose)
        hopeless = decision is not None and decision.success < options.least_success
        rotates = decision is not None and decision.action is Action.ROTATE
        straight = decision is not None and decision.action is Action.STRAIGHT
        left = scene.scenario.motion.straight_curvature_share or 0.0
        to_target_mm = scene.target_distance_mm(tip.x_mm, tip.y_mm)
        back_rad = plane_roll_rad(tip, to_target_mm, scene.scenario.target.radius_mm, options.plane_roll_rad)
        if left_mm > NEARLY_MM and (inside or outside or hopeless or rotates or back_rad is not None):
            return StepChoice(pose, needs_rest=True)
        if approach.done(pose):
            return StepChoice(pose, end=self._arrived(pose, tip))
        if decision is not None and hopeless:
            last_step = approach.beside(pose)
            if last_step is None:
                return StepChoice(pose, end=self._given_up(pose, decision))
            turned, length, last = last_step[0], last_step[1], True
        else:
            turned = pose._replace(bevel=-pose.bevel) if rotates else pose
            bent = replace(approach, curvature_per_mm=left * approach.curvature_per_mm) if straight else approach
            length, last = bent.length_mm(turned, room_mm)
        if back_rad is not None:
            self._plane_rad = back_rad
        rolls = turned.bevel != pose.bevel or back_rad is not None
        roll = self._base_roll_rad(turned.bevel, needle) if rolls else None
        value, success = (decision.value, decision.success) if decision else (0.0, 1.0)
        action = Action.INSERT if turned.bevel == pose.bevel else Action.ROTATE
        segments: tuple[Segment, ...] = (Segment(roll, length),)
        if straight and not hopeless:
            there, back = (self._base_roll_rad(bevel, needle) for bevel in (-pose.bevel, pose.bevel))
            action, segments = Action.STRAIGHT, straight_arcs(length, there, back, left, roll)
        return StepChoice(
            pose, action=action, value=value, success=success, state=state_of(self._table.scenario, pose),
            segments=segments, last=last,
        )  # fmt: skip

    def _scene_at(self, tip: TipEstimate) -> ScenarioGeometry:
        """Return the geometry with the target where the push of the needle moves it when the tip arrives as it is."""
        if self._options.push is None:
            return self.scene
        apart = np.subtract((*self.scene.center_mm, 0.0), tip.position_mm)
        return self.scene.pushed(tip.heading_rad, self._options.push.beyond_mm(apart, np.array(tip.tangent)))

    def outside(self, position_mm: Sequence[float]) -> bool:
        """Return whether a position is more than half a cell outside of the workspace."""
        return self.scene.outside(position_mm[0], position_mm[1])

    def touches(self, position_mm: Sequence[float]) -> str:
        """Return the name of the obstacle at a position; empty if there is none."""
        return self.scene.touches(position_mm[0], position_mm[1])

    def place(self, position_mm: Sequence[float]) -> str:
        """Return a text with a position."""
        return f"the tip is at x {position_mm[0]:.2f} mm, y {position_mm[1]:.2f} mm"

    def off_plan_mm(self, tip: TipEstimate) -> float:
        """Return the distance of the tip from the plane of the plan."""
        return tip.z_mm

    def mismatch(self, needle: NeedleState, pose: Pose | SpacePose) -> tuple[float, float, float]:
        """Return the expected mean curvature up to the target, its standard deviation, and the planned one (1/mm)."""
        planned = 1 / self.scene.radius_mm(pose.x_mm, pose.y_mm)
        return *needle.curvature_ahead(self.scene.target_distance_mm(pose.x_mm, pose.y_mm)), planned

    def rescaled(self, factor: float, pose: Pose | SpacePose) -> Scenario:  # noqa: ARG002
        """Return the scenario with all curvatures multiplied. Raises ScenarioError if the result is invalid."""
        return rescaled(self._table.scenario, factor)

    def errors(self, tip: TipEstimate | None, planned_mm: Array) -> TipErrors:  # noqa: ARG002
        """Return the errors of the last estimate of the tip in the plane and out of it; NaN without one."""
        target = self._table.scenario.target
        if tip is None:
            return TipErrors(target.radius_mm)
        aside = self._scene_at(tip).target_distance_mm(tip.x_mm, tip.y_mm)
        in_space = math.hypot(aside, tip.z_mm)
        beyond = max(in_space - target.radius_mm, 0.0)
        return TipErrors(target.radius_mm, aside, in_space, beyond, abs(tip.z_mm))

    def _arrived(self, pose: Pose, tip: TipEstimate) -> RunEnd:
        """Return outcome and cause for a tip that is at its nearest to the target, which is a ball."""
        aside, target = tip.z_mm, self.scene.scenario.target
        distance = math.hypot(self._scene_at(tip).target_distance_mm(pose.x_mm, pose.y_mm), aside)
        outcome = InsertionOutcome.TARGET if distance <= target.radius_mm else InsertionOutcome.MISSED
        place = f"the tip is {distance:.2f} mm from the centre of the target"
        return outcome, f"{place}, {abs(aside):.2f} mm of it out of the plane"

    def _base_roll_rad(self, bevel: int, needle: NeedleState) -> float:
        """Return the roll of the base (rad) for a side of the bevel, with the correction out of the plane.

        Once there was a correction, the estimated difference between the rolls of tip and base is compensated too.
        """
        if self._plane_rad is None:
            return 0.0 if bevel > 0 else math.pi
        twist = needle.tip.roll_rad - needle.roll_rad
        return (self._plane_rad if bevel > 0 else math.pi - self._plane_rad) - twist

    def _pose_after(self, needle: NeedleState, left_mm: float) -> Pose:
        """Return the predicted pose of the tip after a further length.

        A pose that is at most half a cell outside the workspace is moved to the edge.
        """
        tip, bevel = needle.tip, needle.bevel
        x, y, heading = tip.x_mm, tip.y_mm, tip.heading_rad
        if abs(left_mm) > 1e-6:
            x, y, heading = (float(number) for number in arc_step(x, y, heading, bevel * in_plane_per_mm(tip), left_mm))
        return Pose.wound((*self.scene.clamped(x, y), heading, bevel))

    def _given_up(self, pose: Pose, decision: Decision) -> RunEnd:
        promise = f"the success probability of the table is {decision.success:.2%} at {pose}"
        if Approach(self.scene, 0.0).near(pose):
            distance = self.scene.target_distance_mm(pose.x_mm, pose.y_mm)
            return (
                InsertionOutcome.MISSED,
                f"the tip is {distance:.2f} mm from the centre of the target, beside it; {promise}",
            )
        return InsertionOutcome.UNREACHABLE, promise
