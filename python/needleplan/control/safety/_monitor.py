"""Everything that the guard knows of a run, and the causes that follow from it at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace

from needleplan import _ppvi
from needleplan.control.safety._causes import Cause
from needleplan.control.safety._inputs import Inputs, LoopStatus, RecordingStatus, validate
from needleplan.control.safety._limits import SafetyLimits
from needleplan.control.safety._motion import MotionWatch
from needleplan.devices import ForceSample, Health, Sample, StageSample
from needleplan.stopping import Rest, StopProcedure

__all__ = ["ForceRise", "RunMonitor", "TipCheck"]

_NANO = 1e-9
_NONE: frozenset[Cause] = frozenset()

TipCheck = Callable[[float, float], Collection[Cause]]
"""Function of the tip position x, y (mm, in the plane of the plan) that returns causes, such as IN_OBSTACLE."""

_Tip = tuple[tuple[float, float] | None, float]


class ForceRise:
    """Rise (N) of the magnitude of the force above its minimum of the last 50 ms; only usable samples count.

    The rise is infinite while it is unknown because more than 512 samples rose within 50 ms.
    """

    def __init__(self) -> None:
        self._window = _ppvi.ForceWindow()

    @property
    def rise_n(self) -> float:
        """The rise (N) at the last usable sample."""
        return self._window.rise_n

    def observe(self, sample: ForceSample) -> None:
        """Update the rise with a sample."""
        if sample.health is Health.GOOD:
            self._window.observe(sample.stamp.received_ns, math.hypot(*sample.force_n))

    def exceeds(self, limit_n_s: float) -> bool:
        """Return whether the force rises faster than a limit (N/s)."""
        return self._window.exceeds(limit_n_s)


class RunMonitor:
    """Last inputs, commands, loop and recorder of a run. The guard calls all methods with its lock held.

    `check_tip` returns the causes of a tip position, such as IN_OBSTACLE. With `needs_deadman`, DEADMAN_RELEASED is
    present until a person holds the deadman switch.
    """

    def __init__(self, now_ns: int, check_tip: TipCheck | None, *, needs_deadman: bool) -> None:
        self.inputs: Inputs = Inputs()
        self.motion: MotionWatch = MotionWatch()
        self.recording: RecordingStatus = RecordingStatus()
        self.loop: LoopStatus = LoopStatus(now_ns)
        self.force_rise: ForceRise = ForceRise()
        self.reported: frozenset[Cause] = _NONE
        """Causes that the loop reports."""

        self.stop: StopProcedure | None = None
        """The stop whose rest is not yet measured, or the last one; None before the first stop, and once the needle was
        ordered to move again."""

        self.read_failed = False
        """Whether the last attempt to read the stage has raised an error."""

        self.passing: set[Cause] = set()
        """Causes that are present for one validation."""

        self._check_tip = check_tip
        self.needs_deadman = needs_deadman
        self.deadman_ns: int | None = None
        """Time (ns) at which the person last held the deadman switch; None after its release."""

        self._deadman = _ppvi.DeadmanTimer()
        self._at_tip: frozenset[Cause] = _NONE

    def observe(self, sample: Sample, tip: _Tip | None, limits: SafetyLimits) -> None:
        """Update the inputs with a sample; `tip` is as in `Inputs.then`."""
        self.inputs = self.inputs.then(sample, tip)
        if isinstance(sample, StageSample):
            self.motion = self.motion.then(sample, limits)
            if self.inputs.stage.last is sample and sample.health is Health.GOOD:
                self.see_stopping(sample, (self.inputs.stage.taken_ns or 0) * _NANO)
        elif isinstance(sample, ForceSample):
            self.force_rise.observe(sample)
        elif tip is not None:
            self._look_at_tip()

    def see_stopping(self, sample: StageSample, taken_s: float) -> None:
        """Measure by a stage sample that was taken at a time (s) whether the needle rests after a stop."""
        if self.stop is not None:
            numbers = sample.depth_mm, sample.velocity_mm_s, sample.roll_rad
            self.stop.see(taken_s, *numbers, sample.stamp.device_time_s)

    def stops(self, limits: SafetyLimits, now_ns: int, *, anew: bool) -> None:
        """Note that a stop is sent at a time (ns); `anew` is false while an earlier stop still lasts."""
        last, goal, roll = self.inputs.stage.last, self.motion.depth, self.motion.roll
        if anew or self.stop is None:
            speed_mm_s = max(abs(last.velocity_mm_s) if last else 0.0, goal.velocity if goal else 0.0)
            depth_mm, speed_rad_s = last.depth_mm if last else None, roll.velocity if roll else 0.0
            self.stop = StopProcedure(limits.stop, now_ns * _NANO, depth_mm, speed_mm_s, speed_rad_s)
        self.motion = self.motion.stops(now_ns)

    def rest(self, now_ns: int) -> Rest:
        """Return the motion state of the needle after the last stop, at a time (ns); UNKNOWN if there was no stop."""
        return Rest.UNKNOWN if self.stop is None else self.stop.rest(now_ns * _NANO)

    def observe_tip(self, tip_mm: tuple[float, float] | None, out_of_plane_mm: float) -> None:
        """Update the inputs with an estimate of the tip."""
        self.inputs = self.inputs.with_tip(tip_mm, out_of_plane_mm)
        self._look_at_tip()

    def observe_deadman(self, held: bool, now_ns: int) -> None:
        """Note whether the person holds the deadman switch at a time (ns)."""
        self._deadman.observe(held, now_ns)
        self.deadman_ns = now_ns if held else None

    def ticked(self, now_ns: int) -> None:
        """Note that the loop is running at a time (ns)."""
        self.loop = replace(self.loop, ticked_ns=now_ns)

    def causes(self, limits: SafetyLimits, now_ns: int, *, running: bool, is_stopping: bool = False) -> set[Cause]:
        """Return all causes for a stop that are present at a time (ns).

        `running`: the limit of the run's duration applies. `is_stopping`: a stop was commanded, and the needle must
        come to rest.
        """
        causes = set(validate(self.inputs, limits, now_ns))
        causes.update(
            self.reported, self._at_tip, self.passing, self.motion.causes(limits, now_ns),
            self.recording.causes(limits, now_ns), self.loop.causes(limits, now_ns, running=running),
        )  # fmt: skip
        if is_stopping and self.rest(now_ns) is Rest.MOVES:
            causes.add(Cause.STILL_MOVING)
        if self.force_rise.exceeds(limits.force_rate_n_s):
            causes.add(Cause.FORCE_RISING)
        if self.needs_deadman and self._deadman.is_released(limits.deadman_age_s, now_ns):
            causes.add(Cause.DEADMAN_RELEASED)
        self.loop = self.loop.validated(now_ns)
        self.passing.clear()
        return causes

    def _look_at_tip(self) -> None:
        check, tip_mm = self._check_tip, self.inputs.tip_mm
        self._at_tip = _NONE if check is None or tip_mm is None else frozenset(check(*tip_mm))
