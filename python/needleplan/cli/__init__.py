"""The command line, `needleplan`.

This module imports nothing that takes long, so that `needleplan stop`, `pause` and `retract` act before anything else
is imported, and Ctrl-C is already handled while the other commands are imported.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # `typing` takes 10 ms to import

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that `arguments` describe, and return the exit code; 130 after Ctrl-C.

    If `arguments` is None, the arguments are those of the process (`sys.argv[1:]`); handlers of Ctrl-C, SIGTERM and
    SIGHUP are then installed, and these signals end the process. Raises SystemExit for `--help`, `--version` and wrong
    usage.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["stop"]:
        from needleplan.cli.stop import stop_at_once

        code = stop_at_once(words[1:])
        if code is not None:
            return code
    if words[:1] == ["retract"]:
        from needleplan.cli.stop import send_first_stop

        send_first_stop(words[1:])
    if words[:1] in (["pause"], ["resume"]):
        from needleplan.cli.pause import order_at_once

        code = order_at_once(words)
        if code is not None:
            return code
    from needleplan.cli.interrupt import INTERRUPTED, MESSAGE, Interrupt

    interrupt = Interrupt() if arguments is None else None
    try:
        from needleplan.cli.program import run_command

        return run_command(arguments)
    except KeyboardInterrupt:
        if interrupt:
            interrupt.exit()
        print(MESSAGE, file=sys.stderr)
        return INTERRUPTED
    except Exception:
        # A library may turn the interrupt into another exception, above all while it is imported.
        if interrupt and interrupt.received:
            interrupt.exit()
        raise
    finally:
        if interrupt:
            interrupt.end()
