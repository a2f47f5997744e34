"""What is known of the robot at a moment, and what is wrong with it: a pure judgement.

An input counts as long as its last usable sample is young: one that is suspect is not used, but is no reason to stop
before the age limit. One of a stage that was long on its way is older than its arrival. Limits are different: a number
beyond one is believed even where it is suspect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from needleplan.control.safety.causes import Cause
from needleplan.control.safety.delay import Delay
from needleplan.control.safety.limits import SafetyLimits
from needleplan.devices import ForceSample, Health, PoseSample, StageSample

__all__ = ["Inputs", "Seen", "judge"]

_Sample = TypeVar("_Sample", ForceSample, PoseSample, StageSample)
_NANO = 1e-9
_NONE: frozenset[Cause] = frozenset()
_FUTURE_S = 0.005
"""A sample may be this far ahead of the clock: rounding, and two cores that disagree."""


@dataclass(frozen=True)
class Seen(Generic[_Sample]):
    """The last sample of a device, from when the last usable one is, and whether the device has given up."""

    last: _Sample | None = None
    usable_ns: int | None = None
    failed: bool = False
    is_usable: bool = False
    """Whether the last one is."""

    delay: Delay = field(default_factory=Delay)

    def then(self, sample: _Sample, usable: bool, timed: bool = False) -> Seen[_Sample]:
        """Return what is known after another sample; the same one again tells nothing, however it is dated.

        A `timed` one carries the time of a clock.
        """
        if self.last is not None and sample.stamp.sequence == self.last.stamp.sequence:
            return self
        delay = self.delay.then(sample.stamp) if timed else self.delay
        if usable:
            return Seen(sample, sample.stamp.received_ns - round(delay.late_s / _NANO), is_usable=True, delay=delay)
        return replace(self, last=sample, is_usable=False, delay=delay)


@dataclass(frozen=True)
class Inputs:
    """What the devices said last; `tip_mm` and `out_of_plane_mm` are what the loop makes of the last usable pose."""

    force: Seen[ForceSample] = field(default_factory=Seen)
    pose: Seen[PoseSample] = field(default_factory=Seen)
    stage: Seen[StageSample] = field(default_factory=Seen)
    tip_mm: tuple[float, float] | None = None
    out_of_plane_mm: float = math.nan
    step_mm: float = 0.0
    """Way of the coil between the last two usable poses, and the time that it took."""
    step_s: float = 0.0
    _coil: tuple[int, tuple[float, float, float]] | None = None

    def with_force(self, sample: ForceSample) -> Inputs:
        """Return the inputs after a sample of the force."""
        usable = sample.health is Health.GOOD and all(map(math.isfinite, sample.force_n))
        force = self.force.then(sample, usable)
        return Inputs(
            force, self.pose, self.stage, self.tip_mm, self.out_of_plane_mm, self.step_mm, self.step_s, self._coil
        )

    def with_pose(
        self, sample: PoseSample, tip_mm: tuple[float, float] | None = None, out_of_plane_mm: float = math.nan
    ) -> Inputs:
        """Return the inputs after a pose, with the tip in the plane and its distance from the plane."""
        usable = sample.health is Health.GOOD and all(map(math.isfinite, sample.position_mm))
        pose = self.pose.then(sample, usable)
        if pose is self.pose or not usable:
            return replace(self, pose=pose)
        now = (sample.stamp.received_ns, sample.position_mm)
        before_ns, before_mm = now if self._coil is None else self._coil
        return replace(
            self, pose=pose, tip_mm=tip_mm, out_of_plane_mm=out_of_plane_mm, _coil=now,
            step_mm=math.dist(now[1], before_mm), step_s=max(now[0] - before_ns, 0) * _NANO,
        )  # fmt: skip

    def with_stage(self, sample: StageSample) -> Inputs:
        """Return the inputs after a sample of the stage."""
        numbers = (sample.depth_mm, sample.velocity_mm_s, sample.roll_rad)
        usable = sample.health is Health.GOOD and all(map(math.isfinite, numbers))
        stage = self.stage.then(sample, usable, timed=True)
        return Inputs(  # not `replace`, which takes three times as long, a thousand times a second
            self.force, self.pose, stage, self.tip_mm, self.out_of_plane_mm, self.step_mm, self.step_s, self._coil
        )

    def stage_known(self, limits: SafetyLimits, now_ns: int) -> StageSample | None:
        """Return where the stage is, or None where that is not known now."""
        stage = self.stage
        young = not _older(stage.usable_ns, limits.stage_age_s, now_ns)
        return stage.last if young and not stage.failed and stage.is_usable else None


def judge(inputs: Inputs, limits: SafetyLimits, now_ns: int) -> frozenset[Cause]:
    """Return every cause that the inputs give at a moment; none where all of them are fresh, valid and in limits."""
    found: list[Cause] = []
    _force(found, inputs.force, limits, now_ns)
    _pose(found, inputs, limits, now_ns)
    _stage(found, inputs.stage, limits, now_ns)
    return frozenset(found) if found else _NONE


_FORCE = (Cause.FORCE_FAULT, Cause.FORCE_STALE, Cause.FORCE_SUSPECT)
_POSE = (Cause.POSE_FAULT, Cause.POSE_STALE, Cause.POSE_SUSPECT)
_POSE_UNSEEN = (Cause.POSE_FAULT, Cause.POSE_STALE, Cause.POSE_UNSEEN)
_STAGE = (Cause.STAGE_FAULT, Cause.STAGE_STALE, Cause.STAGE_SUSPECT)
"""An input has given up, nothing comes, nothing usable comes."""


def _force(found: list[Cause], force: Seen[ForceSample], limits: SafetyLimits, now_ns: int) -> None:
    _age(found, force, limits.force_age_s, now_ns, _FORCE)
    if force.last is not None and math.hypot(*force.last.force_n) > limits.force_n:
        found.append(Cause.FORCE_EXCEEDED)


def _pose(found: list[Cause], inputs: Inputs, limits: SafetyLimits, now_ns: int) -> None:
    pose = inputs.pose
    unseen = pose.last is not None and pose.last.health is Health.MISSING
    _age(found, pose, limits.pose_age_s, now_ns, _POSE_UNSEEN if unseen else _POSE)
    if pose.usable_ns is None:
        return
    fastest_mm_s = max(limits.insertion_velocity_mm_s, limits.retraction_velocity_mm_s)
    if inputs.step_mm > limits.pose_jump_mm + fastest_mm_s * inputs.step_s:
        found.append(Cause.POSE_JUMPED)
    distance_mm, tip_mm = inputs.out_of_plane_mm, inputs.tip_mm
    if tip_mm is None or not (math.isfinite(tip_mm[0]) and math.isfinite(tip_mm[1]) and math.isfinite(distance_mm)):
        found.append(Cause.TIP_UNKNOWN)
        return
    if abs(distance_mm) > limits.out_of_plane_mm:
        found.append(Cause.OUT_OF_PLANE)
    for place, room in zip(tip_mm, (limits.workspace_x_mm, limits.workspace_y_mm), strict=True):
        if room is not None and not room[0] <= place <= room[1]:
            found.append(Cause.OUT_OF_WORKSPACE)


def _stage(found: list[Cause], stage: Seen[StageSample], limits: SafetyLimits, now_ns: int) -> None:
    _age(found, stage, limits.stage_age_s, now_ns, _STAGE)
    if stage.last is None:
        return
    depth_mm, over_mm = stage.last.depth_mm, limits.following_mm
    if depth_mm < limits.shallowest_mm - over_mm or depth_mm > limits.deepest_mm + over_mm:
        found.append(Cause.DEPTH_EXCEEDED)


def _age(
    found: list[Cause], seen: Seen[_Sample], limit_s: float, now_ns: int, causes: tuple[Cause, Cause, Cause]
) -> None:
    """Add what is wrong with the age of an input: one of given up, nothing comes, nothing usable comes."""
    failed, stale, unusable = causes
    if seen.last is not None and seen.last.stamp.received_ns - now_ns > _FUTURE_S / _NANO:
        found.append(Cause.CLOCK_MISMATCH)
    if seen.failed:
        found.append(failed)
    elif seen.last is None or _older(seen.last.stamp.received_ns, limit_s, now_ns):
        found.append(stale)
    elif _older(seen.usable_ns, limit_s, now_ns):
        found.append(unusable)


def _older(moment_ns: int | None, limit_s: float, now_ns: int) -> bool:
    return moment_ns is None or now_ns - moment_ns > limit_s * 1e9
