"""The force library on the command line: `identify force --force-library` adds to it, `info` lists and searches it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import FileKind, file_format
from needleplan.cli.answer import complain, note, print_json
from needleplan.cli.options import given_mistakes, require_absent
from needleplan.cli.parser import Parser
from needleplan.errors import InputError, Mistake, OutputError

if TYPE_CHECKING:
    from needleplan.identification import Identification
    from needleplan.identification.combination import Combination
    from needleplan.identification.force_library import ForceLibrary, Match
    from needleplan.signals import Record

__all__ = ["add_search", "add_store", "is_library", "require_library", "require_no_search", "run_info", "store"]


def add_store(parser: Parser) -> None:
    """Declare the options that store an identified force in a library."""
    parser.add_argument(
        "--force-library", metavar="LIBRARY.toml", help="force only: add the result to this library, or make it"
    )
    _add_names(parser, "in the force library")


def _add_names(parser: Parser, where: str) -> None:
    """Declare the names of a needle and a tissue in a force library, and refuse the former names of these options."""
    for noun in ("needle", "tissue"):
        parser.add_argument(f"--{noun}-name", metavar="NAME", help=f"name of the {noun} {where}")
        parser.rename(f"--{noun}", f"--{noun}-name")


def add_search(parser: Parser) -> None:
    """Declare the options that search a library."""
    _add_names(parser, "in a force library, or a part of it")
    parser.add_argument("--velocity", type=float, metavar="MM_S", help="force library: the nearest speed, in mm/s")


def is_library(file: str) -> bool:
    """Return whether `info` reads `file` as a force library: by its format, by `.toml`, or as a shipped name."""
    if file_format(file).kind is FileKind.FORCE_LIBRARY or file.endswith(".toml"):
        return True
    if Path(file).suffix or Path(file).exists():
        return False
    from needleplan.identification.force_library import shipped_libraries

    return file in shipped_libraries()


def require_library(options: argparse.Namespace) -> ForceLibrary | None:
    """Return the library of `--force-library`; an empty one if the file does not exist, None without the option.

    Raises InputError if `--needle-name` or `--tissue-name` is missing or given without `--force-library`, or the kind
    is not force, and OutputError if the library file cannot be written, or is also a data file or another output file.
    """
    from needleplan.artifacts import require_different, require_writable
    from needleplan.identification.force_library import ForceLibrary

    names = {"--needle-name": options.needle_name, "--tissue-name": options.tissue_name}
    if options.force_library is None:
        require_absent(options, names, "is an option for --force-library, which is missing")
        return None
    if options.kind != "force":
        raise InputError(
            Mistake("--force-library", options.kind, "must be force: a library contains axial forces only")
        )
    if options.model == "relaxing":
        rule = "a force library cannot hold it, only models of the thesis: leave out --model or --force-library"
        raise InputError(Mistake("--model", options.model, rule))
    missing = [name for name, value in names.items() if not (value or "").strip()]
    if missing:
        raise InputError(
            [
                Mistake(name, "", "is missing: --force-library requires --needle-name and --tissue-name")
                for name in missing
            ]
        )
    outputs = [path for path in (options.output, options.figure) if path]
    require_different(options.data, [options.force_library, *outputs])
    require_writable(options.force_library)
    return ForceLibrary.read(options.force_library) if Path(options.force_library).exists() else ForceLibrary()


def store(
    library: ForceLibrary, found: Identification, records: Sequence[Record], options: argparse.Namespace
) -> dict[str, Any]:
    """Add an identified force to the library, write the library, and return the added entry for `--json`.

    Raises OutputError if the library has this combination of needle, tissue and speed already, without `--force`.
    """
    from needleplan.artifacts import may_replace
    from needleplan.identification.force_library import combination_of

    made = combination_of(found, records, options.needle_name, options.tissue_name)
    if library.like(made) and not options.overwrite:
        raise OutputError(
            Mistake("combination", made.title, "is already in the library; --force replaces it"), options.force_library
        )
    changed = library.with_combination(made)
    may_replace(options.force_library)
    changed.write(options.force_library)
    note(f"stored {made.title} in {options.force_library}, which now has {len(changed.combinations)} combinations")
    return {"library": options.force_library, "combination": made.raw()}


def require_no_search(options: argparse.Namespace) -> None:
    """Raise InputError if options that search a library are given. Called if the file is not a library."""
    names = ["--needle-name", "--tissue-name", "--velocity"]
    if mistakes := given_mistakes(options, names, "is an option for a library, a .toml file"):
        raise InputError(mistakes, options.table)


def run_info(options: argparse.Namespace) -> int:
    """Print the combinations of a library that match the search options; without options, all combinations.

    Returns the exit code: 1 if no combination matches, else 0.
    """
    from needleplan.identification.force_library import ForceLibrary

    library = ForceLibrary.read(options.table)
    matches = library.matches(needle=options.needle_name, tissue=options.tissue_name, velocity_mm_s=options.velocity)
    if options.json:
        rows = [match.combination.raw() | {"velocity_ratio": match.velocity_ratio} for match in matches]
        print_json({"library": options.table, "title": library.title, "combinations": rows})
    else:
        for line in _lines(options, library, matches):
            print(line)
    return 0 if matches else complain("no combination of the library matches the search")


def _lines(options: argparse.Namespace, library: ForceLibrary, matches: Sequence[Match]) -> Iterator[str]:
    yield f"{library.title or options.table}: {len(matches)} of {len(library.combinations)} combinations"
    width = max((len(f"{match.combination.needle} in {match.combination.tissue}") for match in matches), default=0)
    for match in matches:
        combination = match.combination
        name, more = (
            f"{combination.needle} in {combination.tissue}",
            f"to {combination.depth_mm:g} mm  {combination.model.name}",
        )
        if combination.mae_n is not None:
            more += f"  error {1e3 * combination.mae_n:.3g} mN"
        if options.velocity is not None:
            more += f"  {match.velocity_ratio:.3g} x the requested speed"
        yield f"  {name:<{width}}  {combination.velocity_mm_s:>5g} mm/s  {more}"
        if options.verbose or len(matches) == 1:
            yield from _parameters(combination)


def _parameters(combination: Combination) -> Iterator[str]:
    known = combination.model.parameters()
    for name, value in combination.model.values().items():
        low_high = combination.intervals.get(name)
        interval = f"  95 % interval {low_high[0]:.4g} to {low_high[1]:.4g}" if low_high else ""
        yield f"    {name:<7} {value:>10.4g} {known[name].unit:<10}{interval}".rstrip()
    yield f"    source  {combination.source}"
