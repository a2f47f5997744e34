"""Validation of the poses of one tool that are received by OpenIGTLink."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needleplan.devices._base import PoseSample, Stamp
from needleplan.devices._pose_validation import PoseValidator
from needleplan.devices.igtl.poses import IgtlPose
from needleplan.errors import DeviceFault

__all__ = ["IgtlPoseLimits", "IgtlPoseValidator"]

_NANO = 1_000_000_000
_SHORTEST_S = 0.001  # shortest time (s) from which the speed of a pose is computed; shorter times amplify noise

# PLUS sends this pose for a coil that is not visible; header version 1 has no field for the status of the coil.
_IDENTITY = IgtlPose((0.0, 0.0, 0.0))


@dataclass(frozen=True)
class IgtlPoseLimits:
    """Limits above which a pose is SUSPECT, or the tracker raises an error."""

    start_s: float = 3.0  # longest time from the start to the first pose; then ConfigurationError
    silence_s: float = 0.5  # time without a new pose after which the tracker raises DeviceFault
    late_s: float = 0.1  # transmission time beyond the shortest one so far above which a pose is SUSPECT (outdated)
    damaged: int = 10  # number of damaged messages in succession at which the tracker raises DeviceFault
    speed_mm_s: float = 200.0  # speed between two poses above which a pose is SUSPECT
    distortion: float = 0.01  # `IgtlPose.distortion` (deviation from a rotation) above which a pose is SUSPECT


class IgtlPoseValidator(PoseValidator):
    """Validates the poses of one tool; `rate_hz` is the frame rate of the tracker, 0 if unknown."""

    def __init__(self, limits: IgtlPoseLimits, rate_hz: float = 0.0) -> None:
        super().__init__()
        self.limits, self.rate_hz = limits, rate_hz
        self._timestamp = 0
        self._fastest_ns: int | None = None

    def validate(self, pose: IgtlPose | None, timestamp: int, status: str, now_ns: int) -> PoseSample | None:
        """Return the sample of a new frame, or None if the frame is repeated.

        `pose` is None if the tool is not in the frame. `timestamp` is in units of 2**-32 s, 0 if unknown. `status` is
        the status of the tool that the server reports, or "". Raises DeviceFault if `timestamp` goes back, also to 0.
        """
        if timestamp and timestamp == self._timestamp:
            return None
        if timestamp < self._timestamp:
            back_s = (self._timestamp - timestamp) / (1 << 32)
            raise DeviceFault(
                f"tracker: its time went back by {back_s:.3g} s: it was restarted, or its clock was changed"
            )
        notes = self._notes(timestamp, now_ns)
        self.last = self._sample(pose, status, self._stamp(timestamp, now_ns), notes)
        self._timestamp = timestamp
        return self.last

    def _stamp(self, timestamp: int, now_ns: int) -> Stamp:
        last = self.last
        lost = 0
        if last is not None and self.rate_hz and timestamp:
            lost = max(round((timestamp - self._timestamp) / (1 << 32) * self.rate_hz) - 1, 0)
        number = 0 if last is None else last.stamp.sequence + 1 + lost
        return Stamp(now_ns, number, lost, timestamp / (1 << 32) if timestamp else None)

    def _notes(self, timestamp: int, now_ns: int) -> tuple[str, ...]:
        if not timestamp:
            return ("without a time: the pose may be outdated",)
        took_ns = now_ns - (timestamp * _NANO >> 32)
        self._fastest_ns = took_ns if self._fastest_ns is None else min(self._fastest_ns, took_ns)
        late_s = (took_ns - self._fastest_ns) / _NANO
        return (f"{late_s:.3g} s late",) if late_s > self.limits.late_s else ()

    def _sample(self, pose: IgtlPose | None, status: str, stamp: Stamp, notes: tuple[str, ...]) -> PoseSample:
        if pose is None:
            return self.missing(stamp, "not seen", notes)
        if status not in ("", "OK"):
            return self.missing(stamp, f"not seen: {status}", notes)
        if not status and pose == _IDENTITY:
            return self.missing(stamp, "not seen, or exactly at the origin", notes)
        if not self.are_plausible((*pose.position_mm, pose.distortion)):
            return self.missing(stamp, "not a pose", notes)
        if not pose.oriented:
            notes += ("position without orientation",)
        if pose.distortion > self.limits.distortion:
            notes += (f"not a rotation: deviation {pose.distortion:.3g}",)
        most_step_mm = self.limits.speed_mm_s * max(self._passed_s(stamp), _SHORTEST_S)
        return self.sample(stamp, pose.position_mm, pose.quaternion, math.nan, notes, most_step_mm)

    def _passed_s(self, stamp: Stamp) -> float:
        """Return the time (s) since the last sample, on the clock of the tracker if both samples have its time."""
        last = stamp if self.last is None else self.last.stamp
        if stamp.device_time_s is None or last.device_time_s is None:
            return (stamp.received_ns - last.received_ns) / _NANO
        return stamp.device_time_s - last.device_time_s
