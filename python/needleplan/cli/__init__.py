"""The command line, `needleplan`.

This module imports nothing that takes long, so that Ctrl-C is already handled while the commands are imported.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from needleplan.cli.interrupt import INTERRUPTED, MESSAGE, Interrupt

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that `arguments` describe, and return the exit code; 130 after Ctrl-C.

    If `arguments` is None, the arguments are those of the process (`sys.argv[1:]`); handlers of Ctrl-C, SIGTERM and
    SIGHUP are then installed, and these signals end the process. Raises SystemExit for `--help`, `--version` and wrong
    usage.
    """
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
