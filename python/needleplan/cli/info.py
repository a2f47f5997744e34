"""`needleplan info`: what is in a table, and whether it is what was written."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from needleplan.cli.answer import complain, percent, print_json, print_lines
from needleplan.cli.options import add_json, add_table
from needleplan.errors import ChecksumError

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "info",
        help="show what is in a table and verify its checksums",
        description="Show what is in a table and verify its checksums. Exit code 1: a checksum is wrong.",
    )
    add_table(parser)
    parser.add_argument("--scenario", action="store_true", help="print the scenario that the table carries, as TOML")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from needleplan.planning import PolicyTable
    from needleplan.planning.table_file import FORMAT

    try:
        table = PolicyTable.read(options.table)
    except ChecksumError as error:
        if options.json:
            print_json({"table": options.table, "verified": False, "reason": str(error)})
        return complain(str(error))
    scenario, stats = table.scenario, table.stats
    if options.scenario:
        print(scenario.to_toml(), end="")
        return 0
    if options.json:
        print_json(
            {
                "table": options.table,
                "verified": True,
                "format": FORMAT,
                "title": scenario.title,
                "scenario_digest": scenario.digest,
                "digest": table.digest,
                "shape": scenario.shape,
                "spacing_mm": scenario.grid.spacing_mm,
                "transition": scenario.grid.transition,
                "method": scenario.solver.method,
                **asdict(stats),
            }
        )
        return 0
    dx, dy = scenario.grid.spacing_mm
    print_lines(
        scenario.title or options.table,
        {
            "format": f"{FORMAT}, checksums verified",
            "digest": table.digest,
            "scenario": scenario.digest,
            "grid": f"{' x '.join(map(str, scenario.shape))} = {stats.states:,} states, spacing {dx:g} x {dy:g} mm, "
            f"{scenario.grid.transition}",
            "solver": f"{scenario.solver.method}: {stats.status.replace('_', ' ')}, residual {stats.residual:.3g}, "
            f"error at most {stats.error_bound:.3g}",
            "work": f"{stats.sweeps:.2f} sweeps, {stats.backups:,} backups, {stats.seconds:.3f} s",
            "values": f"{table.values.min():.4g} to {table.values.max():.4g}",
            "success": f"{percent(float(table.success.mean()))} on average over all states",
        },
    )
    return 0
