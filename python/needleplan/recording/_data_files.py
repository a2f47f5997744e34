"""Reading and writing files of trials.

Step-wise insertions of the data set maribernardes/mpc_stepwise_trajcontrol: tip tracked at 2 Hz.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleplan.artifacts import digest, path_text, write_whole
from needleplan.errors import DataError, Mistake, OutputError, reading
from needleplan.recording._align import resampled
from needleplan.recording._column_map import ColumnMap
from needleplan.recording._foreign_file import parse_foreign, with_velocity
from needleplan.recording.columns import questionable_units
from needleplan.recording.csv_file import number_in, parse_csv, rows_of_cells, to_csv
from needleplan.recording.hdf5_file import parse_hdf5, to_hdf5
from needleplan.recording.mat_file import MAT_BEGINS, parse_mat, to_mat
from needleplan.recording.table import DataTable, records_of
from needleplan.signals import Array, FrameName, Record, RecordFrame, Role

__all__ = [
    "PathLike",
    "is_stepwise_insertion",
    "parse_records",
    "parse_stepwise_insertion",
    "read_records",
    "write_records",
]


_STEPWISE = ("Timestamp sec", "Timestamp nanosec", "Tip x", "Tip y", "Tip z", "Tip sec", "Tip nanosec")
# Position (m) of the needle guide, and the time of its measurement.
_GUIDE = ("Robot x", "Robot z", "Robot sec")
# Largest distance (mm) of a needle guide from the origin of a study.
_FARTHEST_MM = 2000.0
# Number of mistakes of a file that are told.
_MOST_MISTAKES = 10
_NUMBER = "must be a number with a decimal point, or empty"


def is_stepwise_insertion(content: bytes) -> bool:
    """Return whether the bytes of a file begin with the header of a stepwise insertion."""
    header = content.partition(b"\n")[0].decode("utf-8-sig", "replace")
    return {cell.strip() for cell in re.split("[,;\t]", header)}.issuperset(_STEPWISE)


def parse_stepwise_insertion(content: bytes, source: str) -> Record:
    """Return the record in the bytes of a stepwise insertion.

    The depth is -`Tip y`, stored as `depth_mm` and `x_mm`; `y_mm` is `Tip x` and `z_mm` is `Tip z`, both relative to
    the first measured position of the needle guide (`Robot x`, `Robot z`); without one, in the frame of the study.
    Times are the measurement times of the tip since the first one. Rows without a tip and rows that repeat a
    measurement are left out and counted in the notes.
    """
    _, [(_, header), *rows] = rows_of_cells(content.replace(b"\0", b""), source)
    names = _STEPWISE + _GUIDE * (set(_GUIDE) <= set(header))
    table = _numbers(rows, header, names, source)
    if len(table) < 2:
        raise DataError("has fewer than two rows", source)
    _, _, x, y, z, seconds, nanoseconds, *guide = table.T
    measured = seconds > 0
    time = np.where(measured, seconds - seconds.max(), -np.inf) + 1e-9 * nanoseconds
    new = np.concatenate([[True], np.diff(time) > 0]) & measured
    notes = [f"{int((~measured).sum())} rows without a tip were left out"] * bool((~measured).any())
    repeated = int((measured & ~new).sum())
    notes += [f"{repeated} rows that repeat a measurement were left out"] * bool(repeated)
    if new.sum() < 2:
        raise DataError("has fewer than two measurements of the tip", source)
    frame = RecordFrame(provenance="the frame of the study, whose origin its files do not say")
    if guide and (guide[2] > 0).any():
        first = int(np.argmax(guide[2] > 0))
        across, up = 1000 * guide[0][first], 1000 * guide[1][first]
        if max(abs(across), abs(up)) > _FARTHEST_MM:
            rule = "are the position of the needle guide in m: this is too far away; are they in mm?"
            raise DataError(Mistake("Robot x, Robot z", f"{across / 1000:g}, {up / 1000:g}", rule), source)
        x, z = x - across, z - up
        notes.append(f"y_mm and z_mm count from the needle guide at {across:.2f} and {up:.2f} mm")
        frame = RecordFrame(FrameName.GUIDE, "needle guide", "its columns Robot x and Robot z")
    columns = {"time_s": time[new] - time[new][0], "depth_mm": -y[new], "x_mm": -y[new], "y_mm": x[new], "z_mm": z[new]}
    begun_s = float(seconds[new][0] + 1e-9 * nanoseconds[new][0])
    return Record(columns, Path(source).stem, digest=digest(content), notes=tuple(notes), frame=frame, begun_s=begun_s)


def _numbers(rows: Sequence[tuple[int, list[str]]], header: Sequence[str], names: Sequence[str], source: str) -> Array:
    """Return the numbers of some columns, shape (rows, names); an empty cell is NaN.

    Raises DataError with the lines that have too few cells, and the cells that hold no number.
    """
    places = {name: header.index(name) for name in names}
    wrong = [
        Mistake(f"line {n}", f"{len(row)} cells", f"must have {len(header)}")
        for n, row in rows
        if len(row) < len(header)
    ]
    cells = [(n, name, row[place]) for n, row in rows if len(row) >= len(header) for name, place in places.items()]
    wrong += [Mistake(f"{name} (line {n})", cell, _NUMBER) for n, name, cell in cells if number_in(cell) is None]
    if wrong:
        raise DataError(wrong[:_MOST_MISTAKES], source)
    return np.array([number_in(cell) for _, _, cell in cells], float).reshape(-1, len(names))


_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_NAMES = (".h5", ".hdf5")

PathLike = str | os.PathLike[str]


def read_records(
    paths: PathLike | Iterable[PathLike],
    *,
    accept_units: bool = False,
    columns: ColumnMap | str | None = None,
    roles: Mapping[PathLike, Role] | None = None,
    rate_hz: float | None = None,
    frame: RecordFrame | str | None = None,
) -> list[Record]:
    r"""Read the trials of one or more files, CSV, HDF5 or MATLAB (.mat).

    Parameters
    ----------
    paths : str, path or iterable of these
        The files.
    accept_units : bool
        Accept values that are implausible for a needle in the unit of their column.
    columns : ColumnMap or str, optional
        Columns and units of text files with other names, as in `time=t[ms], force=-Fz[mN]`. The default reads files
        with the names of `UNITS`.
    roles : mapping of path to Role, optional
        Roles of whole files. The default is the column `role` of the file, or train.
    rate_hz : float, optional
        Rate to which all trials are interpolated. The default keeps the samples of the files.
    frame : RecordFrame or str, optional
        Frame of trials whose files do not name a frame, as a text such as "surface: entry".

    Returns
    -------
    list of Record
        The trials in the order of the files. A trial is named by its column `trial`, else by its file; if two files use
        the same name, by file and name. `Record.notes` lists rows left out and other remarks.

    Raises
    ------
    DataError
        With the mistakes of all files: a file cannot be read, times are missing, repeat or decrease, a column has
        another unit, y and z have no origin at the surface, the same measurement is
        given twice, or values are implausible.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import read_records
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "first.csv"
    ...     _ = path.write_text("time_s,force_n\n0.0,0.01\n0.1,0.02\n")
    ...     (record,) = read_records(path)
    >>> record.trial, record["force_n"].tolist()
    ('first', [0.01, 0.02])

    """
    listed = paths if isinstance(paths, Iterable) and not isinstance(paths, str | bytes | os.PathLike) else [paths]
    files = [path_text(path, DataError, "a data file") for path in listed]
    if not files:
        raise DataError("no data file was given")
    plan = ColumnMap.parse(columns) if isinstance(columns, str) else columns
    given = {os.fspath(file): role for file, role in (roles or {}).items()}
    found: list[tuple[str, list[Record]]] = []
    wrong: list[DataError] = []
    for file in files:
        try:
            found.append((file, _read(file, accept_units, plan, given.get(file), rate_hz)))
        except DataError as error:
            wrong.append(error)
    if len(wrong) == 1:
        raise wrong[0]
    if wrong:
        raise DataError(
            [
                Mistake(f"{error.source}: {mistake.key}".removesuffix(": "), mistake.value, mistake.rule)
                for error in wrong
                for mistake in error.mistakes
            ]
        )
    _require_different(found)
    if frame is not None:
        told = RecordFrame.parse(frame, "given") if isinstance(frame, str) else frame
        found = [
            (file, [each if each.frame.known else replace(each, frame=told) for each in records])
            for file, records in found
        ]
    uses = Counter(name for _, records in found for name in {record.trial for record in records})
    return [
        record if uses[record.trial] == 1 else replace(record, trial=f"{file}: {record.trial}")
        for file, records in found
        for record in records
    ]


def parse_records(
    content: bytes,
    source: str = "data",
    *,
    accept_units: bool = False,
    columns: ColumnMap | None = None,
    role: Role | None = None,
    rate_hz: float | None = None,
) -> list[Record]:
    r"""Return the trials in the bytes of a CSV, HDF5 or MATLAB file.

    Parameters
    ----------
    content : bytes
        The bytes of the file.
    source : str
        The name of the file, for error messages and for the name of a single trial.
    accept_units : bool
        Accept values that are implausible for a needle in the unit of their column.
    columns : ColumnMap, optional
        Columns and units of a text file with other names; HDF5 and MATLAB files are read without it.
    role : Role, optional
        Role of all trials of the file. The default is the column `role`, or train.
    rate_hz : float, optional
        Rate to which the trials are interpolated. The default keeps the samples of the file.

    Returns
    -------
    list of Record
        The trials, ordered by their first row.

    Raises
    ------
    DataError
        As `read_records`.

    Examples
    --------
    >>> from needleplan.recording import parse_records
    >>> (record,) = parse_records(b"time_s,force_n\n0.0,0.01\n0.1,0.02\n", "first.csv")
    >>> len(record)
    2

    """
    name, its_digest = Path(source).stem, digest(content)
    tables: list[DataTable] = []
    published: list[Record] = []
    if content.startswith(_HDF5):
        tables, columns = parse_hdf5(content, source), None
    elif content.startswith(MAT_BEGINS):
        tables, columns = parse_mat(content, source), None
    elif columns:
        tables = [parse_foreign(content, source, columns, quiet=role is Role.NOISE)]
    elif is_stepwise_insertion(content):
        published = [parse_stepwise_insertion(content, source)]
    else:
        tables = [parse_csv(content, source)]
    records = published + [record for table in tables for record in records_of(table, name, its_digest, source)]
    if role:
        records = [replace(record, role=role) for record in records]
    repeated = [trial for trial, times in Counter(record.trial for record in records).items() if times > 1]
    if repeated:
        raise DataError([Mistake("trial", trial, "is the name of two groups") for trial in repeated], source)
    if not accept_units:
        mistakes = [
            Mistake(
                f"{record.trial}: {questionable_unit.key}" if len(records) > 1 else questionable_unit.key,
                questionable_unit.value,
                questionable_unit.rule,
            )
            for record in records
            for questionable_unit in questionable_units(record)
        ]
        if mistakes and columns:
            instead = "Give the right unit in the column map"
            mistakes = [
                Mistake(mistake.key, mistake.value, mistake.rule.replace("Convert it", instead)) for mistake in mistakes
            ]
        if mistakes:
            raise DataError(mistakes, source)
    if rate_hz is not None:
        records = [resampled(record, rate_hz) for record in records]
    return [with_velocity(record) for record in records] if columns else records


def write_records(records: Sequence[Record], path: PathLike) -> str:
    """Write trials to an HDF5, CSV or MATLAB file; the file is written completely or not at all.

    Parameters
    ----------
    records : sequence of Record
        The trials; their names must differ.
    path : str or path
        The file to write; its suffix `.h5`, `.hdf5`, `.csv` or `.mat` selects the format.

    Returns
    -------
    str
        The digest of the file.

    Raises
    ------
    OutputError
        The suffix is not one of these four, or the file cannot be written.
    DataError
        There is no trial, two trials have the same name, or a name in a CSV file would have a line break.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import read_records, write_records
    >>> from needleplan.signals import Record
    >>> record = Record({"time_s": [0.0, 0.1], "force_n": [0.01, 0.02]}, "first")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "data.h5"
    ...     digest = write_records([record], path)
    ...     read_records(path)[0].digest == digest
    True

    """
    source = path_text(path, OutputError)
    if not isinstance(records, Sequence) or not all(isinstance(record, Record) for record in records):
        rule = "must be a list of needleplan.signals.Record; `records_of` makes them of a DataFrame"
        raise DataError(Mistake("records", f"<{type(records).__name__}>", rule), source)
    repeated = [name for name, times in Counter(record.trial for record in records).items() if times > 1]
    if not records or repeated:
        rule = f'two trials have the name "{repeated[0]}"' if repeated else "there is no record to write"
        raise DataError(rule, source)
    ending = Path(path).suffix.lower()
    if ending not in (".csv", ".mat", *_HDF5_NAMES):
        rule = "the name of a data file must end in .csv, .h5, .hdf5 or .mat"
        raise OutputError(Mistake("", "", rule), source)
    content = to_csv(records).encode() if ending == ".csv" else (to_mat if ending == ".mat" else to_hdf5)(records)
    write_whole(path, content)
    return digest(content)


def _require_different(found: Sequence[tuple[str, Sequence[Record]]]) -> None:
    """Raise DataError if two trials contain the same numbers, because a fit would count the measurement twice."""
    first: dict[str, str] = {}
    for file, records in found:
        for record in records:
            content = digest(b"".join(name.encode() + record[name].tobytes() for name in sorted(record.columns)))
            here = f"{file}, trial {record.trial}"
            if content in first:
                rule = f"holds the same numbers as {first[content]}: one measurement must not count twice"
                raise DataError(Mistake("trial", record.trial, rule), file)
            first[content] = here


def _read(
    file: PathLike, accept_units: bool, columns: ColumnMap | None, role: Role | None, rate_hz: float | None
) -> list[Record]:
    with reading(file, DataError):
        content = Path(file).read_bytes()
    return parse_records(
        content, os.fspath(file), accept_units=accept_units, columns=columns, role=role, rate_hz=rate_hz
    )
