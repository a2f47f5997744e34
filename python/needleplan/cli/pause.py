"""`needleplan pause` and `needleplan resume`: a person interrupts a run of another terminal.

As for `needleplan stop`, `main` calls `order_at_once` before the whole program is imported.
"""

from __future__ import annotations

from needleplan.cli.estop import MOVES, not_at_rest, say
from needleplan.cli.stop import plain_options, print_answer
from needleplan.order_client import OrderReply, order_place, send_to
from needleplan.stopping import Rest

TYPE_CHECKING = False  # `typing` takes longer to import than all of this module

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from typing import Any

__all__ = ["add_to", "order_at_once", "run_pause", "run_resume"]

# Exit codes: the order is refused; there is no run
_REFUSED, _NO_RUN = 1, 2
_WITHIN_S = 10.0  # longest time (s) until the reply of the run


def add_to(commands: Any) -> None:
    """Declare both commands."""
    from needleplan.cli.options import add_answer

    pause: argparse.ArgumentParser = commands.add_parser(
        "pause",
        help="pause a run of another terminal",
        description="Pause the run of `needleplan insert` on this machine that controls the robot: the needle stops, "
        "and the run waits for `needleplan resume`. Exit code 3: the needle moves, or its rest is unknown, as without "
        "such a run; `needleplan stop` stops the robot itself.",
    )
    resume: argparse.ArgumentParser = commands.add_parser(
        "resume",
        help="let a paused run go on",
        description="Let a run that a person has paused go on, as soon as the needle was measured at rest. Exit code "
        "1: refused; 2: no such run on this machine.",
    )
    for parser, run in ((pause, run_pause), (resume, run_resume)):
        parser.add_argument("--robot", required=True, metavar="URL", help="address of the robot, as of the run")
        parser.add_argument("--by", default="", metavar="NAME", help="name of the person who gives the order")
        parser.add_argument(
            "--within", type=float, default=_WITHIN_S, metavar="S",
            help=f"longest time to wait for the run, s (default: {_WITHIN_S:g})",
        )  # fmt: skip
        add_answer(parser)
        parser.set_defaults(run=run)


def order_at_once(words: Sequence[str]) -> int | None:
    """Run `needleplan pause` or `resume`, the first of the words, and return the exit code.

    Returns None, without an order, unless the others are the plain UDP address of a robot and options of the command.
    """
    found = plain_options(words[1:], ("--robot", "--within", "--by"), _WITHIN_S)
    if found is None or found.url.startswith("serial:"):
        return None
    reply = send_to(order_place("udp", found.host, found.port), words[0], found.by, found.within_s)
    answer = _answer_pause if words[0] == "pause" else _answer_resume
    return answer(reply, found.url, "json" in found.switches)


def run_pause(options: argparse.Namespace) -> int:
    """Run `needleplan pause`, and return 0 if the needle was measured at rest, else 3. Raises InputError."""
    return _answer_pause(_ordered(options, "pause"), options.robot, options.json)


def run_resume(options: argparse.Namespace) -> int:
    """Run `needleplan resume`, and return 0 if the run goes on, 1 if not, 2 without a run. Raises InputError."""
    return _answer_resume(_ordered(options, "resume"), options.robot, options.json)


def _ordered(options: argparse.Namespace, order: str) -> OrderReply | None:
    from needleplan.control import send_order
    from needleplan.control.safety import Order
    from needleplan.errors import InputError, Mistake

    if not 0 < options.within <= 3600:
        rule = "must be a number of seconds above 0, at most 3600"
        raise InputError(Mistake("--within", f"{options.within:g}", rule))
    return send_order(options.robot, Order(order), options.by, options.within)


def _answer_pause(reply: OrderReply | None, url: str, as_json: bool) -> int:
    if reply is None:
        say("no run on this machine answers for this robot, so the needle may still move; use `needleplan stop`")
        return MOVES
    if reply.rest is not Rest.RESTS:
        say(f"{not_at_rest(reply.rest)}; use the emergency stop")
        return MOVES
    if reply.refused:
        say(f"{reply.refused}; the needle was measured at rest")
        return _REFUSED
    _print(reply, url, as_json, "the needle was measured at rest")
    return 0


def _answer_resume(reply: OrderReply | None, url: str, as_json: bool) -> int:
    if reply is None:
        say("no run on this machine answers for this robot")
        return _NO_RUN
    if reply.refused:
        say(reply.refused)
        return _REFUSED
    _print(reply, url, as_json, "the run goes on")
    return 0


def _print(reply: OrderReply, url: str, as_json: bool, text: str) -> None:
    answer = f"{url}\n  state        {reply.state}: {text}"
    if as_json:
        answer = f'{{\n  "state": "{reply.state}",\n  "rest": "{reply.rest}"\n}}'
    print_answer(answer)
