"""`needleplan info STORE`: what a table set holds, and whether its tables are undamaged."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from needleplan.cli.answer import complain, print_json, print_summary, working
from needleplan.cli.sweep import unconverged_text
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.sweep import TableSet

__all__ = ["is_store", "run_table_set_info"]

# Number of damaged tables, or of points without a table, in the summary without --verbose.
_SHOWN = 3


def is_store(file: str) -> bool:
    """Return whether `info` reads `file` as a table set: if it is a folder."""
    return Path(file).is_dir()


def run_table_set_info(options: argparse.Namespace) -> int:
    """Print what a table set holds, read all of its tables, and return the exit code: 1 if one is damaged, else 0.

    Raises SweepError if the folder is no table set, and InputError for options of tables.
    """
    from needleplan.sweep import TableSet, values_text

    wrong = [
        name
        for name, given in (("--verify-key", options.verify_key), ("--print-scenario", options.print_scenario))
        if given
    ]
    if wrong:
        raise InputError([Mistake(name, "", "is an option for a table, not for a table set") for name in wrong])
    table_set = TableSet.open(options.table)
    with working(options, f"reading {len(table_set)} tables") as tell:
        damaged = table_set.damaged(lambda done, of: tell(f"{done} of {of} tables read", done / max(of, 1)))
    without = {values_text(each.values): each.why for each in table_set if each.why}
    made = [each.record for each in table_set if each.record]
    statuses = Counter(str(each["status"]) for each in made)
    del statuses["converged"]
    size = sum(int(each["bytes"]) for each in made)
    if options.json:
        parameters = {
            parameter.title: {"key": parameter.scenario_key, "values": _levels(table_set, parameter.title)}
            for parameter in table_set.sweep.parameters
        }
        print_json(
            {"store": options.table, "title": table_set.sweep.title, "points": len(table_set), "tables": len(made),
             "bytes": size, "parameters": parameters, "unconverged": statuses, "impossible": without,
             "damaged": damaged}
        )  # fmt: skip
    else:
        missing = len(table_set) - len(made) - len(without)
        rest = [f"{missing} not made"] * bool(missing) + [f"{len(without)} break a rule of scenarios"] * bool(without)
        lines = {"tables": ", ".join([f"{len(made)} of {len(table_set)}", *rest, f"{size / 1e6:.2f} MB"])}
        lines |= {
            parameter.title: _parameter_text(table_set, parameter.title, parameter.scenario_key)
            for parameter in table_set.sweep.parameters
        }
        lines |= {"unconverged": unconverged_text(statuses)} if statuses else {}
        lines |= _first("no table", without, options) | _first("damaged", damaged, options)
        lines["checked"] = f"{len(made)} records" + ("" if table_set.keeps_records_only else " and their tables")
        print_summary(options, table_set.sweep.title or options.table, lines)
    if damaged:
        hint = "`needleplan sweep SWEEP.toml -o STORE --check` makes them again"
        return complain(f"{options.table}: {len(damaged)} tables are damaged; {hint}")
    return 0


def _levels(table_set: TableSet, name: str) -> list[object]:
    from needleplan.sweep import levels_of

    return list(levels_of(table_set, name))


def _parameter_text(table_set: TableSet, name: str, key: str) -> str:
    from needleplan.sweep import value_text

    levels = _levels(table_set, name)
    texts = list(map(value_text, levels))
    if len(texts) > 2 * _SHOWN:
        texts = [f"{len(texts)} values from {texts[0]} to {texts[-1]}"]
    return f"{', '.join(texts)} ({key})"


def _first(name: str, reasons: dict[str, str], options: argparse.Namespace) -> dict[str, str]:
    """Return lines for the first reasons by point, or all of them with --verbose."""
    shown = len(reasons) if options.verbose else _SHOWN
    lines = {name if not number else " " * number: f"{point}: {why}"
             for number, (point, why) in enumerate(list(reasons.items())[:shown])}  # fmt: skip
    if len(reasons) > shown:
        lines[f"{name} ..."] = f"{len(reasons) - shown} more with --verbose"
    return lines
