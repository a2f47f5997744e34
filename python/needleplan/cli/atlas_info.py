"""`needleplan info STORE`: what an atlas of policy tables holds, and whether its tables are undamaged."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from needleplan.cli.answer import complain, print_json, print_summary, working
from needleplan.cli.atlas import unconverged_text
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.atlas import Atlas

__all__ = ["is_store", "run_atlas_info"]

# Number of damaged tables, or of points without a table, in the summary without --verbose.
_SHOWN = 3


def is_store(file: str) -> bool:
    """Return whether `info` reads `file` as an atlas of policy tables: if it is a folder."""
    return Path(file).is_dir()


def run_atlas_info(options: argparse.Namespace) -> int:
    """Print what an atlas holds, read all of its tables, and return the exit code: 1 if one is damaged, else 0.

    Raises AtlasError if the folder is no atlas, and InputError for options of tables.
    """
    from needleplan.atlas import Atlas, values_text

    wrong = [name for name, given in (("--verify-key", options.verify_key), ("--scenario", options.scenario)) if given]
    if wrong:
        raise InputError([Mistake(name, "", "is an option for a table, not for an atlas") for name in wrong])
    atlas = Atlas.open(options.table)
    with working(options, f"reading {len(atlas)} tables") as tell:
        damaged = atlas.damaged(lambda done, of: tell(f"{done} of {of} tables read", done / max(of, 1)))
    without = {values_text(each.values): each.why for each in atlas if each.why}
    made = [each.record for each in atlas if each.record]
    statuses = Counter(str(each["status"]) for each in made)
    del statuses["converged"]
    size = sum(int(each["bytes"]) for each in made)
    if options.json:
        parameters = {
            each.title: {"key": each.scenario_key, "values": _levels(atlas, each.title)}
            for each in atlas.sweep.parameters
        }
        print_json(
            {"store": options.table, "title": atlas.sweep.title, "points": len(atlas), "tables": len(made),
             "bytes": size, "parameters": parameters, "unconverged": statuses, "impossible": without,
             "damaged": damaged}
        )  # fmt: skip
    else:
        missing = len(atlas) - len(made) - len(without)
        rest = [f"{missing} not made"] * bool(missing) + [f"{len(without)} break a rule of scenarios"] * bool(without)
        lines = {"tables": ", ".join([f"{len(made)} of {len(atlas)}", *rest, f"{size / 1e6:.2f} MB"])}
        lines |= {each.title: _parameter_text(atlas, each.title, each.scenario_key) for each in atlas.sweep.parameters}
        lines |= {"unconverged": unconverged_text(statuses)} if statuses else {}
        lines |= _first("no table", without, options) | _first("damaged", damaged, options)
        lines["checked"] = f"{len(made)} records" + ("" if atlas.keeps_records_only else " and their tables")
        print_summary(options, atlas.sweep.title or options.table, lines)
    if damaged:
        hint = "`needleplan atlas SWEEP.toml -o STORE --check` makes them again"
        return complain(f"{options.table}: {len(damaged)} tables are damaged; {hint}")
    return 0


def _levels(atlas: Atlas, name: str) -> list[object]:
    from needleplan.atlas import levels_of

    return list(levels_of(atlas, name))


def _parameter_text(atlas: Atlas, name: str, key: str) -> str:
    from needleplan.atlas import value_text

    levels = _levels(atlas, name)
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
