"""Monotonic time in nanoseconds on a real or virtual clock, and settings of the process for real time."""

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
        """Wait; at once where `seconds` is not positive."""


class SystemClock:
    """The clock of the machine; it does not jump when somebody sets the time of day."""

    def now_ns(self) -> int:
        """Return `time.monotonic_ns()`."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Sleep on the machine."""
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """A clock that moves when somebody sleeps on it or advances it: simulated time, and tests that do not wait."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._lock = threading.Lock()

    def now_ns(self) -> int:
        """Return the simulated time."""
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        """Advance the clock by `seconds`."""
        self.advance(seconds)

    def advance(self, seconds: float) -> None:
        """Move the clock forward; backward it does not go."""
        if seconds > 0:
            with self._lock:
                self._now_ns += round(seconds * _NANO)


class Deadline:
    """A moment on a clock by which something must have happened."""

    def __init__(self, clock: Clock, seconds: float) -> None:
        self._clock = clock
        self._end_ns = clock.now_ns() + round(seconds * _NANO)

    @property
    def left_s(self) -> float:
        """Seconds that are left; zero once it has passed."""
        return max(self._end_ns - self._clock.now_ns(), 0) / _NANO

    @property
    def passed(self) -> bool:
        """Whether it is too late."""
        return self._clock.now_ns() >= self._end_ns


_TURN_S = 0.0005


@contextmanager
def short_turns() -> Iterator[None]:
    """Let threads that compute take turns every half millisecond, in all of the process.

    Python's 5 ms are as long as everything from a sample to its command may take, and the loop shares its process with
    threads that read devices, write the recording and make plans.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _TURN_S))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@contextmanager
def no_long_collections() -> Iterator[None]:
    """Keep what is there now from being looked at by every full collection of garbage, in all of the process.

    That takes 40 ms and more with the libraries of an insertion, while a robot waits 30 ms for a sign of life.
    What comes meanwhile is collected as ever.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
