"""`needleplan stop`: a person stops the needle, whoever moves it.

A machine that is busy with other programs takes seconds to import the whole program. So `main` calls `stop_at_once`
first, which stops a robot (`udp://`, or `serial://` if another program owns the line) with the few modules that this
file imports. It leaves all other words (`--help`, mistakes, `canopen://`) to the whole program.
"""

from __future__ import annotations

import os
import sys

from needleplan.bystander import WITHIN_S, send_stop, stop
from needleplan.cli.estop import MOVES, EmergencyStop, say
from needleplan.line_owner import line_port
from needleplan.stopping import Rest

TYPE_CHECKING = False  # `typing` takes longer to import than all of this module

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence
    from typing import Any

    from needleplan.bystander import StopOutcome

__all__ = ["PlainOptions", "add_to", "plain_options", "print_answer", "run", "send_first_stop", "stop_at_once"]

_PORT = 5005  # port of the robot protocol
_INTERRUPTED_S = 2.0  # longest time (s) until the needle of an interrupted command rests
_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_")
_SWITCHES = {"--json": "json", "--quiet": "quiet", "-q": "quiet", "--verbose": "verbose", "-v": "verbose"}


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    from needleplan.cli.estop import add_estop
    from needleplan.cli.options import add_answer

    parser: argparse.ArgumentParser = commands.add_parser(
        "stop",
        help="stop the needle, whoever moves it",
        description="Stop both axes of the robot at once, whoever controls it. A run that controls it ends with a "
        "fault. The stop is sent again every 10 ms until the needle is measured at rest. This is no emergency stop: it "
        "needs the computer, the network and the robot's program. Exit code 3: the needle moves, or its rest is "
        "unknown.",
    )
    parser.add_argument(
        "--robot",
        required=True,
        metavar="URL",
        help="address of the robot: udp://, serial:// or canopen://, as for `insert`",
    )
    parser.add_argument(
        "--within", type=float, default=WITHIN_S, metavar="S",
        help=f"longest time to wait until the needle rests, s (default: {WITHIN_S:g})",
    )  # fmt: skip
    add_estop(parser)
    add_answer(parser)
    parser.set_defaults(run=run)


def stop_at_once(words: Sequence[str]) -> int | None:
    """Run `needleplan stop` with the words behind `stop`, and return the exit code.

    Returns None, without a stop, if the words are not the plain address of a robot and the options of the command.
    Raises KeyboardInterrupt if a person ends it before the needle was measured at rest.
    """
    found = plain_options(words, ("--robot", "--within", "--estop"), WITHIN_S)
    if found is None:
        return None
    hook = EmergencyStop(found.estop)
    try:
        outcome = stop(found.host, found.port, found.within_s, lambda outcome: _alarm(outcome, hook))
    except (OSError, UnicodeError):
        return None  # an unknown host: the whole program says so
    finally:
        hook.finish()
    if outcome.is_confirmed:
        return _say_stopped(found.url, outcome, "json" in found.switches)
    is_line = found.url.startswith("serial:")
    return _complain(outcome.why_not(found.url if is_line else f"udp://{found.host}:{found.port}"))


def run(options: argparse.Namespace) -> int:
    """Run the command, and return 0 if the needle is measured at rest, else 3. Raises InputError."""
    from needleplan.cli.estop import require_estop
    from needleplan.cli.interrupt import needle_measured
    from needleplan.devices import stop_stage
    from needleplan.errors import DeviceFault, InputError, Mistake

    if not 0 < options.within <= 3600:
        raise InputError(
            Mistake("--within", f"{options.within:g}", "must be a number of seconds above 0, at most 3600")
        )
    hook = require_estop(options.estop)
    try:
        outcome = stop_stage(options.robot, options.within, lambda outcome: _alarm(outcome, hook))
    except DeviceFault as fault:
        return _complain(str(fault))
    except KeyboardInterrupt:
        return _complain("interrupted: the needle was not measured at rest; use the emergency stop")
    finally:
        hook.finish()
    needle_measured()
    return _say_stopped(options.robot, outcome, options.json)


class PlainOptions:
    """Address, host, port, time limit (s), emergency command, name of the person and switches of a plain command."""

    url: str
    host: str
    port: int
    within_s: float
    estop: str
    by: str
    switches: set[str]

    def __init__(self, values: dict[str, str], switches: set[str], host: str, port: int, within_s: float) -> None:
        self.url, self.host, self.port, self.within_s = values["--robot"], host, port, within_s
        self.estop, self.by, self.switches = values.get("--estop", ""), values.get("--by", ""), switches


