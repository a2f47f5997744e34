"""`needleplan reproduce`: published numbers beside ours."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from needleplan.cli.answer import complain, note, print_json

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "reproduce",
        help="print published results beside ours",
        description="Print the published tables and figures beside ours. Exit code 1: a verdict is no.",
    )
    parser.add_argument("chapters", nargs="*", metavar="CHAPTER", help="for example ch6; all where none is given")
    parser.add_argument("--figures", metavar="FOLDER", help="draw the figures into this folder")
    parser.add_argument(
        "--json", action="store_true", help="print a list of {id, published, ours, unit, verdict, reason}"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from needleplan.workflow.comparison import Verdict
    from needleplan.workflow.reproduce import CHAPTERS, reproduce

    comparisons = reproduce(options.chapters or list(CHAPTERS), options.figures, note)
    if options.json:
        print_json([asdict(each) for each in comparisons])
    else:
        for each in comparisons:
            ours = f"{each.ours:.4g}" if isinstance(each.ours, float) else str(each.ours)
            line = f"{each.id:<44} {each.published!s:>12} {ours:>12} {each.unit:<11} {each.verdict:<8} {each.reason}"
            print(line.rstrip())
    missed = [each.id for each in comparisons if each.verdict is Verdict.MISSED]
    return complain(f"{len(missed)} of {len(comparisons)} missed: {', '.join(missed)}") if missed else 0
