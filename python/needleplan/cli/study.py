"""`needleplan study`: tables and figures from an atlas."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, percent, print_first, print_json
from needleplan.cli.options import add_answer, add_figure, require_outputs
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from needleplan.atlas import Atlas

__all__ = ["add_to", "run"]

_KINDS = ("map", "entries", "pareto", "sensitivity", "mismatch")


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "study",
        help="tables and figures from an atlas",
        description="map: a quantity over --x and --y. entries: success over the entry position and --y. pareto: "
        "tables that no other table beats. sensitivity: share of each parameter. mismatch: the plan of --planned where "
        "other values are true.",
    )
    parser.add_argument("kind", choices=_KINDS, help="which study")
    parser.add_argument("store", metavar="STORE", help="the folder of an atlas")
    parser.add_argument("--x", metavar="NAME", help="map: the parameter along x (the first one)")
    parser.add_argument("--y", metavar="NAME", help="map, entries: the parameter along y (the second, the first one)")
    parser.add_argument(
        "--quantity", default="success", metavar="NAME", help="map, sensitivity: what to show (success)"
    )
    parser.add_argument(
        "--select",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="only tables with this value, or LOW:HIGH",
    )
    parser.add_argument(
        "--planned", action="append", default=[], metavar="NAME=VALUE", help="mismatch: the values that are planned for"
    )
    parser.add_argument("--runs", type=whole, default=2000, metavar="N", help="mismatch: executions a table (2000)")
    add_figure(parser, "the study")
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the study and return the exit code 0.

    Raises InputError (AtlasError, OutputError) for wrong options and folders.
    """
    from needleplan.atlas import Atlas

    require_outputs(options, [])
    atlas = Atlas.open(options.store)
    selected = atlas.select(**dict(map(_value("--select"), options.select)))
    study = {
        "map": _map, "entries": _entries, "pareto": _pareto, "sensitivity": _sensitivity, "mismatch": _mismatch
    }[options.kind]  # fmt: skip
    record, lines, figure = study(selected, options)
    if options.figure:
        from needleplan.plotting import save

        save(figure, options.figure)
        note(f"drew {options.figure}")
    if options.json:
        print_json({"study": options.kind, "store": options.store, **record})
    else:
        print_first(options, [atlas.sweep.title or options.store, *lines])
    return 0


_Found = tuple[dict[str, Any], Iterator[str], "Figure"]


def _map(atlas: Atlas, options: argparse.Namespace) -> _Found:
    from needleplan.atlas import draw_quantity_map, quantity_map

    x, y = _axes(atlas, options.x, options.y)
    found = quantity_map(atlas, x, y, options.quantity)
    lines = (
        f"  {y} = {level}: " + ", ".join(f"{value:.3g}" for value in row)
        for level, row in zip(found.y, found.values.tolist(), strict=True)
    )
    return (
        {"x": x, "y": y, "quantity": options.quantity, "x_levels": found.x, "y_levels": found.y,
         "values": found.values.tolist()},
        lines,
        draw_quantity_map(found, x, y, options.quantity),
    )  # fmt: skip


def _entries(atlas: Atlas, options: argparse.Namespace) -> _Found:
    from needleplan.atlas import draw_entry_map, entry_map

    y = options.y or _varying(atlas)[0]
    found, edge = entry_map(atlas, y), str(atlas.sweep.entry.edge)
    lines = (
        f"  {y} = {level}: best {percent(max(row))} at {found.position_mm[row.index(max(row))]:g} mm"
        for level, row in zip(found.levels, [[-1 if v != v else v for v in row] for row in found.success.tolist()],
                              strict=True)
    )  # fmt: skip
    return (
        {"y": y, "edge": edge, "levels": found.levels, "position_mm": found.position_mm.tolist(),
         "success": found.success.tolist()},
        lines,
        draw_entry_map(found, y, edge),
    )  # fmt: skip


def _pareto(atlas: Atlas, _: argparse.Namespace) -> _Found:
    from needleplan.atlas import GOALS, draw_pareto, pareto_front

    front = pareto_front(atlas)
    rows: list[dict[str, Any]] = [
        {"values": each.values} | {name: (each.record or {}).get(name) for name in GOALS} for each in front
    ]
    lines = (
        f"  {', '.join(f'{name} = {value}' for name, value in each['values'].items())}: "
        + ", ".join(f"{name} {each[name]:.3g}" for name in GOALS)
        for each in sorted(rows, key=lambda row: -row["success"])
    )
    return {"tables": len(atlas), "front": rows}, lines, draw_pareto(atlas, front)


def _sensitivity(atlas: Atlas, options: argparse.Namespace) -> _Found:
    from needleplan.atlas import draw_sensitivities, sensitivities

    found = sensitivities(atlas, options.quantity)
    lines = (f"  {each.name}: {percent(each.share)} of the variance, range {each.effect:.3g}" for each in found)
    record = {"quantity": options.quantity, "parameters": [asdict(each) for each in found]}
    return record, lines, draw_sensitivities(found, options.quantity)


def _mismatch(atlas: Atlas, options: argparse.Namespace) -> _Found:
    from needleplan.atlas import draw_wrong_parameters, wrong_parameters

    planned = dict(map(_value("--planned"), options.planned))
    found = wrong_parameters(atlas, options.runs, **planned)
    lines = (
        f"  {', '.join(f'{name} = {value}' for name, value in each.values.items())}: "
        f"{percent(each.success)} beside {percent(each.replanned)} of the right plan"
        for each in found
    )
    text = ", ".join(options.planned)
    return {"planned": planned, "found": [asdict(each) for each in found]}, lines, draw_wrong_parameters(found, text)


def _varying(atlas: Atlas) -> list[str]:
    """Return the parameters with several values, or else all parameters."""
    varying = [name for name in atlas.parameters if len({str(each.values[name]) for each in atlas}) > 1]
    return varying or list(atlas.parameters)


def _axes(atlas: Atlas, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the parameters along x and y; without a name, the first ones that vary."""
    left = [name for name in [*_varying(atlas), *atlas.parameters] if name not in (x, y)]
    first = x or (left.pop(0) if left else "")
    left = [name for name in left if name != first]
    return first, y or (left[0] if left else first)


def _value(option: str) -> Any:
    """Return a function that reads NAME=VALUE or NAME=LOW:HIGH. It raises InputError."""

    def read(text: str) -> tuple[str, Any]:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise InputError(Mistake(option, text, "must be NAME=VALUE or NAME=LOW:HIGH"))
        try:
            numbers = [float(each) for each in value.split(":")]
        except ValueError:
            return name, value
        return name, tuple(numbers) if len(numbers) == 2 else numbers[0] if len(numbers) == 1 else value

    return read