def plain_options(words: Sequence[str], names: tuple[str, ...], within_s: float) -> PlainOptions | None:
    """Parse the words of a command without argparse, or return None if only argparse can parse them.

    `names` are the options that take a value, and `within_s` (s) is the default of `--within`.
    """
    values, switches, at = {"--within": f"{within_s}"}, set(), 0
    while at < len(words):
        name, equals, value = words[at].partition("=")
        at += 1
        if name in names:
            if not equals and at < len(words):
                value, at = words[at], at + 1
            values[name] = value
        elif words[at - 1] in _SWITCHES:
            switches.add(_SWITCHES[name])
        else:
            return None
    place = _plain_place(values.get("--robot", ""))
    try:
        within_s = float(values["--within"])
    except ValueError:
        return None
    if place is None or not 0 < within_s <= 3600:
        return None
    return PlainOptions(values, switches, *place, within_s)


def _plain_place(url: str) -> tuple[str, int] | None:
    """Return host and port of the plain address of a robot; None for all others.

    For a robot on a serial line that a program owns, these are the host and port at which that program serves it.
    """
    scheme, _, rest = url.partition("://")
    if scheme == "serial":
        line = line_port(rest.partition("?")[0]) if url.isascii() and url.isprintable() else None
        return None if line is None else ("127.0.0.1", line)
    host, colon, port = rest.partition("?")[0].removesuffix("/").partition(":")
    is_plain = host and _PLAIN.issuperset(host) and url.isascii() and url.isprintable()
    if scheme != "udp" or not is_plain or not (port.isdigit() or not colon):
        return None
    number = int(port) if colon else _PORT
    return (host, number) if 0 < number <= 65_535 else None


def send_first_stop(words: Sequence[str]) -> Callable[[], bool]:
    """Send one STOP to the robot that the words behind `stop` or `retract` name, if they name one plainly.

    The command itself stops the needle until it rests, but only after the whole program is imported. Returns what a
    signal until then calls: a function that stops the needle, and returns whether it was measured at rest.
    """
    place = _plain_place(_last_value(words, "--robot"))
    if place is None:
        return lambda: False
    try:
        send_stop(*place)
    except (OSError, UnicodeError):
        return lambda: False  # the command says what is wrong
    return lambda: _stop_interrupted(*place, _last_value(words, "--estop"))


def _last_value(words: Sequence[str], name: str) -> str:
    """Return the value of an option that stands last, or ""."""
    values = [
        word.partition("=")[2] if word.startswith(f"{name}=") else after
        for word, after in zip(words, [*words, ""][1:], strict=True)
        if word == name or word.startswith(f"{name}=")
    ]
    return values[-1] if values else ""


def _stop_interrupted(host: str, port: int, estop: str) -> bool:
    """Stop the needle of an interrupted command, and return whether it was measured at rest."""
    hook = EmergencyStop(estop)
    try:
        return stop(host, port, _INTERRUPTED_S, lambda outcome: _alarm(outcome, hook)).is_confirmed
    except (OSError, UnicodeError):
        return False
    finally:
        hook.finish()


def _alarm(outcome: StopOutcome, hook: EmergencyStop) -> None:
    """Tell the person that the needle moves or may move, and call the emergency stop."""
    if outcome.rest is Rest.MOVES:
        _complain("the needle still moves; use the emergency stop (the stop is still being sent)")
    else:
        why = "no answer to the stop" if outcome.result is None else "the robot reports no position, or too rarely"
        _complain(f"robot: {why}; the needle may still move: use the emergency stop (the stop is still being sent)")
    hook.trip()


def _say_stopped(url: str, outcome: StopOutcome, as_json: bool) -> int:
    """Print the answer, and return 0: the needle rests, even if nobody reads the answer."""
    answer = f"{url}\n  stopped      the needle was measured at rest after {1e3 * outcome.took_s:.1f} ms"
    if as_json:
        answer = f'{{\n  "stopped": true,\n  "took_s": {outcome.took_s!r},\n  "moved_mm": {outcome.moved_mm!r}\n}}'
    print_answer(answer)
    return 0


def print_answer(answer: str) -> None:
    """Print the answer; the exit code tells of the needle, even if nobody reads the answer."""
    try:
        print(answer)
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(text: str) -> int:
    say(text)
    return MOVES
