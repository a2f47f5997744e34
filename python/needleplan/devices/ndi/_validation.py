"""Validation of the frames that an NDI tracker sends for one tool."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needleplan.devices._base import PoseSample, Stamp
from needleplan.devices._pose_validation import PoseValidator
from needleplan.devices.ndi.frames import PORT_SUSPECT, SYSTEM_SUSPECT, Frames, NdiVisibility, ToolFrame, bits_of
from needleplan.errors import DeviceFault

__all__ = ["NdiPoseLimits", "NdiPoseValidator"]

_WRAP = 1 << 32
_HARDWARE_FAILURE, _HARDWARE_CHANGE, _PLUGGED = 0x10, 0x20, 0xC0  # bits of the system status
_SOUND_PORT = 0x31 | 0x0E  # bits of the port status that are not faults: tool in port, initialised, enabled; switches


@dataclass(frozen=True)
class NdiPoseLimits:
    """Frame rate of the tracker, and limits above which a pose is SUSPECT or the tracker raises DeviceFault."""

    rate_hz: float = 40.0  # frame rate of the tracker, which converts frame numbers to times
    silence_s: float = 0.5  # time without a new frame after which the tracker raises DeviceFault
    reply_s: float = 12.0  # longest time from a command to its reply; then DeviceFault
    gap_s: float = 0.1  # pause between the bytes of a reply after which the reply counts as truncated
    late_s: float = 0.2  # time from a request to its reply above which the pose is SUSPECT (it may be outdated)
    damaged: int = 10  # number of damaged replies in succession at which the tracker raises DeviceFault
    most_error_mm: float = 1.0  # fit error above which a pose is SUSPECT
    step_mm: float = 5.0  # change of the position from one frame to the next above which a pose is SUSPECT
    norm_tolerance: float = 0.01  # deviation of the quaternion's length from one above which a pose is SUSPECT


class NdiPoseValidator(PoseValidator):
    """Validates the frames of the tool with the handle `handle`."""

    def __init__(self, handle: int, limits: NdiPoseLimits) -> None:
        super().__init__()
        self.handle, self.limits = handle, limits
        self._first = True
        self._new_frame_ns = 0

    def validate(self, frames: Frames, now_ns: int, took_s: float = 0.0) -> PoseSample | None:
        """Return the sample of a new frame, or None if the frame is repeated.

        `took_s` is the time from the request to its reply. Raises DeviceFault if the tool is missing or disabled, if
        the tracker reports a hardware failure or plugged tools, if frame numbers go back, or after `silence_s` without
        a new frame.
        """
        self._check_system(frames.system_status)
        found = [tool for tool in frames.tools if tool.handle == self.handle]
        if len(found) != 1:
            raise DeviceFault(f"tracker: handle {self.handle:02X} occurs {len(found)} times in the reply")
        tool = found[0]
        if tool.visibility in (NdiVisibility.DISABLED, NdiVisibility.UNOCCUPIED) or tool.frame is None:
            raise DeviceFault(
                f"tracker: the tool with handle {self.handle:02X} is {tool.visibility} in the middle of the run"
            )
        lost = 0
        if self.last is not None:
            ahead = (tool.frame - self.last.stamp.sequence) % _WRAP
            if ahead == 0:
                self._check_progress(now_ns - round(took_s * 1e9))
                return None
            if ahead >= _WRAP // 2:
                raise DeviceFault("tracker: its frame number went back: it was restarted")
            lost = ahead - 1
        stamp = Stamp(now_ns, tool.frame, lost, tool.frame / self.limits.rate_hz)
        notes = bits_of(frames.system_status, SYSTEM_SUSPECT)
        if took_s > self.limits.late_s:
            notes += (f"the reply took {took_s:.3g} s",)
        self.last, self._new_frame_ns = self._sample(tool, stamp, notes), now_ns
        return self.last

    def _check_progress(self, asked_ns: int) -> None:
        still_s = (asked_ns - self._new_frame_ns) / 1e9
        if still_s > self.limits.silence_s:
            raise DeviceFault(f"tracker: no new frame for {still_s:.3g} s: it has stopped tracking")

    def _check_system(self, status: int) -> None:
        first, self._first = self._first, False
        if status & _HARDWARE_FAILURE:
            raise DeviceFault(f"tracker: hardware failure (system status {status:04X})")
        # The first reply reports tools plugged in before the start. A later change is a fault, because the handle may
        # then belong to another tool.
        if not first and status & (_PLUGGED | _HARDWARE_CHANGE):
            raise DeviceFault(
                f"tracker: tools were plugged in or out (system status {status:04X}): is it the same tool?"
            )

    def _sample(self, tool: ToolFrame, stamp: Stamp, notes: tuple[str, ...]) -> PoseSample:
        limits, port = self.limits, tool.port_status or 0
        notes += bits_of(port, PORT_SUSPECT)
        if unknown := port & ~_SOUND_PORT & ~sum(PORT_SUSPECT):
            notes += (f"port status {unknown:08X}",)
        if tool.visibility is NdiVisibility.MISSING:
            return self.missing(stamp, "not seen", notes)
        norm = math.sqrt(math.fsum(each * each for each in tool.quaternion))
        if not self.are_plausible((*tool.position_mm, tool.error_mm, norm)) or norm < 0.5:
            return self.missing(stamp, "not a pose", notes)
        if abs(norm - 1) > limits.norm_tolerance:
            notes += (f"quaternion of length {norm:.3g}",)
        if tool.error_mm > limits.most_error_mm:
            notes += (f"fit error {tool.error_mm:.3g} mm",)
        frames = 1 if self.last is None else (stamp.sequence - self.last.stamp.sequence) % _WRAP
        w, x, y, z = (each / norm for each in tool.quaternion)
        return self.sample(stamp, tool.position_mm, (w, x, y, z), tool.error_mm, notes, limits.step_mm * frames)
