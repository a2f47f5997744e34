"""Repetition of stops, the heartbeat of the stage, and the watchdog thread."""

from __future__ import annotations

import contextlib
import threading
from typing import Protocol

from needleplan.devices import Clock, Closing, Stage, StageSample
from needleplan.errors import DeviceFault, MotionRefused

__all__ = ["Heartbeat", "RepeatedStop", "Watchdog"]

_NANO = 1e-9
# time (s) after which a stop that has reached the stage is sent again
_AGAIN_S = 0.02
# time (s) after which a stop that has not reached the stage is sent again
_UNSENT_S = 0.25
# Wait after a slow stop: 10 times the duration of sending it, at most 1 s. Stops then use at most about a tenth of the
# time of the link, and heartbeats and samples can pass.
_WAIT_FACTOR, _LONGEST_WAIT_S = 10.0, 1.0
# shortest time (s) between two heartbeats: a sixth of the watchdog time of a robot (0.03 s)
_HEARTBEAT_S = 0.005


class RepeatedStop:
    """Repeats the stop of one stage. `wanted` is True from `send` until a stop has arrived and the stage is at rest."""

    def __init__(self, stage: Stage, clock: Clock) -> None:
        self._stage, self._clock = stage, clock
        self._sent_ns = 0
        self._arrived = True
        self._again_ns = 0
        self.wanted = False

    def send(self) -> int:
        """Send a stop and return the time (ns) of sending. Raises the DeviceFault of the stage."""
        self.wanted = True
        sent_ns = self._clock.now_ns()
        self._arrived = False
        try:
            self._stage.stop()
            self._arrived = True
        finally:
            self._sent_ns = now_ns = self._clock.now_ns()
            took_s = (now_ns - sent_ns) * _NANO
            wait_s = max(_AGAIN_S if self._arrived else _UNSENT_S, min(_WAIT_FACTOR * took_s, _LONGEST_WAIT_S))
            self._again_ns = now_ns + round(wait_s / _NANO)
        return sent_ns

    def due(self, now_ns: int) -> bool:
        """Return whether the stop must be sent again now."""
        return self.wanted and now_ns >= self._again_ns

    def observe(self, sample: StageSample) -> None:
        """End the repetition if `sample` shows the stage at rest and arrived after the last stop was sent."""
        if self._arrived and not sample.moving and sample.stamp.received_ns > self._sent_ns:
            self.wanted = False


class Heartbeat:
    """Sends the heartbeat to one stage, at most every 5 ms. No other code of the package sends it during a run."""

    def __init__(self, stage: Stage, now_ns: int) -> None:
        self._stage = stage
        self._sent_ns = now_ns

    def send(self, now_ns: int) -> DeviceFault | None:
        """Send a heartbeat if the last one is at least 5 ms old. Return the DeviceFault of the stage, or None."""
        if (now_ns - self._sent_ns) * _NANO < _HEARTBEAT_S:
            return None
        self._sent_ns = now_ns
        try:
            self._stage.heartbeat()
        except DeviceFault as error:
            return error
        return None


class _Checked(Protocol):
    """Interface of the guard that the watchdog uses."""

    def check(self) -> object: ...


class Watchdog(Closing):
    """A thread that calls `guard.check()` every `period_s` of real time until it is closed.

    The thread thereby detects that the loop hangs, waits or computes for too long. If the whole process is suspended
    (by SIGSTOP, or by a garbage collection that holds the interpreter), the thread is suspended too, and stops the
    stage only when the process continues. Therefore every stage needs a watchdog of its own.
    """

    def __init__(self, guard: _Checked, period_s: float = 0.005) -> None:
        self._guard, self._period_s = guard, period_s
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread is running."""
        return self._thread.is_alive()

    def _watch(self) -> None:
        while not self._closing.wait(self._period_s):
            with contextlib.suppress(MotionRefused):
                self._guard.check()

    def close(self) -> None:
        """End the thread. Closing twice is harmless."""
        self._closing.set()
        self._thread.join()
