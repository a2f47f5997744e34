"""Whether the run is being recorded: what is not in the recording has not happened."""

from __future__ import annotations

from dataclasses import dataclass, replace

from needleplan.control.safety.causes import Cause
from needleplan.control.safety.limits import SafetyLimits
from needleplan.recording import RecorderState, RecorderStatus

__all__ = ["RecordWatch"]

_NANO = 1e-9


@dataclass(frozen=True)
class RecordWatch:
    """The last status of the recorder, and when messages were last lost; without a status, nothing is asked."""

    status: RecorderStatus | None = None
    lost: int = 0
    lost_ns: int | None = None

    def sees(self, status: RecorderStatus, now_ns: int) -> RecordWatch:
        """Return the watch after a status."""
        lost = sum(status.overflowed.values()) + status.refused
        if lost > self.lost:
            return RecordWatch(status, lost, now_ns)
        return replace(self, status=status)

    def judge(self, limits: SafetyLimits, now_ns: int) -> frozenset[Cause]:
        """Return what is wrong with the recording. A loss is over, but stays latched, after `recording_age_s`."""
        status, limit_s = self.status, limits.recording_age_s
        if status is None:
            return frozenset()
        recently = self.lost_ns is not None and (now_ns - self.lost_ns) * _NANO <= limit_s
        if recently or status.state in (RecorderState.FAILED, RecorderState.CLOSED):
            return frozenset({Cause.RECORDING_LOST})
        if status.state is RecorderState.STALLED or status.behind_s > limit_s:
            return frozenset({Cause.RECORDING_BEHIND})
        return frozenset()
