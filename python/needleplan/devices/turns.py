"""How long a thread of Python may keep the others from running."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["short_turns"]

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
