"""The force atlas on the command line: `identify force --atlas` stores a result, `info` lists and searches an atlas."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import FileKind, file_format
from needleplan.cli.answer import complain, note, print_json
from needleplan.errors import InputError, Mistake, OutputError

if TYPE_CHECKING:
    from needleplan.identification import Identification
    from needleplan.identification.combination import Combination
    from needleplan.identification.force_atlas import ForceAtlas, Match
    from needleplan.signals import Record

__all__ = ["add_search", "add_store", "is_atlas", "require_atlas", "require_no_search", "run_info", "store"]


def add_store(parser: argparse.ArgumentParser) -> None:
    """Declare the options that store an identified force in an atlas."""
    parser.add_argument("--atlas", metavar="ATLAS.toml", help="force only: add the result to this atlas, or make it")
    parser.add_argument("--needle", dest="atlas_needle", metavar="NAME", help="with --atlas: name of the needle")
    parser.add_argument("--tissue", dest="atlas_tissue", metavar="NAME", help="with --atlas: name of the tissue")


def add_search(parser: argparse.ArgumentParser) -> None:
    """Declare the options that search an atlas."""
    parser.add_argument("--needle", metavar="NAME", help="atlas of forces: needles whose name contains this text")
    parser.add_argument("--tissue", metavar="NAME", help="atlas of forces: tissues whose name contains this text")
    parser.add_argument("--velocity", type=float, metavar="MM_S", help="atlas of forces: the nearest speed, in mm/s")


def is_atlas(file: str) -> bool:
    """Return whether `info` reads `file` as an atlas: it is one, ends in `.toml`, or is the name of a shipped atlas."""
    if file_format(file).kind is FileKind.FORCE_ATLAS or file.endswith(".toml"):
        return True
    if Path(file).suffix or Path(file).exists():
        return False
    from needleplan.identification.force_atlas import shipped_atlases

    return file in shipped_atlases()


def require_atlas(options: argparse.Namespace) -> ForceAtlas | None:
    """Return the atlas of the option `--atlas`; an empty atlas if the file does not exist, None without the option.

    Raises InputError if `--needle` or `--tissue` is missing or given without `--atlas`, or the kind is not force, and
    OutputError if the atlas file cannot be written, or is also a data file or another output file.
    """
    from needleplan.artifacts import require_different, require_writable
    from needleplan.identification.force_atlas import ForceAtlas

    names = {"--needle": options.atlas_needle, "--tissue": options.atlas_tissue}
    if options.atlas is None:
        given = [name for name, value in names.items() if value is not None]
        if given:
            raise InputError([Mistake(name, "", "is an option for --atlas, which is missing") for name in given])
        return None
    if options.kind != "force":
        raise InputError(Mistake("--atlas", options.kind, "must be force: an atlas contains axial forces only"))
    if options.model == "relaxing":
        rule = "cannot be stored in an atlas, which holds the models of the thesis: leave out --model or --atlas"
        raise InputError(Mistake("--model", options.model, rule))
    missing = [name for name, value in names.items() if not (value or "").strip()]
    if missing:
        raise InputError([Mistake(name, "", "is missing: --atlas requires --needle and --tissue") for name in missing])
    outputs = [each for each in (options.output, options.figure) if each]
    require_different(options.data, [options.atlas, *outputs])
    require_writable(options.atlas)
    return ForceAtlas.read(options.atlas) if Path(options.atlas).exists() else ForceAtlas()


def store(
    atlas: ForceAtlas, found: Identification, records: Sequence[Record], options: argparse.Namespace
) -> dict[str, Any]:
    """Add an identified force to the atlas, write the atlas, and return the added entry for `--json`.

    Raises OutputError if the atlas already has this combination of needle, tissue and speed and `--force` is not given.
    """
    from needleplan.artifacts import may_replace
    from needleplan.identification.force_atlas import combination_of

    made = combination_of(found, records, options.atlas_needle, options.atlas_tissue)
    if atlas.like(made) and not options.overwrite:
        raise OutputError(
            Mistake("combination", made.title, "is already in the atlas; --force replaces it"), options.atlas
        )
    changed = atlas.with_combination(made)
    may_replace(options.atlas)
    changed.write(options.atlas)
    note(f"stored {made.title} in {options.atlas}, which now has {len(changed.combinations)} combinations")
    return {"atlas": options.atlas, "combination": made.raw()}


def require_no_search(options: argparse.Namespace) -> None:
    """Raise InputError if options that search an atlas are given. Called if the file is not an atlas."""
    given = {"--needle": options.needle, "--tissue": options.tissue, "--velocity": options.velocity}
    mistakes = [
        Mistake(name, f"{value}", "is an option for an atlas, a .toml file")
        for name, value in given.items()
        if value is not None
    ]
    if mistakes:
        raise InputError(mistakes, options.table)


def run_info(options: argparse.Namespace) -> int:
    """Print the combinations of an atlas that match the search options; without options, all combinations.

    Returns the exit code: 1 if no combination matches, else 0.
    """
    from needleplan.identification.force_atlas import ForceAtlas

    atlas = ForceAtlas.read(options.table)
    matches = atlas.matches(needle=options.needle, tissue=options.tissue, velocity_mm_s=options.velocity)
    if options.json:
        rows = [each.combination.raw() | {"velocity_ratio": each.velocity_ratio} for each in matches]
        print_json({"atlas": options.table, "title": atlas.title, "combinations": rows})
    else:
        for line in _lines(options, atlas, matches):
            print(line)
    return 0 if matches else complain("no combination of the atlas matches the search")


def _lines(options: argparse.Namespace, atlas: ForceAtlas, matches: Sequence[Match]) -> Iterator[str]:
    yield f"{atlas.title or options.table}: {len(matches)} of {len(atlas.combinations)} combinations"
    width = max((len(f"{each.combination.needle} in {each.combination.tissue}") for each in matches), default=0)
    for match in matches:
        each = match.combination
        name, more = f"{each.needle} in {each.tissue}", f"to {each.depth_mm:g} mm  {each.model.name}"
        if each.mae_n is not None:
            more += f"  error {1e3 * each.mae_n:.3g} mN"
        if options.velocity is not None:
            more += f"  {match.velocity_ratio:.3g} x the requested speed"
        yield f"  {name:<{width}}  {each.velocity_mm_s:>5g} mm/s  {more}"
        if options.verbose or len(matches) == 1:
            yield from _parameters(each)


def _parameters(each: Combination) -> Iterator[str]:
    known = each.model.parameters()
    for name, value in each.model.values().items():
        low_high = each.intervals.get(name)
        interval = f"  95 % interval {low_high[0]:.4g} to {low_high[1]:.4g}" if low_high else ""
        yield f"    {name:<7} {value:>10.4g} {known[name].unit:<10}{interval}".rstrip()
    yield f"    source  {each.source}"
