"""The command line, `needleplan`.

This module imports nothing that takes long, so that Ctrl-C is already handled while the commands are imported.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType, TracebackType
from typing import Never

__all__ = ["main"]

# Exit code after Ctrl-C.
_INTERRUPTED = 130
_MESSAGE = "needleplan: interrupted"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that `arguments` describe, and return the exit code; 130 after Ctrl-C.

    If `arguments` is None, the arguments are those of the process (`sys.argv[1:]`); a handler of Ctrl-C is then
    installed, and Ctrl-C ends the process. Raises SystemExit for `--help`, `--version` and wrong usage.
    """
    interrupt = _Interrupt() if arguments is None else None
    try:
        from needleplan.cli.program import run_command

        return run_command(arguments)
    except KeyboardInterrupt:
        if interrupt:
            interrupt.exit()
        print(_MESSAGE, file=sys.stderr)
        return _INTERRUPTED
    except Exception:
        # A library may turn the interrupt into another exception, above all while it is imported.
        if interrupt and interrupt.received:
            interrupt.exit()
        raise
    finally:
        if interrupt:
            interrupt.end()


class _Interrupt:
    """Handler of Ctrl-C, installed by the constructor unless the process ignores Ctrl-C already.

    The first Ctrl-C raises KeyboardInterrupt, so that files are closed; the second ends the process at once. A forked
    child process is ended at once by the first Ctrl-C.
    """

    def __init__(self) -> None:
        self.received = False
        self._process = os.getpid()
        self._caught = signal.getsignal(signal.SIGINT) is not signal.SIG_IGN  # a background job of a shell ignores it
        if self._caught:
            signal.signal(signal.SIGINT, self._receive)
            sys.unraisablehook = self._unraisable
            sys.excepthook = self._uncaught

    def end(self) -> None:
        """Let Ctrl-C end the process without Python: Python would print a traceback for Ctrl-C during its shutdown."""
        if self._caught:
            signal.signal(signal.SIGINT, signal.SIG_DFL)

    def _receive(self, _: int, __: FrameType | None) -> None:
        if self.received or os.getpid() != self._process:
            self.exit()
        self.received = True
        raise KeyboardInterrupt

    def _unraisable(self, what: sys.UnraisableHookArgs) -> None:
        """End the process if KeyboardInterrupt was raised in a destructor or callback, where Python cannot pass it on.

        Other exceptions are reported as usual.
        """
        if what.exc_type is KeyboardInterrupt:
            self.exit()
        sys.__unraisablehook__(what)

    def _uncaught(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """End the process without traceback if the uncaught exception is the KeyboardInterrupt of Ctrl-C.

        C code, such as `import_array` of numpy, may report the exception here. Others are reported as usual.
        """
        if self.received and issubclass(kind, KeyboardInterrupt):
            self.exit()
        sys.__excepthook__(kind, error, trace)

    def exit(self) -> Never:
        """Print "interrupted" (not in a forked child) and end the process at once with exit code 130.

        `sys.exit` is not used, because a further Ctrl-C during the shutdown could change the exit code.
        """
        if os.getpid() == self._process:
            os.write(2, f"{_MESSAGE}\n".encode())
        os._exit(_INTERRUPTED)
