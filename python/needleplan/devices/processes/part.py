"""How the process of a device says where it is, and how it ends: it is told so, or the one that started it is gone."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TypeVar

__all__ = ["Failed", "Ready", "Served", "call_at_end", "place_or_tell", "tell"]

_Device = TypeVar("_Device")


@dataclass(frozen=True)
class Ready:
    """The device is there."""

    address: str


@dataclass(frozen=True)
class Failed:
    """The device cannot be where it is to be."""

    why: str


@dataclass(frozen=True)
class Served:
    """What a process has to tell at its end."""

    ticks: int = 0
    overruns: int = 0
    worst_overrun_s: float = 0.0


def place_or_tell(boss: Connection, place: Callable[[], _Device]) -> _Device | None:
    """Return the device at its place, or tell why it cannot be there."""
    try:
        return place()
    except (OSError, OverflowError) as error:
        boss.send(Failed(str(getattr(error, "strerror", None) or error)))
        return None


def call_at_end(boss: Connection, end: Callable[[], None]) -> None:
    """Call `end` when the process is to end: it is told so, gets SIGTERM, or the one that started it is gone."""
    # Ctrl-C comes to all processes of a terminal; the one that started this one tells it what to do.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: end())

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            boss.recv()
        end()

    threading.Thread(target=wait, daemon=True).start()


def tell(boss: Connection, last_words: Served) -> None:
    """Tell what there is to tell at the end, if anybody hears it."""
    with contextlib.suppress(OSError):
        boss.send(last_words)
