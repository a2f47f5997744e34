"""The commands that are in force at the stage, and the validation of the motion of both axes against them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from needleplan.control.safety._causes import Cause
from needleplan.control.safety._limits import SafetyLimits
from needleplan.devices import StageSample, Stamp

__all__ = ["VELOCITY_MARGIN", "Goal", "MotionWatch"]

_NANO = 1e-9
# longest time, s, that a stage needs to reverse its direction
_REVERSAL_S = 0.15
# longest time (s) between two samples that the clock of the stage may show; a longer one is an error of the clock
_LONGEST_GAP_S = 1.0
# ratio to the velocity limit above which a measured velocity is not explained by noise
VELOCITY_MARGIN = 1.5
# share of the commanded distance that an axis must have moved after `motion_s`; below, it counts as stuck
_STUCK_SHARE = 0.1
# time (s) in which an axis that has begun to move must go on by that share of its commanded motion
_STALL_S = 0.1
# commanded distances (mm, rad) below which an axis is never reported as stuck
_LEAST_MM, _LEAST_RAD = 0.1, 0.05


@dataclass(frozen=True)
class Goal:
    """Command to one axis: position at the start and goal (mm or rad), and commanded velocity.

    `begin_velocity` is the velocity at the start, `began_ns` the time of the start. `is_retraction` tells whether a
    person ordered the motion by `retract`. The progress is the distance from the start towards the goal. `best` is the
    largest progress, `mark` the progress at which `seen` has last noted a motion, and `mark_ns` the time of that
    sample.
    """

    begin: float
    end: float
    velocity: float
    begin_velocity: float
    began_ns: int
    is_retraction: bool = False
    turning: float = 0.0
    best: float = 0.0
    mark: float = 0.0
    mark_ns: int = 0

    def seen(self, position: float, least: float, now_ns: int) -> Goal:
        """Return the goal after a sample: with its largest progress, and with a new mark if the axis has gone on."""
        progress = self._progress(position)
        goal = replace(self, best=max(self.best, progress))
        if progress - self.mark >= _STUCK_SHARE * self.velocity * self._stall_s(least):
            return replace(goal, mark=progress, mark_ns=now_ns)
        return goal

    def stalled(self, position: float, least: float, tolerance: float, now_ns: int) -> bool:
        """Return whether the axis has begun to move and then stands still, farther from the goal than `tolerance`."""
        is_away = abs(self.end - position) > tolerance and self.best - self._progress(position) < least
        return is_away and self.mark > 0 and (now_ns - self.mark_ns) * _NANO > self._stall_s(least)

    def turned(self, position: float, tolerance: float) -> bool:
        """Return whether the axis has gone back by more than `tolerance`.

        Before the axis has moved towards the goal, it may go back by `turning`, too.
        """
        turning = self.turning if self.best <= tolerance else 0.0
        return self.best - self._progress(position) > tolerance + turning

    def _progress(self, position: float) -> float:
        return math.copysign(1.0, self.end - self.begin) * (position - self.begin)

    def _stall_s(self, least: float) -> float:
        return max(_STALL_S, least / self.velocity)

    def stuck(self, position: float, least: float, motion_s: float, now_ns: int) -> bool:
        """Return whether the axis has moved less than a tenth of its way although `motion_s` has passed.

        An axis that moved against the command at its start brakes first, and then passes its start again; that time is
        added. The result is False if the commanded distance is less than `least`.
        """
        distance = abs(self.end - self.begin)
        against = max(math.copysign(1.0, self.begin - self.end) * self.begin_velocity, 0.0)
        back_s = _REVERSAL_S * (1 + against / (2 * self.velocity)) if against else 0.0
        if distance < least or (now_ns - self.began_ns) * _NANO < motion_s + back_s:
            return False
        return abs(position - self.begin) < _STUCK_SHARE * min(distance, self.velocity * motion_s)

    def left(self, position: float, tolerance: float) -> bool:
        """Return whether `position` is outside the interval from the start to the goal by more than a margin.

        The margin is `tolerance` plus the distance in which the axis may reverse its direction, in mm or rad.
        """
        margin = tolerance + _REVERSAL_S * (abs(self.begin_velocity) + self.velocity)
        low, high = sorted((self.begin, self.end))
        return not low - margin <= position <= high + margin

    def waiting_since(self, position: float, least: float, now_ns: int) -> int:
        """Return the start time (ns) for the next goal.

        If the axis still waits to move to this goal, the time is `began_ns` of this goal, so that repeated commands do
        not hide a stuck axis; otherwise the time is `now_ns`.
        """
        waits = abs(position - self.begin) < least and abs(self.end - position) >= least
        return self.began_ns if waits else now_ns


@dataclass(frozen=True)
class MotionWatch:
    """Commands that the stage is carrying out, and the last stage sample."""

    depth: Goal | None = None
    roll: Goal | None = None
    stopped_ns: int = 0
    """Time (ns) of the last stop that ended a motion; 0 before the first such stop."""

    last: StageSample | None = None
    jumped: bool = False
    """Whether the last sample is farther from its predecessor than the stage can move, or has a lower number."""

    rest_mm: float | None = None
    """Depth (mm) at which the stage came to rest after the last stop; None while a command may move it."""

    rest_rad: float | None = None
    """Roll (rad) at which the stage came to rest after the last stop; None while a command may rotate it."""

    @property
    def retracting(self) -> bool:
        """Whether the command in force is a retraction by a person; every later command or stop ends the retraction."""
        return self.depth is not None and self.depth.is_retraction

    def inserts(self, depth_mm: float, velocity_mm_s: float, now_ns: int) -> MotionWatch:
        """Return a watch that expects the commanded insertion, inward or outward. Requires an earlier stage sample."""
        assert self.last is not None
        begin = self.last.depth_mm
        began_ns = now_ns if self.depth is None else self.depth.waiting_since(begin, _LEAST_MM, now_ns)
        turning = self._turning_mm(math.copysign(1.0, depth_mm - begin), velocity_mm_s)
        goal = Goal(begin, depth_mm, velocity_mm_s, self.last.velocity_mm_s, began_ns, turning=turning)
        return replace(self, depth=goal, rest_mm=None)

    def retracts(self, depth_mm: float, velocity_mm_s: float, now_ns: int) -> MotionWatch:
        """Return a watch that expects a retraction by a person. The depth is unknown before the first sample."""
        if self.last is None:
            turning = _REVERSAL_S * velocity_mm_s  # the present velocity is unknown
            goal = Goal(math.inf, depth_mm, velocity_mm_s, 0.0, now_ns, is_retraction=True, turning=turning)
            return replace(self, depth=goal)
        watch = self.inserts(depth_mm, velocity_mm_s, now_ns)
        assert watch.depth is not None
        return replace(watch, depth=replace(watch.depth, is_retraction=True))

    def rotates(self, roll_rad: float, velocity_rad_s: float, now_ns: int) -> MotionWatch:
        """Return a watch that expects the commanded rotation. Requires an earlier stage sample."""
        assert self.last is not None
        begin, before = self.last.roll_rad, self.roll
        began_ns = now_ns if before is None else before.waiting_since(begin, _LEAST_RAD, now_ns)
        begin_rad_s = 0.0 if before is None else before.velocity
        turning = _REVERSAL_S * (begin_rad_s + velocity_rad_s)  # the stage measures no velocity of the roll
        goal = Goal(begin, roll_rad, velocity_rad_s, begin_rad_s, began_ns, turning=turning)
        return replace(self, roll=goal, rest_rad=None)

    def _turning_mm(self, direction: float, velocity_mm_s: float) -> float:
        """Return how far the stage may go on against a new command while it turns round; 0 if it need not turn."""
        assert self.last is not None
        before, against_mm_s = self.depth, -direction * self.last.velocity_mm_s
        if before is not None and direction * (before.end - before.begin) < 0:
            against_mm_s = max(against_mm_s, before.velocity)
        return _REVERSAL_S * (against_mm_s + velocity_mm_s) if against_mm_s > _STUCK_SHARE * velocity_mm_s else 0.0

    def stops(self, now_ns: int) -> MotionWatch:
        """Return a watch that expects no motion. `stopped_ns` changes only if a command was being carried out."""
        idle = self.depth is None and self.roll is None
        stopped_ns = self.stopped_ns if idle else now_ns
        return replace(self, depth=None, roll=None, stopped_ns=stopped_ns, rest_mm=None, rest_rad=None)

    def rests(self) -> MotionWatch:
        """Return a watch that expects the stage to stay at the last measured depth and roll."""
        last = self.last
        return self if last is None else replace(self, rest_mm=last.depth_mm, rest_rad=last.roll_rad)

    def then(self, sample: StageSample, limits: SafetyLimits) -> MotionWatch:
        """Return the watch updated by a stage sample; a repeated or non-finite sample changes nothing.

        A retraction ends if the stage rests at its goal, or rests anywhere `motion_s` after the command.
        """
        last = self.last
        if not all(map(math.isfinite, (sample.depth_mm, sample.velocity_mm_s, sample.roll_rad))):
            return self  # no position to compare; without a usable sample within `stage_age_s`, the stage is suspect
        if last is None:
            depth = self.depth
            if depth is not None:
                depth = replace(depth, begin=sample.depth_mm)  # a retraction from an unknown depth
            return replace(self, depth=depth, last=sample)
        if sample.stamp.sequence == last.stamp.sequence:
            return self
        passed_s = _passed_s(last.stamp, sample.stamp)
        fastest_mm_s = max(limits.insertion_velocity_mm_s, limits.retraction_velocity_mm_s)
        farthest_mm = limits.following_mm + VELOCITY_MARGIN * fastest_mm_s * passed_s
        farthest_rad = limits.following_rad + VELOCITY_MARGIN * limits.rotation_velocity_rad_s * passed_s
        jumped = (
            sample.stamp.sequence < last.stamp.sequence
            or abs(sample.depth_mm - last.depth_mm) > farthest_mm
            or abs(sample.roll_rad - last.roll_rad) > farthest_rad
        )
        rest_mm, rest_rad = self.rest_mm, self.rest_rad
        if (sample.stamp.received_ns - self.stopped_ns) * _NANO > limits.motion_s:
            # `moving` concerns both axes: while one of them has a command, it tells nothing of the other one.
            if rest_mm is None and self.depth is None and not (sample.moving and self.roll is None):
                rest_mm = sample.depth_mm
            if rest_rad is None and self.roll is None and not (sample.moving and self.depth is None):
                rest_rad = sample.roll_rad
        now_ns = sample.stamp.received_ns
        depth = self.depth and self.depth.seen(sample.depth_mm, _LEAST_MM, now_ns)
        roll = self.roll and self.roll.seen(sample.roll_rad, _LEAST_RAD, now_ns)
        watch = MotionWatch(depth, roll, self.stopped_ns, sample, jumped, rest_mm, rest_rad)
        return watch.stops(sample.stamp.received_ns) if watch._has_retracted(sample, limits) else watch

    def _has_retracted(self, sample: StageSample, limits: SafetyLimits) -> bool:
        goal = self.depth
        if goal is None or not goal.is_retraction or sample.moving:
            return False
        waited_s = (sample.stamp.received_ns - goal.began_ns) * _NANO
        return abs(sample.depth_mm - goal.end) <= limits.following_mm or waited_s > limits.motion_s

    def causes(self, limits: SafetyLimits, now_ns: int) -> Iterator[Cause]:
        """Yield the causes for a stop that the motion of the stage gives at a time (ns)."""
        last = self.last
        if last is None:
            return
        if self.jumped:
            yield Cause.STAGE_JUMPED
        velocity_mm_s = last.velocity_mm_s
        limit_mm_s = limits.insertion_velocity_mm_s if velocity_mm_s > 0 else limits.retraction_velocity_mm_s
        if abs(velocity_mm_s) > VELOCITY_MARGIN * limit_mm_s:
            yield Cause.OVERSPEED
        if abs(last.roll_rad) > limits.roll_rad + limits.following_rad:
            yield Cause.ROLL_EXCEEDED
        idle_mm = self.depth is None and _left(last.depth_mm, self.rest_mm, limits.following_mm)
        idle_rad = self.roll is None and _left(last.roll_rad, self.rest_rad, limits.following_rad)
        if self.depth is None and self.roll is None:
            settled = (now_ns - self.stopped_ns) * _NANO > limits.motion_s
            if idle_mm or idle_rad or (settled and last.moving):
                yield Cause.STILL_MOVING
            return
        wrong, stuck, seen_ns = idle_mm or idle_rad, False, last.stamp.received_ns
        for goal, position, least, tolerance in (
            (self.depth, last.depth_mm, _LEAST_MM, limits.following_mm),
            (self.roll, last.roll_rad, _LEAST_RAD, limits.following_rad),
        ):
            if goal is not None:
                wrong |= goal.left(position, tolerance) or goal.turned(position, tolerance)
                stuck |= goal.stuck(position, least, limits.motion_s, now_ns)
                # A retraction may rest before its goal: that ends it (`then`).
                stuck |= goal.stalled(position, least, tolerance, seen_ns) and (last.moving or not goal.is_retraction)
        if wrong:
            yield Cause.WRONG_WAY
        if stuck:
            yield Cause.NO_MOTION


def _passed_s(before: Stamp, now: Stamp) -> float:
    """Return the time (s) between two samples: the longer one of the times by arrival and by the clock of the stage.

    If samples were lost while this machine was busy, the next ones arrive together, and only the stage knows the time.
    """
    arrived_s = max(now.received_ns - before.received_ns, 0) * _NANO
    if now.device_time_s is None or before.device_time_s is None:
        return arrived_s
    return max(arrived_s, min(now.device_time_s - before.device_time_s, _LONGEST_GAP_S))


def _left(position: float, rest: float | None, tolerance: float) -> bool:
    """Return whether an axis without a command has left its place of rest; False if the place is unknown."""
    return rest is not None and abs(position - rest) > tolerance
