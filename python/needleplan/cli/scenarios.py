"""`needleplan scenarios` lists the shipped scenarios; `needleplan new` writes a scenario file to start from."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

from needleplan.cli.answer import note, print_json
from needleplan.cli.options import add_answer, add_output, require_outputs
from needleplan.errors import InputError, Mistake

__all__ = ["add_to"]

_SUFFIX = ".toml"


def add_to(commands: Any) -> None:
    """Declare both commands."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "scenarios",
        help="list the shipped scenarios",
        description="List the shipped scenarios: name, title, size of the workspace and number of states.",
    )
    add_answer(parser, verbose=False)
    parser.set_defaults(run=_run_scenarios)
    parser = commands.add_parser(
        "new",
        help="write a commented scenario to start from",
        description="Write a commented scenario file, which `needleplan plan` accepts as it is.",
    )
    parser.add_argument("name", metavar="NAME", help="name of the scenario, which becomes its title")
    parser.add_argument(
        "--from", dest="source", metavar="SCENARIO", default="four_obstacles",
        help="shipped scenario or scenario file to start from (four_obstacles)",
    )  # fmt: skip
    parser.add_argument(
        "--svg", metavar="FILE",
        help="drawing that gives workspace (the page), target (the circle named so) and obstacles (all other shapes); "
        "all else is from SCENARIO",
    )  # fmt: skip
    parser.add_argument(
        "--mm-per-unit", type=float, metavar="MM", help="length of a unit of the drawing (from the size of its page)"
    )
    add_output(parser, "FILE.toml", "file to write (NAME.toml)")
    add_answer(parser, verbose=False, json=False)
    parser.set_defaults(run=_run_new)


def _run_scenarios(options: argparse.Namespace) -> int:
    """List the shipped scenarios and return the exit code 0."""
    from needleplan.scenario import Scenario, shipped

    rows: list[dict[str, Any]] = []
    for name in shipped():
        each = Scenario.read(name)
        size = (each.workspace.width_mm, each.workspace.height_mm)
        rows.append({"name": name, "title": each.title, "size_mm": size, "states": each.states})
    if options.json:
        print_json(rows)
        return 0
    width = max(len(row["name"]) for row in rows)
    for row in rows:
        shown = "{:g} x {:g} mm".format(*row["size_mm"])
        print(f"{row['name']:<{width}}  {shown:>12}  {row['states']:>11,} states  {row['title']}")
    return 0


def _run_new(options: argparse.Namespace) -> int:
    """Write a scenario file and return the exit code 0. Raises InputError if the name or an option is wrong."""
    from needleplan.artifacts import write_whole
    from needleplan.scenario import Scenario, template

    title = Path(options.name).name.removesuffix(_SUFFIX)
    if not title or not title.isprintable():
        raise InputError(Mistake("NAME", options.name, "must be the name of a file"))
    if options.mm_per_unit is not None and not options.svg:
        raise InputError(Mistake("--mm-per-unit", f"{options.mm_per_unit:g}", "must not be given without --svg"))
    file = options.output or f"{options.name.removesuffix(_SUFFIX)}{_SUFFIX}"
    sources = [options.source] if Path(options.source).exists() else []
    require_outputs(options, [*sources, options.svg], file)
    text = template(options.source, svg=options.svg, mm_per_unit=options.mm_per_unit)
    line = f"title = {json.dumps(title, ensure_ascii=False)}"
    text, titles = re.subn(r"^title = .*$", lambda _: line, text, count=1, flags=re.MULTILINE)
    if not titles:
        text = re.sub(r"^schema = .*$", lambda schema: f"{schema[0]}\n{line}", text, count=1, flags=re.MULTILINE)
    Scenario.from_toml(text, options.source)
    write_whole(file, text.encode())
    note(f"wrote {file}; next: needleplan plan {file} -o {Path(file).stem}.h5")
    return 0
