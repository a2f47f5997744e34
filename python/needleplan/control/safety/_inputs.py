"""Status of every input of the guard, and the validation of the inputs, as pure functions of samples and time.

An input is healthy while its last usable sample is younger than the age limit. The age of a sample counts from the time
at which the device took the sample, which `Delay` estimates from the clock or the sample counter of the device. A
single suspect sample is not used, but does not stop the motion either. A force or depth beyond its limit stops the
motion even if the sample is suspect.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from needleplan import _ppvi
from needleplan.artifacts import CallRepr
from needleplan.control.safety._causes import Cause
from needleplan.control.safety._limits import SafetyLimits
from needleplan.devices import ForceSample, Health, PoseSample, Sample, Source, StageSample, Stamp
from needleplan.recording import RecorderState, RecorderStatus

__all__ = ["Delay", "InputStatus", "Inputs", "LoopStatus", "RecordingStatus", "validate"]

_Sample = TypeVar("_Sample", ForceSample, PoseSample, StageSample)
_NANO = 1e-9
_NONE: frozenset[Cause] = frozenset()
# time (s) after which a pose that repeats bit for bit while the stage moves is frozen, and change of the depth (mm) by
# which the stage moves
_FROZEN_S, _MOVED_MM = 0.25, 0.1


@dataclass(frozen=True)
class Delay:
    """Estimate of the transport delay of samples from a device clock; `late_s` is the delay (s) of the last sample.

    `late_s` is at most the delay beyond the smallest one so far. A device clock that drifts by at most 1e-4 causes no
    delay to be reported; a delay that grows faster is reported. `rust/guard/src/age.rs` has the derivation.

    If the device clock goes back, the device was restarted, and the estimate starts again. A device without a clock has
    no delay.
    """

    late_s: float = 0.0
    _numbers: list[float] | None = None

    def then(self, stamp: Stamp) -> Delay:
        """Return the estimate after another sample; this estimate itself if `stamp` has no device time."""
        if stamp.device_time_s is None:
            return self
        numbers = _ppvi.guard_delay(self._numbers, stamp.received_ns, stamp.device_time_s)
        return Delay(numbers[0], numbers)


@dataclass(frozen=True)
class InputStatus(Generic[_Sample]):
    """Status of one device: its last sample, the times of its last samples, and whether it has failed."""

    last: _Sample | None = None
    usable_ns: int | None = None
    """Estimated time (ns) at which the device took its last usable sample."""
    failed: bool = False
    """Whether the device has failed since its last usable sample."""
    is_usable: bool = False
    """Whether `last` is usable."""

    delay: Delay = field(default_factory=Delay)
    taken_ns: int | None = None
    """Estimated time (ns) at which the device took `last`: its time of arrival less its delay."""

    def then(self, sample: _Sample, usable: bool) -> InputStatus[_Sample]:
        """Return the status after another sample; unchanged by a sample with the sequence number of the last one."""
        if self.last is not None and sample.stamp.sequence == self.last.stamp.sequence:
            return self
        delay = self.delay.then(sample.stamp)
        taken_ns = sample.stamp.received_ns - round(delay.late_s / _NANO)
        if usable:
            return InputStatus(sample, taken_ns, is_usable=True, delay=delay, taken_ns=taken_ns)
        return replace(self, last=sample, is_usable=False, delay=delay, taken_ns=taken_ns)


@dataclass(frozen=True)
class RecordingStatus:
    """Last status of the recorder (None: nothing to validate), number of lost messages, and time of the last loss."""

    status: RecorderStatus | None = None
    lost: int = 0
    lost_ns: int | None = None

    def then(self, status: RecorderStatus, now_ns: int) -> RecordingStatus:
        """Return the recording status after another status of the recorder."""
        lost = sum(status.overflowed.values()) + status.refused
        if lost > self.lost:
            return RecordingStatus(status, lost, now_ns)
        return replace(self, status=status)

    def causes(self, limits: SafetyLimits, now_ns: int) -> frozenset[Cause]:
        """Return the causes that concern the recording. A lost message is reported for `recording_age_s`."""
        status, limit_s = self.status, limits.recording_age_s
        if status is None:
            return _NONE
        recently = self.lost_ns is not None and (now_ns - self.lost_ns) * _NANO <= limit_s
        if recently or status.state in (RecorderState.FAILED, RecorderState.CLOSED):
            return frozenset({Cause.RECORDING_LOST})
        if status.state is RecorderState.STALLED or status.behind_s > limit_s:
            return frozenset({Cause.RECORDING_BEHIND})
        return _NONE


@dataclass(frozen=True)
class LoopStatus:
    """Times (ns) of the last validation, of the last `tick` of the loop (None before the first), and of enabling."""

    validated_ns: int
    ticked_ns: int | None = None
    enabled_ns: int = 0

    def validated(self, now_ns: int) -> LoopStatus:
        """Return the status after a validation at a time (ns)."""
        return LoopStatus(max(now_ns, self.validated_ns), self.ticked_ns, self.enabled_ns)

    def causes(self, limits: SafetyLimits, now_ns: int, running: bool) -> Iterator[Cause]:
        """Yield the causes that concern the loop, its clock and, if `running`, the duration of the run."""
        if _older(self.ticked_ns, limits.loop_age_s, now_ns):
            yield Cause.LOOP_LATE
        if now_ns < self.validated_ns:
            yield Cause.CLOCK_MISMATCH
        if running and _older(self.enabled_ns, limits.run_s, now_ns):
            yield Cause.TIME_EXCEEDED


@dataclass(frozen=True)
class Inputs(CallRepr):
    """Status of the three devices, and the tip that the loop estimates from the poses.

    `tip_mm` is the tip in the plane of the plan (None if unknown), `out_of_plane_mm` the distance of the tip from this
    plane.
    """

    force: InputStatus[ForceSample] = field(default_factory=InputStatus)
    pose: InputStatus[PoseSample] = field(default_factory=InputStatus)
    stage: InputStatus[StageSample] = field(default_factory=InputStatus)
    tip_mm: tuple[float, float] | None = None
    out_of_plane_mm: float = math.nan
    step_mm: float = 0.0
    """Distance of the coil between the last two usable poses (mm)."""
    step_s: float = 0.0
    """Time between the last two usable poses (s)."""
    _coil: PoseSample | None = None
    """Last usable pose."""
    _pose_depth_mm: float = math.nan
    """Depth of the stage when the last usable pose differed from the one before (mm)."""
    _moved_ns: int | None = None
    """Time (ns) at which the stage had moved since then; None if it has not."""

    def then(self, sample: Sample, tip: tuple[tuple[float, float] | None, float] | None) -> Inputs:
        """Return the inputs after a sample.

        For a usable pose, `tip` (position in the plane and distance from the plane, mm) replaces the present tip. If
        `tip` is None, the present tip is kept.
        """
        match sample:
            case ForceSample():
                return self.with_force(sample)
            case PoseSample():
                return self.with_pose(sample, *(tip or (self.tip_mm, self.out_of_plane_mm)))
            case StageSample():
                return self.with_stage(sample)
            case _:  # curvature sensors and images only improve the estimate of the tip
                return self

    def with_force(self, sample: ForceSample) -> Inputs:
        """Return the inputs after a force sample."""
        usable = sample.health is Health.GOOD and all(map(math.isfinite, sample.force_n))
        force = self.force.then(sample, usable)
        return Inputs(
            force, self.pose, self.stage, self.tip_mm, self.out_of_plane_mm, self.step_mm, self.step_s, self._coil,
            self._pose_depth_mm, self._moved_ns,
        )  # fmt: skip

    def with_pose(
        self, sample: PoseSample, tip_mm: tuple[float, float] | None = None, out_of_plane_mm: float = math.nan
    ) -> Inputs:
        """Return the inputs after a pose; if the pose is new and usable, the given tip replaces the present tip."""
        usable = sample.health is Health.GOOD and all(map(math.isfinite, sample.position_mm))
        pose = self.pose.then(sample, usable)
        if pose is self.pose or not usable:
            return replace(self, pose=pose)
        before = self._coil or sample
        depth_mm, moved_ns = self._pose_depth_mm, self._moved_ns
        if before is sample or (before.position_mm, before.quaternion) != (sample.position_mm, sample.quaternion):
            depth_mm, moved_ns = self.stage.last.depth_mm if self.stage.last else math.nan, None
        return replace(
            self, pose=pose, tip_mm=tip_mm, out_of_plane_mm=out_of_plane_mm, _coil=sample,
            step_mm=math.dist(sample.position_mm, before.position_mm),
            step_s=max(sample.stamp.received_ns - before.stamp.received_ns, 0) * _NANO,
            _pose_depth_mm=depth_mm, _moved_ns=moved_ns,
        )  # fmt: skip

    def with_stage(self, sample: StageSample) -> Inputs:
        """Return the inputs after a stage sample."""
        numbers = (sample.depth_mm, sample.velocity_mm_s, sample.roll_rad)
        usable = sample.health is Health.GOOD and all(map(math.isfinite, numbers))
        stage = self.stage.then(sample, usable)
        depth_mm, moved_ns = self._pose_depth_mm, self._moved_ns
        if usable and moved_ns is None:
            if math.isnan(depth_mm):
                depth_mm = sample.depth_mm
            elif abs(sample.depth_mm - depth_mm) > _MOVED_MM:
                moved_ns = stage.taken_ns
        return Inputs(  # not `replace`: it takes three times as long, and this method runs a thousand times a second
            self.force, self.pose, stage, self.tip_mm, self.out_of_plane_mm, self.step_mm, self.step_s, self._coil,
            depth_mm, moved_ns,
        )  # fmt: skip

    def with_tip(self, tip_mm: tuple[float, float] | None, out_of_plane_mm: float) -> Inputs:
        """Return the inputs after another estimate of the tip."""
        return replace(self, tip_mm=tip_mm, out_of_plane_mm=out_of_plane_mm)

    def with_failure(self, source: Source) -> Inputs:
        """Return the inputs after the device `source` has failed; its next usable sample ends the failure."""
        name = {Source.FORCE: "force", Source.POSE: "pose", Source.STAGE: "stage"}[source]
        return replace(self, **{name: replace(getattr(self, name), failed=True)})

    @property
    def frozen(self) -> bool:
        """Whether the last usable pose repeats the one before bit for bit, 0.25 s after the stage moved."""
        moved_ns, pose_ns = self._moved_ns, self.pose.usable_ns
        return moved_ns is not None and pose_ns is not None and _older(moved_ns, _FROZEN_S, pose_ns)

    def stage_known(self, limits: SafetyLimits, now_ns: int) -> StageSample | None:
        """Return the last stage sample; None if it is unusable or too old, or if the stage has failed since."""
        stage = self.stage
        young = not _older(stage.usable_ns, limits.stage_age_s, now_ns)
        return stage.last if young and not stage.failed and stage.is_usable else None


def validate(inputs: Inputs, limits: SafetyLimits, now_ns: int) -> frozenset[Cause]:
    """Return every cause that the inputs show at a time (ns); empty if all are fresh, valid and within limits."""
    causes: list[Cause] = []
    _force(causes, inputs.force, limits, now_ns)
    _pose(causes, inputs, limits, now_ns)
    _stage(causes, inputs.stage, limits, now_ns)
    return frozenset(causes) if causes else _NONE


# Causes of each input: the device has failed; no fresh sample arrives; no fresh sample is usable.
_FORCE = (Cause.FORCE_FAULT, Cause.FORCE_STALE, Cause.FORCE_SUSPECT)
_POSE = (Cause.POSE_FAULT, Cause.POSE_STALE, Cause.POSE_SUSPECT)
_POSE_UNSEEN = (Cause.POSE_FAULT, Cause.POSE_STALE, Cause.POSE_UNSEEN)
_STAGE = (Cause.STAGE_FAULT, Cause.STAGE_STALE, Cause.STAGE_SUSPECT)


def _force(causes: list[Cause], force: InputStatus[ForceSample], limits: SafetyLimits, now_ns: int) -> None:
    _age(causes, force, limits.force_age_s, now_ns, _FORCE)
    if force.last is not None and math.hypot(*force.last.force_n) > limits.force_n:
        causes.append(Cause.FORCE_EXCEEDED)


def _pose(causes: list[Cause], inputs: Inputs, limits: SafetyLimits, now_ns: int) -> None:
    pose = inputs.pose
    unseen = pose.last is not None and pose.last.health is Health.MISSING
    _age(causes, pose, limits.pose_age_s, now_ns, _POSE_UNSEEN if unseen else _POSE)
    if pose.usable_ns is None:
        return
    if inputs.frozen:
        causes.append(Cause.POSE_FROZEN)
    fastest_mm_s = max(limits.insertion_velocity_mm_s, limits.retraction_velocity_mm_s)
    if inputs.step_mm > limits.pose_jump_mm + fastest_mm_s * inputs.step_s:
        causes.append(Cause.POSE_JUMPED)
    distance_mm, tip_mm = inputs.out_of_plane_mm, inputs.tip_mm
    if tip_mm is None or not (math.isfinite(tip_mm[0]) and math.isfinite(tip_mm[1]) and math.isfinite(distance_mm)):
        causes.append(Cause.TIP_UNKNOWN)
        return
    if abs(distance_mm) > limits.out_of_plane_mm:
        causes.append(Cause.OUT_OF_PLANE)
    for place, range_mm in zip(tip_mm, (limits.workspace_x_mm, limits.workspace_y_mm), strict=True):
        if range_mm is not None and not range_mm[0] <= place <= range_mm[1]:
            causes.append(Cause.OUT_OF_WORKSPACE)


def _stage(causes: list[Cause], stage: InputStatus[StageSample], limits: SafetyLimits, now_ns: int) -> None:
    _age(causes, stage, limits.stage_age_s, now_ns, _STAGE)
    if stage.last is None:
        return
    depth_mm, over_mm = stage.last.depth_mm, limits.following_mm
    if depth_mm < limits.shallowest_mm - over_mm or depth_mm > limits.deepest_mm + over_mm:
        causes.append(Cause.DEPTH_EXCEEDED)


def _age(
    present: list[Cause], status: InputStatus[_Sample], limit_s: float, now_ns: int, causes: tuple[Cause, Cause, Cause]
) -> None:
    """Append to `present` the cause that follows from the failure or the age of an input, and CLOCK_MISMATCH.

    `causes` are the causes for a failed device, for no sample that was taken within `limit_s`, and for no usable one. A
    sample that was delayed on its way is as old as its delay, so that a delayed stream is stale.
    """
    received_ns = None if status.last is None else status.last.stamp.received_ns
    freshness, is_of_the_future = _ppvi.guard_freshness(
        status.failed, received_ns, status.taken_ns, status.usable_ns, limit_s, now_ns
    )
    if is_of_the_future:
        present.append(Cause.CLOCK_MISMATCH)
    if freshness:
        present.append(causes[freshness - 1])


def _older(moment_ns: int | None, limit_s: float, now_ns: int) -> bool:
    return moment_ns is None or now_ns - moment_ns > limit_s * 1e9
