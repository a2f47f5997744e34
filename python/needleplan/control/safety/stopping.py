"""What the guard sends to a stage besides commands: stops, repeated until the stage stands still, and heartbeats."""

from __future__ import annotations

from needleplan.devices import Clock, Stage, StageSample
from needleplan.errors import DeviceFault

__all__ = ["Heartbeat", "Stopping"]

_NANO = 1e-9
_AGAIN_S = 0.02
_IN_VAIN_S = 0.25
"""A stop that did not reach the stage is sent again after so long."""

_SHARE, _LONGEST_S = 10.0, 1.0
"""Where a stop takes its time, as over a slow link, it takes at most a tenth of all time, so that others get theirs."""

_HEARTBEAT_S = 0.005
"""Shortest time between two heartbeats: a sixth of the watchdog of a robot (0.03 s)."""


class Stopping:
    """The stop of one stage; `wanted` until it has arrived and the stage has said that it stands still."""

    def __init__(self, stage: Stage, clock: Clock) -> None:
        self._stage, self._clock = stage, clock
        self._sent_ns = 0
        self._arrived = True
        self._again_ns = 0
        self.wanted = False

    def send(self) -> int:
        """Send a stop, and return when. Raises DeviceFault where it did not reach the stage."""
        self.wanted = True
        sent_ns = self._clock.now_ns()
        self._arrived = False
        try:
            self._stage.stop()
            self._arrived = True
        finally:
            self._sent_ns = now_ns = self._clock.now_ns()
            took_s = (now_ns - sent_ns) * _NANO
            wait_s = max(_AGAIN_S if self._arrived else _IN_VAIN_S, min(_SHARE * took_s, _LONGEST_S))
            self._again_ns = now_ns + round(wait_s / _NANO)
        return sent_ns

    def due(self, now_ns: int) -> bool:
        """Whether it is time to send it again."""
        return self.wanted and now_ns >= self._again_ns

    def sees(self, sample: StageSample) -> None:
        """See whether the stage stands still since the last stop."""
        if self._arrived and not sample.moving and sample.stamp.received_ns > self._sent_ns:
            self.wanted = False


class Heartbeat:
    """Sends the heartbeat of one stage, at most every 5 ms; nothing else in the package sends it."""

    def __init__(self, stage: Stage, now_ns: int) -> None:
        self._stage = stage
        self._sent_ns = now_ns

    def send(self, now_ns: int) -> DeviceFault | None:
        """Send a heartbeat if one is due; return the fault of the stage if the heartbeat could not be sent."""
        if (now_ns - self._sent_ns) * _NANO < _HEARTBEAT_S:
            return None
        self._sent_ns = now_ns
        try:
            self._stage.heartbeat()
        except DeviceFault as error:
            return error
        return None
