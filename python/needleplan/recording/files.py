"""Reading and writing files of records."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from needleplan.artifacts import digest, write_whole
from needleplan.errors import DataError, Mistake, OutputError
from needleplan.recording.csv_file import parse_csv, to_csv
from needleplan.recording.hdf5_file import parse_hdf5, to_hdf5
from needleplan.recording.plausible import questionable_units
from needleplan.recording.trials import records_of
from needleplan.signals import Record

__all__ = ["PathLike", "parse_records", "read_records", "write_records"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_NAMES = (".h5", ".hdf5")

PathLike = str | os.PathLike[str]


def read_records(paths: PathLike | Iterable[PathLike], *, accept_units: bool = False) -> list[Record]:
    """Read the trials of one file or of several, CSV or HDF5, in their order.

    A trial is named by its column `trial`, or by its file; where two files use the same name, by file and name. Rows
    left out and other remarks are in `Record.notes`. Raises DataError: for files that cannot be read, missing times,
    times that repeat or decrease, columns in other units, the same measurement given twice, and, unless `accept_units`,
    numbers of a size that no needle has.
    """
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not files:
        raise DataError("no file of data was given")
    found = [(os.fspath(file), _read(file, accept_units)) for file in files]
    _require_different(found)
    uses = Counter(name for _, records in found for name in {record.trial for record in records})
    return [
        record if uses[record.trial] == 1 else replace(record, trial=f"{file}: {record.trial}")
        for file, records in found
        for record in records
    ]


def parse_records(content: bytes, source: str = "data", *, accept_units: bool = False) -> list[Record]:
    """Return the trials in the bytes of a CSV or HDF5 file; `source` names it in messages. Raises DataError."""
    name, its_digest = Path(source).stem, digest(content)
    tables = parse_hdf5(content, source) if content.startswith(_HDF5) else [parse_csv(content, source)]
    records = [record for table in tables for record in records_of(table, name, its_digest, source)]
    repeated = [trial for trial, times in Counter(record.trial for record in records).items() if times > 1]
    if repeated:
        raise DataError([Mistake("trial", trial, "is the name of two groups") for trial in repeated], source)
    if not accept_units:
        mistakes = [
            Mistake(f"{record.trial}: {each.key}" if len(records) > 1 else each.key, each.value, each.rule)
            for record in records
            for each in questionable_units(record)
        ]
        if mistakes:
            raise DataError(mistakes, source)
    return records


def write_records(records: Sequence[Record], path: PathLike) -> str:
    """Write trials as HDF5 (.h5, .hdf5) or CSV (.csv), whole or not at all, and return the digest of the file.

    Raises OutputError for another ending or a file that cannot be written, DataError where there is no trial or two
    have the same name: they would be read back as one.
    """
    repeated = [name for name, times in Counter(record.trial for record in records).items() if times > 1]
    if not records or repeated:
        rule = f'two trials have the name "{repeated[0]}"' if repeated else "there is no record to write"
        raise DataError(rule, os.fspath(path))
    ending = Path(path).suffix.lower()
    if ending not in (".csv", *_HDF5_NAMES):
        raise OutputError(Mistake("", "", "the name of a data file must end in .csv, .h5 or .hdf5"), os.fspath(path))
    content = to_csv(records).encode() if ending == ".csv" else to_hdf5(records)
    write_whole(path, content)
    return digest(content)


def _require_different(found: Sequence[tuple[str, Sequence[Record]]]) -> None:
    """Raise DataError where one measurement is there twice: it would count as two, and narrow every interval."""
    first: dict[str, str] = {}
    for file, records in found:
        for record in records:
            content = digest(b"".join(name.encode() + record[name].tobytes() for name in sorted(record.columns)))
            here = f"{file}, trial {record.trial}"
            if content in first:
                rule = f"holds the same numbers as {first[content]}: one measurement must not count twice"
                raise DataError(Mistake("trial", record.trial, rule), file)
            first[content] = here


def _read(file: PathLike, accept_units: bool) -> list[Record]:
    try:
        content = Path(file).read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot be read: {reason}", os.fspath(file)) from error
    return parse_records(content, os.fspath(file), accept_units=accept_units)
