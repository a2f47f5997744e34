"""Monotonic real and virtual clocks (nanoseconds), and settings of the Python process for real-time control."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

__all__ = ["Clock", "Deadline", "SystemClock", "VirtualClock", "no_long_collections", "short_turns"]

_NANO = 1_000_000_000


class Clock(Protocol):
    """A source of monotonic time."""

    def now_ns(self) -> int:
        """Return the time in nanoseconds since a fixed, unknown moment."""

    def sleep(self, seconds: float) -> None:
        """Wait for `seconds`; return at once if `seconds` is not positive."""


class SystemClock:
    """The monotonic clock of the machine, which is independent of the time of day."""

    def now_ns(self) -> int:
        """Return `time.monotonic_ns()`."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Let the calling thread sleep for `seconds`."""
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """A clock that moves only by `sleep` and `advance`: for simulated time, and for tests without waiting."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._lock = threading.Lock()

    def now_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        """Advance the clock by `seconds`."""
        self.advance(seconds)

    def advance(self, seconds: float) -> None:
        """Advance the clock by `seconds`; a negative value does nothing."""
        if seconds > 0:
            with self._lock:
                self._now_ns += round(seconds * _NANO)


class Deadline:
    """A moment on a clock, `seconds` after its creation."""

    def __init__(self, clock: Clock, seconds: float) -> None:
        self._clock = clock
        self._end_ns = clock.now_ns() + round(seconds * _NANO)

    @property
    def left_s(self) -> float:
        """Remaining time, s; 0 after the deadline."""
        return max(self._end_ns - self._clock.now_ns(), 0) / _NANO

    @property
    def passed(self) -> bool:
        """Whether the deadline has passed."""
        return self._clock.now_ns() >= self._end_ns


_TURN_S = 0.0005  # switch interval (s) between Python threads


@contextmanager
def short_turns() -> Iterator[None]:
    """Within the `with` block, let Python switch between its threads at least every 0.5 ms.

    Python's default of 5 ms is the entire time allowed from a sample to its command. The control loop shares its
    process with the threads that read devices, write the recording and compute plans.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _TURN_S))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@contextmanager
def no_long_collections() -> Iterator[None]:
    """Within the `with` block, exclude all objects that already exist from garbage collection in this process.

    A full garbage collection takes 40 ms or more with the libraries that an insertion imports, but the watchdog of a
    robot expires after 30 ms. Objects created later are collected as usual.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
