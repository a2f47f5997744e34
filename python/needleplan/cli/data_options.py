"""Options of the commands that read trials: files, their roles, and the columns of foreign files."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from needleplan.cli.answer import note
from needleplan.cli.options import given_mistakes
from needleplan.errors import InputError, Mistake, ModelError

if TYPE_CHECKING:
    from needleplan.signals import Record, Role

__all__ = ["add_data", "add_reading", "data_files", "naming", "read_data", "read_files", "wrong_for_plans"]

# Options that hold for trials of a model, with their defaults. Plans are compared with recordings, which need none.
_OF_MODELS = (
    "--holdout", "--noise", "--reference", "--without-references", "--rate", "--accept-units", "--columns", "--surface",
    "--frame", "--scenario", "--fit",
)  # fmt: skip


@contextmanager
def naming(model: str) -> Iterator[None]:
    """Name the file `model` in a ModelError of the block, which computes with the model of this file."""
    try:
        yield
    except ModelError as error:
        raise ModelError(error.mistakes, f"{model}: {error.source}" if error.source else model) from None


def add_data(parser: argparse.ArgumentParser) -> None:
    """Declare the files of trials and their roles, and how they are read."""
    parser.add_argument("data", nargs="+", metavar="DATA", help="files of records, .csv, .h5 or .mat")
    parser.add_argument(
        "--holdout", action="append", default=[], metavar="FILE", help="file of trials for validation only"
    )
    parser.add_argument("--noise", action="append", default=[], metavar="FILE", help="file of the sensors at rest")
    parser.add_argument(
        "--reference", action="append", default=[], metavar="FILE",
        help="file of normal trials, without the effects that a diagnosis looks for; others identify from them too",
    )  # fmt: skip
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Declare `--accept-units`, `--rate`, and the columns and the frame of foreign files."""
    parser.add_argument(
        "--accept-units", action="store_true", help="accept implausible sizes, such as depths in metres"
    )
    parser.add_argument("--rate", type=float, metavar="HZ", help="interpolate all trials to this rate")
    group = parser.add_argument_group("foreign files")
    group.add_argument(
        "--columns", action="append", metavar="MAP",
        help="columns and units of text files with other names, as in time=t[ms],force=-Fz[mN],depth=2[m]: a name or a "
        "number from 1, the unit in brackets, a minus to change the sign; speed=3[mm/s] for files without times",
    )  # fmt: skip
    group.add_argument(
        "--surface", type=float, metavar="MM",
        help="reading of the depth at the surface of the tissue: depth and x count from it, y and z from the entry",
    )  # fmt: skip
    group.add_argument(
        "--frame", metavar="NAME",
        help="frame of the files that do not say it: guide, surface, tracker or plan; with an origin, as in "
        "surface:entry. Trials of different frames are refused",
    )  # fmt: skip


def wrong_for_plans(options: argparse.Namespace, reason: str, permitted: Sequence[str] = ()) -> list[Mistake]:
    """Return a mistake for each given option that holds for models only, except those permitted."""
    return given_mistakes(options, [name for name in _OF_MODELS if name not in permitted], f"is for models: {reason}")


def data_files(options: argparse.Namespace) -> list[str]:
    """Return all files of trials that the options name."""
    return [*options.data, *options.holdout, *options.noise, *options.reference]


def read_data(
    options: argparse.Namespace, check: Callable[[Sequence[Record]], object] = lambda _: None
) -> list[Record]:
    """Return the trials of all files, and print their number and faults of the sensor.

    With `--columns`, it also prints how the trials were read.
    `check` raises an InputError for trials that the command cannot use, before the remarks on reading are printed.
    Raises InputError if options contradict each other, and DataError if a file cannot be used.
    """
    from needleplan.signals import Role, fault_notes, require_one_frame

    if options.surface is not None and not options.columns:
        raise InputError(Mistake("--surface", "", "is for foreign files: it requires --columns"))
    files = data_files(options)
    twice = [file for file in dict.fromkeys(files) if files.count(file) > 1]
    if twice:
        raise InputError([Mistake("DATA", each, "is given twice, or with two roles") for each in twice])
    files_by_role = ((options.holdout, Role.HOLDOUT), (options.noise, Role.NOISE), (options.reference, Role.REFERENCE))
    roles: dict[str | os.PathLike[str], Role] = {file: role for files, role in files_by_role for file in files}
    records = read_files(options, files, roles)
    frame = require_one_frame(records)
    check(records)
    note(f"{len(records)} trial{'s' * (len(records) != 1)}, {sum(map(len, records)):,} samples")
    note(f"frame: {frame}")
    for record in records:
        for remark in record.notes if options.columns else fault_notes(record):
            note(f"  {record.trial}: {remark}")
    return records


def read_files(
    options: argparse.Namespace, files: Sequence[str], roles: Mapping[str | os.PathLike[str], Role] | None = None
) -> list[Record]:
    """Return the trials of files, read by the options of `add_reading`. Raises DataError if a file cannot be used."""
    from needleplan.recording import ColumnMap, read_records

    columns = ColumnMap.parse(options.columns, surface_mm=options.surface) if options.columns else None
    return read_records(
        files, accept_units=options.accept_units, columns=columns, roles=roles, rate_hz=options.rate,
        frame=options.frame,
    )  # fmt: skip
