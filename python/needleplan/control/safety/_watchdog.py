"""The watchdog thread, which detects a loop that hangs."""

from __future__ import annotations

import contextlib
import threading
from typing import Protocol

from needleplan.devices import Closing
from needleplan.errors import MotionRefused

__all__ = ["Watchdog"]


class _Checked(Protocol):
    """Interface of the guard that the watchdog uses."""

    def check(self) -> object: ...

    def fail(self, error: Exception) -> object: ...


class Watchdog(Closing):
    """A thread that calls `guard.check()` every `period_s` of real time until it is closed.

    The thread thereby detects that the loop hangs, waits or computes for too long. If the whole process is suspended
    (by SIGSTOP, or by a garbage collection that holds the interpreter), the thread is suspended too, and stops the
    stage only when the process continues. Therefore every stage needs a watchdog of its own.

    If `check` raises an unexpected exception, the thread calls `guard.fail`, which stops the needle, and goes on.
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
            try:
                self._guard.check()
            except MotionRefused:  # another thread blocks the guard, which has sent a stop
                continue
            except Exception as error:
                with contextlib.suppress(Exception):
                    self._guard.fail(error)

    def close(self) -> None:
        """End the thread. Closing twice is harmless."""
        self._closing.set()
        self._thread.join()
