"""`needleplan doctor`: what is installed, and what this machine can do."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from needleplan.cli.answer import print_json
from needleplan.cli.options import add_answer

__all__ = ["add_to"]


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "doctor",
        help="show what is installed and what this machine can do",
        description="Check the compiled solver, the optional libraries, real-time scheduling, ports, a browser and "
        "whether it draws without a graphics card, and the disk, and say what to do. "
        "Exit code 1: the solver is missing.",
    )
    add_answer(parser, verbose=False)
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Print the checks, and return the exit code: 1 if something that every command needs is missing, else 0."""
    from needleplan.extras.installed import checks, versions

    results = list(checks())
    if options.json:
        print_json({"versions": versions(), "checks": [asdict(check) for check in results]})
    else:
        known = versions()
        print(f"needleplan {known['needleplan']}, Python {known['python']}, {known['platform']}")
        for check in results:
            print(f"  {'ok' if check.good else '--'}  {check.name:<16} {check.found}")
            if check.remedy:
                print(f"      {'':<16} {check.remedy}")
    return int(any(check.is_required and not check.good for check in results))
