"""The heartbeat of the stage, and the watchdog thread, which detects a loop that hangs."""

from __future__ import annotations

import contextlib
import threading
from typing import Protocol

from needleplan.devices import Closing, Stage
from needleplan.errors import DeviceFault, MotionRefused

__all__ = ["Heartbeat", "Watchdog"]

_NANO = 1e-9
# shortest time (s) between two heartbeats: a sixth of the watchdog time of a robot (0.03 s)
_HEARTBEAT_S = 0.005


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
