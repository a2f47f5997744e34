"""`needleplan scenarios` lists the shipped scenarios; `needleplan new` writes a scenario or anatomy to start from."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

from needleplan.cli.answer import note, print_json
from needleplan.cli.options import add_answer, add_output, require_absent, require_free, require_outputs
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

__all__ = ["add_to"]

_SUFFIX = ".toml"
# Names of the invented anatomies, as in `needleplan.anatomy.PHANTOMS`, which takes long to import.
_ANATOMIES = ("liver", "lung", "prostate", "brain")


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
        help="write a commented scenario, or an invented anatomy, to start from",
        description="Write a commented scenario file, which `needleplan plan` accepts as it is. With --anatomy, write "
        "a folder with an invented segmented anatomy, which `needleplan entry` accepts as it is.",
    )
    parser.add_argument(
        "name", metavar="NAME", help="name of the scenario, which becomes its title; with --anatomy, the folder"
    )
    parser.add_argument(
        "--anatomy", choices=_ANATOMIES, help="write an invented anatomy; needs `pip install needleplan[volumes]`"
    )
    parser.add_argument(
        "--seed", type=whole, metavar="N", help="seed of an anatomy; the same seed gives the same files (default: 0)"
    )
    parser.add_argument(
        "--from", dest="source", metavar="SCENARIO", default="four_obstacles",
        help="shipped scenario or scenario file to start from (default: four_obstacles)",
    )  # fmt: skip
    parser.add_argument(
        "--svg", metavar="FILE",
        help="drawing that gives workspace (the page), target (the circle named so) and obstacles (all other shapes); "
        "all else is from SCENARIO",
    )  # fmt: skip
    parser.add_argument(
        "--mm-per-unit",
        type=float,
        metavar="MM",
        help="length of a unit of the drawing (default: from the size of its page)",
    )
    add_output(parser, "FILE.toml", "write this file (default: NAME.toml)")
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
    """Write a scenario file or an anatomy and return the exit code 0. Raises InputError for a wrong name or option."""
    if options.anatomy:
        return _new_anatomy(options)
    from needleplan.artifacts import write_whole
    from needleplan.scenario import Scenario, template

    if options.seed is not None:
        raise InputError(Mistake("--seed", f"{options.seed}", "must not be given without --anatomy"))
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


def _new_anatomy(options: argparse.Namespace) -> int:
    """Write an invented anatomy into the folder NAME and return the exit code 0."""
    from needleplan.anatomy import phantom_files, write_phantom

    require_absent(options, ["--svg", "--mm-per-unit", "--output"], "must not be given with --anatomy")
    folder = Path(options.name)
    if folder.is_file():
        raise InputError(Mistake("NAME", options.name, "must be a folder, and is a file"))
    require_free(options, [folder / phantom_file for phantom_file in phantom_files(options.anatomy)])
    file = write_phantom(options.anatomy, folder, options.seed or 0)
    note(f"wrote {file}, an invented anatomy; next: needleplan entry {file}")
    return 0
