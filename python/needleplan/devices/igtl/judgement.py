"""Whether a pose that came by OpenIGTLink may be used: what its server says of it, its age, what a needle can do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from needleplan.devices.base import Health, PoseSample, Stamp
from needleplan.devices.igtl.poses import Pose
from needleplan.devices.pose_samples import FARTHEST_MM, continuous, unseen
from needleplan.errors import DeviceFault

__all__ = ["PoseJudge", "PoseLimits"]

_NANO = 1_000_000_000
_IDENTITY = Pose((0.0, 0.0, 0.0))
"""What PLUS sends for a coil that it does not see, with a status that header version 1 has no place for."""


@dataclass(frozen=True)
class PoseLimits:
    """When a pose is suspect, and when the tracker is given up."""

    start_s: float = 3.0
    """The first pose must have come so long after the start."""

    silence_s: float = 0.5
    """No new pose for so long: the server has stopped tracking, or leaves out a coil that it does not see."""

    late_s: float = 0.1
    """A pose that took so much longer than the fastest one lay in a queue: its age is not what it seems."""

    damaged: int = 10
    """So many damaged messages without a whole one between them: another protocol, or a bad line."""

    speed_mm_s: float = 200.0
    """Faster than this is another tool, or a bad fit."""

    distortion: float = 0.01
    """So far a rotation may be from being one."""


class PoseJudge:
    """Follows one tool through the frames; `rate_hz` is that of the tracker, 0 where it is not known."""

    def __init__(self, limits: PoseLimits, rate_hz: float = 0.0) -> None:
        self.limits, self.rate_hz = limits, rate_hz
        self._last: PoseSample | None = None
        self._timestamp = 0
        self._fastest_ns: int | None = None

    def judge(self, pose: Pose | None, timestamp: int, status: str, now_ns: int) -> PoseSample | None:
        """Return the sample of a frame; None where it is the last one again. Raises DeviceFault.

        `pose` is None where the tool is not in the frame, `status` what the server says of it, empty for nothing.
        `timestamp` is in units of 2**-32 s.
        """
        if timestamp and timestamp == self._timestamp:
            return None
        if timestamp < self._timestamp:
            back_s = (self._timestamp - timestamp) / (1 << 32)
            raise DeviceFault(f"tracker: its time went back by {back_s:.3g} s: it was restarted, or its clock was set")
        notes = self._notes(timestamp, now_ns)
        sample = self._sample(pose, status, self._stamp(timestamp, now_ns), notes)
        self._last, self._timestamp = sample, timestamp
        return sample

    def _stamp(self, timestamp: int, now_ns: int) -> Stamp:
        last = self._last
        lost = 0
        if last is not None and self.rate_hz and timestamp:
            lost = max(round((timestamp - self._timestamp) / (1 << 32) * self.rate_hz) - 1, 0)
        number = 0 if last is None else last.stamp.sequence + 1 + lost
        return Stamp(now_ns, number, lost, timestamp / (1 << 32) if timestamp else None)

    def _notes(self, timestamp: int, now_ns: int) -> tuple[str, ...]:
        if not timestamp:
            return ("without a time: it may be an old one",)
        took_ns = now_ns - (timestamp * _NANO >> 32)
        self._fastest_ns = took_ns if self._fastest_ns is None else min(self._fastest_ns, took_ns)
        late_s = (took_ns - self._fastest_ns) / _NANO
        return (f"{late_s:.3g} s late",) if late_s > self.limits.late_s else ()

    def _sample(self, pose: Pose | None, status: str, stamp: Stamp, notes: tuple[str, ...]) -> PoseSample:
        missing = unseen(stamp, "not seen", *notes)
        if pose is None:
            return missing
        if status not in ("", "OK"):
            # PLUS sends the identity then, which looks like a pose.
            return replace(missing, notes=(f"not seen: {status}", *notes))
        if not status and pose == _IDENTITY:
            return replace(missing, notes=("not seen, or exactly at the origin", *notes))
        numbers = (*pose.position_mm, pose.distortion)
        if not all(map(math.isfinite, numbers)) or max(map(abs, numbers)) > FARTHEST_MM:
            return replace(missing, notes=("not a pose", *notes))
        if not pose.oriented:
            notes += ("position without orientation",)
        if pose.distortion > self.limits.distortion:
            notes += (f"no rotation: off by {pose.distortion:.3g}",)
        notes += self._step(pose, stamp)
        health = Health.SUSPECT if notes else Health.GOOD
        return continuous(PoseSample(stamp, pose.position_mm, pose.quaternion, math.nan, health, notes), self._last)

    def _step(self, pose: Pose, stamp: Stamp) -> tuple[str, ...]:
        last = self._last
        if last is None or last.health is Health.MISSING:
            return ()
        step_mm = math.dist(pose.position_mm, last.position_mm)
        if stamp.device_time_s is None or last.stamp.device_time_s is None:
            passed_s = (stamp.received_ns - last.stamp.received_ns) / _NANO
        else:
            passed_s = stamp.device_time_s - last.stamp.device_time_s
        # What comes within a millisecond was measured with some noise, and may seem fast.
        return (f"a step of {step_mm:.3g} mm",) if step_mm > self.limits.speed_mm_s * max(passed_s, 0.001) else ()
