"""`needleplan study`: tables and figures from a table set."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, percent, print_first, print_json
from needleplan.cli.options import add_answer, add_figure, require_outputs, require_rules
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from needleplan.sweep import TableSet

__all__ = ["add_to", "run"]

# Options of each study, beside --select, --figure and the options of the answer. Other options are refused.
_KINDS = {
    "map": ("x", "y", "quantity"),
    "entries": ("y",),
    "pareto": (),
    "sensitivity": ("quantity",),
    "mismatch": ("planned", "runs"),
}

# Default of --quantity, and of --runs (executions of each table; its 95 % interval is at most 0.044 wide).
_QUANTITY, _RUNS = "success", 2000


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "study",
        help="tables and figures from a table set",
        description="map: a quantity over --x and --y. entries: success over the entry position and --y. pareto: "
        "tables that no other table beats. sensitivity: share of each parameter. mismatch: the plan of --planned where "
        "other values are true.",
    )
    parser.add_argument("kind", choices=tuple(_KINDS), help="which study")
    parser.add_argument("store", metavar="STORE", help="the folder of a table set")
    parser.add_argument("--x", metavar="NAME", help="map: the parameter along x (default: the first one)")
    parser.add_argument(
        "--y", metavar="NAME", help="map, entries: the parameter along y (default: the second, the first one)"
    )
    parser.add_argument("--quantity", metavar="NAME", help=f"map, sensitivity: what to show (default: {_QUANTITY})")
    parser.add_argument(
        "--select",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="only tables with this value, or in LOW:HIGH",
    )
    parser.add_argument(
        "--planned", action="append", metavar="NAME=VALUE", help="mismatch: the values that are planned for"
    )
    parser.add_argument(
        "--runs", type=whole, metavar="N", help=f"number of executions of each table, for mismatch (default: {_RUNS})"
    )
    add_figure(parser, "the study")
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the study and return the exit code 0.

    Raises InputError (SweepError, OutputError) for wrong options and folders.
    """
    from needleplan.sweep import TableSet, selected

    _require_used(options)
    require_outputs(options, [])
    table_set = TableSet.open(options.store)
    part = selected(table_set, _values(table_set, "--select", options.select))
    study = {
        "map": _map, "entries": _entries, "pareto": _pareto, "sensitivity": _sensitivity, "mismatch": _mismatch
    }[options.kind]  # fmt: skip
    tables, record, lines, figure = study(part, options)
    if options.figure:
        from needleplan.plotting import save

        save(figure, options.figure)
        note(f"drew {options.figure}")
    if options.json:
        print_json({"study": options.kind, "store": options.store, "based_on": tables, **record})
    else:
        print_first(options, [f"{table_set.sweep.title or options.store}: {tables}", *lines])
    return 0


# Sum of the shares above which they exceed the variance, as it is printed.
_WHOLE = 1.0005

# Text on the tables that the study is based on, JSON record, lines of the answer, figure.
_Found = tuple[str, dict[str, Any], Iterable[str], "Figure"]


def _map(table_set: TableSet, options: argparse.Namespace) -> _Found:
    from needleplan.sweep import draw_quantity_map, quantity_map, tables_text, value_text

    x, y = _axes(table_set, options.x, options.y)
    quantity = options.quantity or _QUANTITY
    found = quantity_map(table_set, x, y, quantity)
    lines = (
        f"  {quantity} for {x} = {', '.join(map(value_text, found.x))}",
        *(
            f"  {y} = {value_text(level)}: " + ", ".join(f"{value:.3g}" if value == value else "-" for value in row)
            for level, row in zip(found.y, found.values.tolist(), strict=True)
        ),
    )
    used = sum(math.isfinite(value) for row in found.values.tolist() for value in row)
    return (
        tables_text(table_set, used, f"without {quantity}"),
        {"x": x, "y": y, "quantity": quantity, "x_levels": found.x, "y_levels": found.y,
         "values": found.values.tolist()},
        lines,
        draw_quantity_map(found, x, y, quantity, table_set=table_set),
    )  # fmt: skip


def _entries(table_set: TableSet, options: argparse.Namespace) -> _Found:
    from needleplan.sweep import draw_entry_map, entry_map, tables_text, value_text, varying

    y = options.y or (varying(table_set) or table_set.parameters)[0]
    found, edge = entry_map(table_set, y), str(table_set.sweep.entry.edge)
    lines = (
        f"  {y} = {value_text(level)}: best {percent(max(row))} at {found.position_mm[row.index(max(row))]:g} mm"
        for level, row in zip(found.levels, [[-1 if v != v else v for v in row] for row in found.success.tolist()],
                              strict=True)
    )  # fmt: skip
    return (
        tables_text(table_set, len(found.levels)),
        {"y": y, "edge": edge, "levels": found.levels, "position_mm": found.position_mm.tolist(),
         "success": found.success.tolist()},
        lines,
        draw_entry_map(found, y, edge, table_set=table_set),
    )  # fmt: skip


