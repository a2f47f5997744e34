"""Whether a pose of a tracked coil may be used: what the device says of it, and what a needle can do in one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from needleplan.devices.base import Health, PoseSample, Stamp
from needleplan.devices.ndi.frames import PORT_SUSPECT, SYSTEM_SUSPECT, Frames, Seen, ToolFrame, bits_of
from needleplan.devices.pose_samples import FARTHEST_MM, continuous, unseen
from needleplan.errors import DeviceFault

__all__ = ["PoseJudge", "PoseLimits"]

_WRAP = 1 << 32
_HARDWARE_FAILURE, _HARDWARE_CHANGE, _PLUGGED = 0x10, 0x20, 0xC0
_SOUND_PORT = 0x31 | 0x0E  # tool in port, initialised, enabled; switches


@dataclass(frozen=True)
class PoseLimits:
    """When a pose is suspect, and when the tracker is given up."""

    rate_hz: float = 40.0
    silence_s: float = 0.5
    """No new frame for so long, though the device answers: it has stopped tracking."""

    reply_s: float = 12.0
    """The longest that a device may think about a reply."""

    gap_s: float = 0.1
    """A reply whose bytes stop for so long is cut short."""

    late_s: float = 0.2
    """A reply that took longer carries a pose of unknown age."""

    damaged: int = 10
    """So many damaged replies in a row are a wrong speed or a bad cable."""

    most_error_mm: float = 1.0
    """A worse fit than this is suspect."""

    step_mm: float = 5.0
    """Farther than this in one frame is another tool, or a bad fit."""

    norm_tolerance: float = 0.01
    """A quaternion may be so far from length one."""


class PoseJudge:
    """Follows one tool, given by its handle, through the frames."""

    def __init__(self, handle: int, limits: PoseLimits) -> None:
        self.handle, self.limits = handle, limits
        self._last: PoseSample | None = None
        self._first = True
        self._seen_ns = 0

    def judge(self, frames: Frames, now_ns: int, took_s: float = 0.0) -> PoseSample | None:
        """Return the sample of a new frame; None where it is the last one again. Raises DeviceFault.

        `took_s` is how long the reply took.
        """
        self._check_system(frames.system_status)
        found = [tool for tool in frames.tools if tool.handle == self.handle]
        if len(found) != 1:
            raise DeviceFault(f"tracker: handle {self.handle:02X} is {len(found)} times in the reply")
        tool = found[0]
        if tool.seen in (Seen.DISABLED, Seen.UNOCCUPIED) or tool.frame is None:
            raise DeviceFault(
                f"tracker: the tool with handle {self.handle:02X} is {tool.seen} in the middle of the run"
            )
        lost = 0
        if self._last is not None:
            ahead = (tool.frame - self._last.stamp.sequence) % _WRAP
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
        sample = self._sample(tool, stamp, notes)
        self._last, self._seen_ns = sample, now_ns
        return sample

    def _check_progress(self, asked_ns: int) -> None:
        still_s = (asked_ns - self._seen_ns) / 1e9
        if still_s > self.limits.silence_s:
            raise DeviceFault(f"tracker: the same frame for {still_s:.3g} s: it has stopped tracking")

    def _check_system(self, status: int) -> None:
        first, self._first = self._first, False
        if status & _HARDWARE_FAILURE:
            raise DeviceFault(f"tracker: hardware failure (system status {status:04X})")
        # The first reply tells of what was plugged in before; later a handle may have gone to another tool.
        if not first and status & (_PLUGGED | _HARDWARE_CHANGE):
            raise DeviceFault(
                f"tracker: tools were plugged in or out (system status {status:04X}): is it the same tool?"
            )

    def _sample(self, tool: ToolFrame, stamp: Stamp, notes: tuple[str, ...]) -> PoseSample:
        port = tool.port_status or 0
        notes += bits_of(port, PORT_SUSPECT)
        if strange := port & ~_SOUND_PORT & ~sum(PORT_SUSPECT):
            notes += (f"port status {strange:08X}",)
        missing = unseen(stamp, "not seen", *notes)
        if tool.seen is Seen.MISSING:
            return missing
        norm = math.sqrt(math.fsum(each * each for each in tool.quaternion))
        numbers = (*tool.position_mm, tool.error_mm, norm)
        if not all(map(math.isfinite, numbers)) or max(map(abs, numbers)) > FARTHEST_MM or norm < 0.5:
            return replace(missing, notes=("not a pose", *notes))
        if abs(norm - 1) > self.limits.norm_tolerance:
            notes += (f"quaternion of length {norm:.3g}",)
        if tool.error_mm > self.limits.most_error_mm:
            notes += (f"fit error {tool.error_mm:.3g} mm",)
        notes += self._step(tool.position_mm, stamp.sequence)
        w, x, y, z = (each / norm for each in tool.quaternion)
        sample = PoseSample(
            stamp, tool.position_mm, (w, x, y, z), tool.error_mm, Health.SUSPECT if notes else Health.GOOD, notes
        )
        return continuous(sample, self._last)

    def _step(self, position_mm: tuple[float, float, float], frame: int) -> tuple[str, ...]:
        last = self._last
        if last is None or last.health is Health.MISSING:
            return ()
        step_mm = math.dist(position_mm, last.position_mm)
        frames = (frame - last.stamp.sequence) % _WRAP
        return (f"a step of {step_mm:.3g} mm",) if step_mm > self.limits.step_mm * frames else ()
