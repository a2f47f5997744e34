"""A thread of its own that looks at the guard when the loop does not.

It sees a loop that hangs, waits or computes for too long. Where the whole process stands still (SIGSTOP, a collection
of garbage that holds the interpreter) it stands still too, and stops the stage as soon as it goes on; meanwhile only
the watchdog of the drive helps, which a stage must have of its own.
"""

from __future__ import annotations

import contextlib
import threading

from needleplan.control.safety.guard import GuardedStage
from needleplan.devices import Closing
from needleplan.errors import MotionRefused

__all__ = ["Watchdog"]


class Watchdog(Closing):
    """Calls `guard.check()` every `period_s` in real time until it is closed."""

    def __init__(self, guard: GuardedStage, period_s: float = 0.005) -> None:
        self._guard, self._period_s = guard, period_s
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether somebody watches."""
        return self._thread.is_alive()

    def _watch(self) -> None:
        while not self._ending.wait(self._period_s):
            with contextlib.suppress(MotionRefused):
                self._guard.check()

    def close(self) -> None:
        """Stop watching; closing twice is harmless."""
        self._ending.set()
        self._thread.join()
