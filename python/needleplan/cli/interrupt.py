"""Signals that end a command: Ctrl-C (SIGINT), SIGTERM, and SIGHUP, which a closed terminal sends.

All three are handled alike: the first raises KeyboardInterrupt, so that files are closed and devices are stopped, and
the second ends the process at once. Commands that end in their own way while they run, such as `insert`, use
`handled_signals`. A command that has to stop a needle ends with 130 only if the needle was measured at rest, else with
3 (`needle_unmeasured`). A signal that the process already ignores stays ignored: SIGHUP under `nohup`, SIGINT in a
background job of a shell. Only `handled_signals` takes SIGINT also then, because a moving needle must be stoppable.

A command that ends while the needle moves calls `needle_moves`: it then ends with 3, whatever else happens to it.

This module imports nothing that takes long.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import Never

__all__ = [
    "INTERRUPTED", "MESSAGE", "Interrupt", "end_if_interrupted", "ended_at_once", "ending", "handled_signals",
    "interrupted_ending", "needle_measured", "needle_moves", "needle_unmeasured",
]  # fmt: skip

INTERRUPTED = 130
"""Exit code after Ctrl-C; after another signal, the exit code is 128 and the number of the signal."""

MESSAGE = "needleplan: interrupted"

# Exit code and message if the needle moves, or its rest is unknown
_MOVES = 3
_UNMEASURED = _MOVES, "needleplan: interrupted: the needle was not measured at rest; use the emergency stop"

# Stops the needle and returns whether it was measured at rest; None if the command owes no such stop
_measured_stop: Callable[[], bool] | None = None
# Whether the command ends while the needle moves, or its rest is unknown
_is_moving = False


def needle_unmeasured(stop: Callable[[], bool]) -> None:
    """From now on, a signal that ends the command calls `stop`, and ends with 3 if `stop` does not return True."""
    global _measured_stop
    _measured_stop = stop


def needle_measured() -> None:
    """Note that the command owes no stop: it measured the needle at rest, or it stops no needle."""
    global _measured_stop, _is_moving
    _measured_stop, _is_moving = None, False


def needle_moves() -> None:
    """Note that the command ends while the needle moves, or its rest is unknown.

    It then ends with 3, even if a signal arrives, nobody reads its answer, or its answer cannot be written.
    """
    global _is_moving
    needle_unmeasured(lambda: False)
    _is_moving = True


def ending(code: int) -> int:
    """Return the exit code of a command that would end with `code`: 3 if the needle moves."""
    return _MOVES if _is_moving else code


def interrupted_ending(code: int) -> tuple[int, str]:
    """Return exit code and message of a command that a signal ends, usually `code` and "interrupted".

    A needle that was not measured at rest is stopped first; a further signal meanwhile ends the process at once.
    """
    stop = _measured_stop
    if stop is None:
        return code, MESSAGE
    needle_unmeasured(lambda: False)
    if not stop():
        return _UNMEASURED
    needle_measured()
    return code, MESSAGE


# whether the first signal ends the process at once
_is_ended_at_once = False


@contextlib.contextmanager
def ended_at_once() -> Iterator[None]:
    """Within the context, the first signal ends the process at once: nothing is open that must be closed or removed.

    Otherwise a long computation would first wind up its threads, which takes its time on a busy machine.
    """
    global _is_ended_at_once
    _is_ended_at_once = True
    try:
        yield
    finally:
        _is_ended_at_once = False


# The handler of this process, if it is installed
_handler: Interrupt | None = None


def end_if_interrupted(*_: object) -> None:
    """End the process if a signal was received that a library has swallowed: it caught KeyboardInterrupt, and went on.

    Commands call it while they compute.
    """
    if _handler is not None and _handler.received:
        _handler.exit()


def _caught_signals() -> list[signal.Signals]:
    """Return the signals that end a command, without those that the process ignores."""
    names = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
    found = [signal.Signals(getattr(signal, name)) for name in names if hasattr(signal, name)]
    return [each for each in found if signal.getsignal(each) is not signal.SIG_IGN]


@contextlib.contextmanager
def handled_signals(handle: Callable[[str], object]) -> Iterator[None]:
    """Within the context, call `handle` with the reason when a signal asks the command to end.

    The reason is "Ctrl-C", "asked to end" or "the terminal was closed". Restores the handlers at the end.
    """
    reasons = {"SIGINT": "Ctrl-C", "SIGTERM": "asked to end", "SIGHUP": "the terminal was closed"}
    caught = {signal.SIGINT, signal.SIGTERM, *_caught_signals()}
    before = {each: signal.signal(each, lambda number, _: handle(reasons[signal.Signals(number).name]))
              for each in caught}  # fmt: skip
    try:
        yield
    finally:
        for each, action in before.items():
            signal.signal(each, action)


class Interrupt:
    """Handler of the signals that end a command, installed by the constructor.

    The first signal raises KeyboardInterrupt, so that files are closed; the second ends the process at once. A forked
    child process, and a process within `ended_at_once`, is ended at once by the first signal.
    """

    def __init__(self) -> None:
        self.received: int = 0
        """Number of the first received signal, or 0."""
        self._process = os.getpid()
        self._caught = _caught_signals()
        for each in self._caught:
            signal.signal(each, self._receive)
        global _handler
        _handler = self
        if self._caught:
            sys.unraisablehook = self._unraisable
            sys.excepthook = self._uncaught

    def end(self) -> None:
        """Let signals end the process without Python: Python would print a traceback for Ctrl-C during its shutdown.

        If the needle moves, signals are ignored: the exit code of the process is 3.
        """
        global _handler
        _handler = None
        for each in self._caught:
            signal.signal(each, signal.SIG_IGN if _is_moving else signal.SIG_DFL)

    def _receive(self, number: int, _: FrameType | None) -> None:
        first, self.received = self.received, self.received or number
        if first or _is_ended_at_once or os.getpid() != self._process:
            self.exit()
        raise KeyboardInterrupt

    def _unraisable(self, what: sys.UnraisableHookArgs) -> None:
        """End the process if KeyboardInterrupt was raised in a destructor or callback, where Python cannot pass it on.

        Other exceptions are reported as usual.
        """
        if what.exc_type is KeyboardInterrupt:
            self.exit()
        sys.__unraisablehook__(what)

    def _uncaught(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """End the process without traceback if the uncaught exception is the KeyboardInterrupt of a signal.

        C code, such as `import_array` of numpy, may report the exception here. Others are reported as usual.
        """
        if self.received and issubclass(kind, KeyboardInterrupt):
            self.exit()
        sys.__excepthook__(kind, error, trace)

    def exit(self) -> Never:
        """Print "interrupted" (not in a forked child) and end the process at once with the exit code of the signal.

        See `interrupted_ending` for a command that has to stop a needle.

        Files that are being written are removed: an interrupt inside `__enter__` of a context manager never reaches its
        `__exit__`. `sys.exit` is not used, because a further signal during the shutdown could change the exit code.
        """
        code = 128 + self.received if self.received else INTERRUPTED
        if os.getpid() == self._process:
            code, message = interrupted_ending(code)
            files = sys.modules.get("needleplan.artifacts.files")  # not imported: it takes time, and may be half there
            if remove := getattr(files, "remove_unfinished", None):
                remove()
            with contextlib.suppress(OSError):  # the terminal may be gone
                os.write(2, f"{message}\n".encode())
        os._exit(code)
