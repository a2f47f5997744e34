"""Whether a stage does what it was told: follows its command, moves at all, stands still when it was stopped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from needleplan.control.safety.causes import Cause
from needleplan.control.safety.limits import SafetyLimits
from needleplan.devices import StageSample

__all__ = ["Goal", "MotionWatch"]

_NANO = 1e-9
_TURNING_S = 0.15
"""A stage that moves the other way has turned round after this time."""

_MARGIN = 1.5
"""Measured speeds have noise; beyond this times the limit they are no noise."""

_LEAST_SHARE = 0.1
_LEAST_MM, _LEAST_RAD = 0.1, 0.05


@dataclass(frozen=True)
class Goal:
    """A command to one axis: from where, to where, how fast (mm or rad), and when."""

    begin: float
    end: float
    velocity: float
    begin_velocity: float
    began_ns: int

    def stuck(self, position: float, least: float, motion_s: float, now_ns: int) -> bool:
        """Whether hardly anything of the way is done though there was time."""
        way = abs(self.end - self.begin)
        if way < least or (now_ns - self.began_ns) * _NANO < motion_s:
            return False
        return abs(position - self.begin) < _LEAST_SHARE * min(way, self.velocity * motion_s)

    def waiting_since(self, position: float, least: float, now_ns: int) -> int:
        """Return when the next goal begins: now, or earlier where the stage has not stirred for this one either."""
        waits = abs(position - self.begin) < least and abs(self.end - position) >= least
        return self.began_ns if waits else now_ns


@dataclass(frozen=True)
class MotionWatch:
    """What the stage was told, and the last samples of it."""

    depth: Goal | None = None
    roll: Goal | None = None
    told_ns: int = 0
    """When it was last told to stop; from the beginning it is told nothing."""

    last: StageSample | None = None
    jumped: bool = False
    rest_mm: float | None = None

    def inserts(self, depth_mm: float, velocity_mm_s: float, now_ns: int) -> MotionWatch:
        """Return the watch after a command to insert or to retract; there must have been a sample."""
        assert self.last is not None
        begin = self.last.depth_mm
        began_ns = now_ns if self.depth is None else self.depth.waiting_since(begin, _LEAST_MM, now_ns)
        goal = Goal(begin, depth_mm, velocity_mm_s, self.last.velocity_mm_s, began_ns)
        return replace(self, depth=goal, rest_mm=None)

    def rotates(self, roll_rad: float, velocity_rad_s: float, now_ns: int) -> MotionWatch:
        """Return the watch after a command to rotate; there must have been a sample."""
        assert self.last is not None
        begin = self.last.roll_rad
        began_ns = now_ns if self.roll is None else self.roll.waiting_since(begin, _LEAST_RAD, now_ns)
        return replace(self, roll=Goal(begin, roll_rad, velocity_rad_s, 0.0, began_ns), rest_mm=None)

    def stops(self, now_ns: int) -> MotionWatch:
        """Return the watch after a stop; one that has had a command has time to come to rest."""
        idle = self.depth is None and self.roll is None
        return replace(self, depth=None, roll=None, told_ns=self.told_ns if idle else now_ns, rest_mm=None)

    def sees(self, sample: StageSample, limits: SafetyLimits) -> MotionWatch:
        """Return the watch after a sample."""
        last = self.last
        if last is None:
            return replace(self, last=sample)
        if sample.stamp.sequence == last.stamp.sequence:
            return self
        passed_s = max(sample.stamp.received_ns - last.stamp.received_ns, 0) * _NANO
        fastest_mm_s = max(limits.insertion_velocity_mm_s, limits.retraction_velocity_mm_s)
        farthest_mm = limits.following_mm + _MARGIN * fastest_mm_s * passed_s
        jumped = sample.stamp.sequence < last.stamp.sequence or abs(sample.depth_mm - last.depth_mm) > farthest_mm
        idle = self.depth is None and self.roll is None
        settled = idle and (sample.stamp.received_ns - self.told_ns) * _NANO > limits.motion_s
        rest_mm = sample.depth_mm if settled and self.rest_mm is None and not sample.moving else self.rest_mm
        return MotionWatch(self.depth, self.roll, self.told_ns, sample, jumped, rest_mm)

    def judge(self, limits: SafetyLimits, now_ns: int) -> Iterator[Cause]:
        """Yield what is wrong with the motion."""
        last = self.last
        if last is None:
            return
        if self.jumped:
            yield Cause.STAGE_JUMPED
        velocity_mm_s = last.velocity_mm_s
        limit_mm_s = limits.insertion_velocity_mm_s if velocity_mm_s > 0 else limits.retraction_velocity_mm_s
        if abs(velocity_mm_s) > _MARGIN * limit_mm_s:
            yield Cause.OVERSPEED
        if self.depth is None and self.roll is None:
            if self._restless(last, limits, now_ns):
                yield Cause.STILL_MOVING
            return
        if self.depth is not None:
            goal = self.depth
            room_mm = limits.following_mm + _TURNING_S * (abs(goal.begin_velocity) + goal.velocity)
            low, high = sorted((goal.begin, goal.end))
            if not low - room_mm <= last.depth_mm <= high + room_mm:
                yield Cause.WRONG_WAY
            if goal.stuck(last.depth_mm, _LEAST_MM, limits.motion_s, now_ns):
                yield Cause.NO_MOTION
        if self.roll is not None and self.roll.stuck(last.roll_rad, _LEAST_RAD, limits.motion_s, now_ns):
            yield Cause.NO_MOTION

    def _restless(self, last: StageSample, limits: SafetyLimits, now_ns: int) -> bool:
        if (now_ns - self.told_ns) * _NANO <= limits.motion_s:
            return False
        moved = self.rest_mm is not None and abs(last.depth_mm - self.rest_mm) > limits.following_mm
        return last.moving or moved
