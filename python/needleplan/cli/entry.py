"""`needleplan entry`: the best entry pose."""

from __future__ import annotations

import argparse
from typing import Any

from needleplan.cli.answer import complain, percent, print_json, print_lines
from needleplan.cli.options import add_edge, add_json, add_table, entry_record
from needleplan.cli.plan import UNREACHABLE_SUCCESS

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "entry",
        help="find the best entry pose",
        description="Find the entry with the highest success, and among equals the lowest cost. "
        "Exit code 1: the target is unreachable.",
    )
    add_table(parser)
    add_edge(parser)
    parser.add_argument("--at", type=float, metavar="MM", help="search the headings at this place of the edge only")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from needleplan.planning import PolicyTable

    table = PolicyTable.read(options.table)
    along = "y_mm" if options.edge in ("left", "right") else "x_mm"
    best = table.best_entry(options.edge, **{along: options.at})
    if options.json:
        print_json({"edge": options.edge, **entry_record(best)})
    else:
        lines = {"best entry": str(best.pose), "": f"success {percent(best.success)}, cost {best.value:.4g}"}
        print_lines(table.scenario.title or options.table, lines)
    if best.success < UNREACHABLE_SUCCESS:
        return complain(f"the target cannot be reached from the {options.edge} edge")
    return 0