def _pareto(table_set: TableSet, _: argparse.Namespace) -> _Found:
    from needleplan.sweep import GOALS, draw_pareto, pareto_candidates, pareto_front, tables_text, values_text

    front = pareto_front(table_set)
    rows: list[dict[str, Any]] = [
        {"values": each.values} | {name: (each.record or {}).get(name) for name in GOALS} for each in front
    ]
    lines = (
        f"  {values_text(each['values'])}: "
        + ", ".join(f"{name} {each[name]:.3g}" for name in GOALS if each[name] is not None)
        for each in sorted(rows, key=lambda row: -row["success"])
    )
    tables = tables_text(table_set, len(pareto_candidates(table_set)), "miss the target without noise")
    return tables, {"tables": len(table_set), "front": rows}, lines, draw_pareto(table_set, front, table_set=table_set)


def _sensitivity(table_set: TableSet, options: argparse.Namespace) -> _Found:
    from needleplan.sweep import draw_sensitivities, sensitivities, tables_text

    quantity = options.quantity or _QUANTITY
    found = sensitivities(table_set, quantity)
    total = sum(each.share for each in found)
    if total > _WHOLE:
        correlated = "parameters are correlated in these tables, and each share holds a part of the others"
        note(f"the shares sum to {percent(total)}: {correlated}. More tables separate them")
    lines = (
        f"  {each.name}: {percent(each.share)} of the variance, range {each.effect:.3g}"
        + (f" (without effect: {percent(each.chance)} by chance)" if each.chance else "")
        for each in found
    )
    record = {"quantity": quantity, "parameters": [asdict(each) for each in found]}
    used = sum((each.record or {}).get(quantity) is not None for each in table_set)
    return (
        tables_text(table_set, used, f"without {quantity}"),
        record,
        lines,
        draw_sensitivities(found, quantity, table_set=table_set),
    )


def _mismatch(table_set: TableSet, options: argparse.Namespace) -> _Found:
    from needleplan.sweep import draw_wrong_parameters, tables_text, values_text, wrong_parameters

    planned = _values(table_set, "--planned", options.planned or [])
    _require_one(table_set, planned)
    found = wrong_parameters(table_set, options.runs or _RUNS, **planned)
    lines = (
        f"  {values_text(each.values)}: {percent(each.success)} beside {percent(each.replanned)} of the right plan"
        for each in found
    )
    tables = tables_text(table_set, len(found), "with another grid")
    return (
        tables,
        {"planned": planned, "found": [asdict(each) for each in found]},
        lines,
        draw_wrong_parameters(found, planned, table_set=table_set),
    )


def _require_used(options: argparse.Namespace) -> None:
    """Raise InputError if an option is given that the study does not use."""
    from needleplan.config import Integer

    used = _KINDS[options.kind]
    mistakes = []
    for name in sorted({each for names in _KINDS.values() for each in names} - set(used)):
        if getattr(options, name) is not None:
            kinds = " and ".join(kind for kind, names in _KINDS.items() if name in names)
            mistakes.append(Mistake("", f"--{name}", f"is not an option of {options.kind}; it belongs to {kinds}"))
    require_rules(options, {"--runs": Integer(1, 10**9)}, *mistakes)


def _axes(table_set: TableSet, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the parameters along x and y; a name that is not given is that of the first other one that varies.

    Raises InputError if too few parameters vary.
    """
    from needleplan.sweep import varying

    names = varying(table_set)
    left = [name for name in names if name not in (x, y)]
    missing = [option for option, name in (("--x", x), ("--y", y)) if name is None]
    if len(left) < len(missing):
        found = f"only {names[0]} varies" if names else "no parameter varies"
        rule = f"shows two parameters, but {found} in this selection of {len(table_set)} tables"
        if names and not table_set.sweep.in_space:
            rule += f"; `needleplan study entries --y {names[0]}` shows one parameter"
        raise InputError(Mistake("study", "map", rule))
    first = x or left.pop(0)
    return first, y or left.pop(0)


def _require_one(table_set: TableSet, planned: dict[str, Any]) -> None:
    """Raise InputError unless the values of --planned select one table. The message names the parameters to add."""
    from needleplan.sweep import selected, varying

    found = selected(table_set, planned, "--planned")
    if len(found) > 1:
        names = ", ".join(varying(found)) or "the parameters"
        rule = f"must name one table, but {len(found)} tables have these values; give a value of {names} too"
        raise InputError(Mistake("--planned", ", ".join(planned) or "(nothing)", rule))


def _values(table_set: TableSet, option: str, texts: list[str]) -> dict[str, Any]:
    """Return the values of NAME=VALUE or NAME=LOW:HIGH by name. Raises InputError."""
    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise InputError(Mistake(option, text, "must be NAME=VALUE or NAME=LOW:HIGH"))
        if name in values:
            raise InputError(Mistake(option, text, f"{name} is given twice; write a range as {name}=LOW:HIGH"))
        values[name] = _value(value, [each.values[name] for each in table_set if name in each.values])
    return values


def _value(text: str, known: list[Any]) -> Any:
    """Return the value that a text of the command line represents, or a tuple of two numbers for LOW:HIGH.

    A text that is a value of the table set is this value.
    """
    if text in known:
        return text
    with suppress(ValueError):
        numbers = [float(each) for each in text.split(":")]
        if len(numbers) == 2:
            return tuple(numbers)
    with suppress(ValueError):
        return json.loads(text)  # a number, true, false, or a list such as [2.0, 2.0]
    return text
