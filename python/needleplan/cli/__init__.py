"""The command line, `needleplan`.

This module imports nothing that takes long, so that `needleplan stop`, `pause` and `retract` act before anything else
is imported, and Ctrl-C is already handled while the other commands are imported.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # `typing` takes 10 ms to import

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that `arguments` describe, and return the exit code; 130 after Ctrl-C.

    If `arguments` is None, the arguments are those of the process (`sys.argv[1:]`); handlers of Ctrl-C, SIGTERM and
    SIGHUP are then installed, and these signals end the process. Raises SystemExit for `--help`, `--version` and wrong
    usage.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] in (["stop"], ["pause"], ["resume"]):
        code = _at_once(words, is_process=arguments is None)
        if code is not None:
            return code
    stop = _first_stop(words)
    from needleplan.cli.interrupt import (
        INTERRUPTED,
        Interrupt,
        ending,
        interrupted_ending,
        needle_measured,
        needle_unmeasured,
    )

    needle_measured()
    if stop is not None:
        needle_unmeasured(stop)
    interrupt = Interrupt() if arguments is None else None
    try:
        if stop is not None:
            _hold_signals(False)
        from needleplan.cli.program import run_command

        return ending(run_command(arguments))
    except KeyboardInterrupt:
        if interrupt:
            interrupt.exit()
        code, message = interrupted_ending(INTERRUPTED)
        print(message, file=sys.stderr)
        return code
    except Exception:
        # A library may turn the interrupt into another exception, above all while it is imported.
        if interrupt and interrupt.received:
            interrupt.exit()
        if not ending(0):
            raise
        import traceback

        traceback.print_exc()
        return ending(0)
    finally:
        if interrupt:
            interrupt.end()


def _at_once(words: Sequence[str], *, is_process: bool) -> int | None:
    """Run `stop`, `pause` or `resume` with few imports, and return the exit code; None if the words are unusual.

    A signal that ends the process before the needle was measured at rest ends it with 3.
    """
    from needleplan.cli.estop import MOVES, say

    if is_process:
        _hold_signals(True)
        _handle_signals(lambda *_: _raise_interrupt())
    try:
        if is_process:
            _hold_signals(False)
        if words[0] == "stop":
            from needleplan.cli.stop import stop_at_once

            code = stop_at_once(words[1:])
        else:
            from needleplan.cli.pause import order_at_once

            code = order_at_once(words)
    except KeyboardInterrupt:
        say("interrupted: the needle was not measured at rest; use the emergency stop")
        code = MOVES
    if is_process and code == MOVES:
        _handle_signals(None)  # a further signal must not give another exit code
    return code


def _raise_interrupt() -> None:
    """Raise KeyboardInterrupt, once: the command is ended by the first signal, and says so."""
    _handle_signals(None)
    raise KeyboardInterrupt


def _handle_signals(handler: Callable[..., None] | None) -> None:
    """Let a function receive the signals that end a command; None: ignore them. Those ignored before stay ignored."""
    import signal

    for name in _ENDING:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler or signal.SIG_IGN)


# Signals that end a command; Windows has no SIGHUP, and cannot hold signals back
_ENDING = ("SIGINT", "SIGTERM", "SIGHUP")


def _first_stop(words: Sequence[str]) -> Callable[[], bool] | None:
    """Send the first stop of `retract` or `stop` before the whole program is imported; hold signals back until then.

    Returns what stops the needle if a signal ends the command before the needle was measured at rest; None for a
    command that stops no needle.
    """
    if words[:1] not in (["stop"], ["retract"], ["pause"]) or {"--help", "-h"}.intersection(words):
        return None
    _hold_signals(True)
    if words[0] == "pause":
        return lambda: False
    from needleplan.cli.stop import send_first_stop

    return send_first_stop(words[1:])


def _hold_signals(is_held: bool) -> None:
    """Hold back the signals that end a command, or let them in."""
    import signal

    if hasattr(signal, "pthread_sigmask"):
        names = {getattr(signal, name) for name in _ENDING}
        signal.pthread_sigmask(signal.SIG_BLOCK if is_held else signal.SIG_UNBLOCK, names)
