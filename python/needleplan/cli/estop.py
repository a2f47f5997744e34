"""The command of the option `--estop`, which cuts the power of the drives if a needle moves in spite of a stop.

`needleplan stop` uses this module before the whole program is imported, so it imports nothing that takes long.
"""

from __future__ import annotations

import sys

from needleplan.stopping import Rest

TYPE_CHECKING = False  # `typing` takes 10 ms to import

if TYPE_CHECKING:
    import subprocess
    from typing import Any

__all__ = ["MOVES", "EmergencyStop", "add_estop", "alarm", "not_at_rest", "require_estop", "say"]

MOVES = 3
"""Exit code: the needle moves, or its rest is unknown."""

# longest time (s) for which the end of the command is awaited
_WITHIN_S = 10.0


def add_estop(parser: Any) -> None:
    """Declare `--estop COMMAND`."""
    parser.add_argument(
        "--estop", metavar="COMMAND", default="",
        help="command to run once if the needle moves in spite of a stop, as to cut the power of the drives",
    )  # fmt: skip


def require_estop(command: str) -> EmergencyStop:
    """Return the emergency stop that runs a command. Raises InputError if this machine has no such program."""
    import shlex
    import shutil

    from needleplan.errors import InputError, Mistake

    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(Mistake("--estop", command, f"is not a command: {error}")) from None
    if command and (not words or shutil.which(words[0]) is None):
        raise InputError(Mistake("--estop", command, "must begin with the name of a program of this machine"))
    return EmergencyStop(command)


class EmergencyStop:
    """Runs a command once, at the first call of `trip`; an empty command does nothing. Any thread may call `trip`."""

    def __init__(self, command: str) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._is_tripped = False
        self.alarms = 0
        """Number of alarms: a needle that moves, or may move, in spite of a stop."""

    def trip(self) -> None:
        """Begin to run the command, unless it was run before; say on standard error what was done."""
        if self._is_tripped or not self._command:
            return
        self._is_tripped = True
        import shlex
        import subprocess

        try:
            self._process = subprocess.Popen(
                shlex.split(self._command), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
            )
        except (OSError, ValueError) as error:
            say(f"the emergency stop {self._command!r} cannot be run: {error}")
            return
        say(f"the emergency stop is called: {self._command}")

    def finish(self) -> None:
        """Wait at most 10 s for the end of the command, and say on standard error if it has failed."""
        if self._process is None:
            return
        import subprocess

        try:
            code = self._process.wait(_WITHIN_S)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            say(f"the emergency stop {self._command!r} has not ended")
            return
        if code:
            say(f"the emergency stop {self._command!r} has failed with the exit code {code}")


def not_at_rest(rest: Rest) -> str:
    """Return a warning for a needle that is not at rest after a stop: it moves, or its position is unknown."""
    if rest is Rest.UNKNOWN:
        return "the needle may still move: its position is unknown"
    return "the needle still moves"


def alarm(rest: Rest, hook: EmergencyStop) -> None:
    """Warn on standard error that the needle may still move after a stop, and run the emergency stop command."""
    say(f"{not_at_rest(rest)}; use the emergency stop")
    hook.alarms += 1
    hook.trip()


def say(text: str) -> None:
    """Print a line on standard error; without a terminal, print nothing: a stop must not depend on it."""
    try:
        print(f"needleplan: {text}", file=sys.stderr, flush=True)
    except OSError:
        return
