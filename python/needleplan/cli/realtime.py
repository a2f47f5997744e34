"""`needleplan check-realtime`: how promptly this machine stops a robot, and whether `insert` may rely on it."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from needleplan.cli.answer import complain, print_json
from needleplan.cli.options import add_answer, require_rules
from needleplan.errors import InputError, Mistake

__all__ = ["REMEDY", "add_to", "require_prompt"]

_LONGEST_S = 3600.0  # longest measurement (s)
REMEDY = (
    "give the program a real-time priority (`chrt -f 20 needleplan ...`, as root) or an isolated core "
    "(`isolcpus`, `taskset`), and measure again with the same priority"
)
"""What a person can do against limits that do not hold."""


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "check-realtime",
        help="measure how promptly this machine stops a robot",
        description="Measure the time from a sample of a simulated robot to its STOP, and the gaps between heartbeats, "
        "beside two busy threads. `insert` with a real robot refuses to begin if the last measurement on this machine, "
        "with the same priority, does not hold its limits. Exit code 1: a limit does not hold.",
    )
    parser.add_argument(
        "--robot-line", choices=("udp", "pty"), default="udp",
        help="connection of the robot: UDP, or the pseudo-terminal of a serial line (default: udp)",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="duration (default: 60)")
    add_answer(parser, verbose=False)
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Measure, write the measurement, print it, and return the exit code: 1 if a limit does not hold, else 0."""
    from needleplan.config import Number
    from needleplan.control.realtime import measure_promptness, measured_file

    require_rules(options, {"--seconds": Number("s", above=0, at_most=_LONGEST_S)})
    found = measure_promptness(options.seconds, line=options.robot_line == "pty")
    try:
        found.write()
    except OSError as error:
        complain(f"{measured_file(found.priority, line=found.line)}: cannot be written: {error.strerror}")
    if options.json:
        limits = [
            {"limit": name, "worst_ms": worst_ms, "limit_ms": limit_ms, "holds": holds}
            for name, worst_ms, limit_ms, holds in found.limits
        ]
        print_json({**asdict(found), "limits": limits, "holds": found.holds})
        return int(not found.holds)
    print(f"{found.stops} stops and {found.gaps} heartbeats in {found.seconds:g} s, {found.priority} priority")
    times = {"heartbeat gap": found.gap_ms, "sample to STOP": found.stop_ms}
    for name, worst_ms, limit_ms, holds in found.limits:
        middle_ms, most_ms, _ = times[name]
        print(
            f"  {'ok' if holds else '--'}  {name:<15} median {middle_ms:.2f} ms, 99.9 % {most_ms:.2f} ms, "
            f"worst {worst_ms:.2f} ms, limit {limit_ms:.3g} ms"
        )
    if not found.holds:
        print(f"      {REMEDY}")
    return int(not found.holds)


def require_prompt(robot: str) -> None:
    """Raise InputError if the last measurement on this machine, with this priority, does not hold a limit.

    A robot on a serial line is judged by a measurement over a serial line, without one by that over UDP.
    """
    from needleplan.control.realtime import Promptness

    found = (Promptness.read(line=True) if robot.startswith("serial:") else None) or Promptness.read()
    if found is None or found.holds:
        return
    broken = [
        Mistake("--robot", robot, f"{name}: {worst_ms:.3g} ms measured, at most {limit_ms:.3g} ms permitted: {REMEDY}")
        for name, worst_ms, limit_ms, holds in found.limits if not holds
    ]  # fmt: skip
    raise InputError(broken, "check-realtime")
