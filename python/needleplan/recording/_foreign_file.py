"""Text files of other laboratories, whose columns a `ColumnMap` names: with or without a header, in any known units.

Lines before the header, or before the first row of numbers, are left out, and so are rows of units after the header.
The separator is a semicolon, tab, comma or white space; decimal commas are read if the separator is not a comma. Left
out with a note are rows without any number, rows of zeros before a sensor has measured, and rows that repeat the row
before them. If the clock begins again, the rows after it are a further trial.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.recording._column_map import ColumnMap
from needleplan.recording._foreign_header import ColumnSource, RowCells, find_header, find_sources
from needleplan.recording.csv_file import cells_of, number_in, text_of
from needleplan.recording.table import DataTable, disordered
from needleplan.signals import Array, FrameName, MeasuredMotion, Record, RecordFrame, Role

__all__ = ["NumberRows", "cell_rows", "number_rows", "parse_foreign", "with_velocity"]

# Number of mistakes at which reading stops.
_MOST_MISTAKES = 10
# Number of median intervals from the first time, up to which a smaller time is a clock that begins again.
_RESET_INTERVALS = 5.0
# Beginning of the header that `rostopic echo -p` writes; other lines with a percent sign are comments.
_ROS_HEADER = "%time,"
# Digits with points and commas, which are no number.
_SIGNED = re.compile(r"[-+]?\d[\d.,]*")


@dataclass(frozen=True)
class NumberRows:
    """Rows of numbers: `cells` by index of the column, each of shape (samples,), texts, and lines in the file."""

    cells: dict[int, Array]
    texts: dict[str, tuple[str, ...]]
    lines: tuple[int, ...]

    def where(self, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> NumberRows:
        """Return the rows at which the boolean mask `kept`, shape (samples,), is True."""
        at = np.flatnonzero(kept)
        return NumberRows(
            {index: values[at] for index, values in self.cells.items()},
            {name: tuple(values[row] for row in at) for name, values in self.texts.items()},
            tuple(self.lines[row] for row in at),
        )


def parse_foreign(content: bytes, source: str, columns: ColumnMap, *, quiet: bool = False) -> DataTable:
    """Return the rows of a text file in the columns and units of `columns`, times counted from the first row.

    `quiet` marks a record of noise, which may lack the columns of the motion. Raises DataError with all mistakes if a
    column is not in the file, its unit is not known, or a cell is not a number.
    """
    rows, separator = cell_rows(content, source)
    header, first = find_header(rows, columns, source)
    sources, texts, notes = find_sources(header, columns, quiet, source)
    if rows[first][0] > (2 if header else 1):
        notes.append(f"the rows of numbers begin in line {rows[first][0]}")
    measured = number_rows(rows[first:], sources, texts, source, decimal_comma=separator != ",")
    measured, left_out = _measurements(measured, sources)
    numbers = {
        column: np.sum([part.factor * _counted(measured.cells[part.index], column) for part in parts], axis=0)
        for column, parts in sources.items()
    }
    places = tuple(f"line {number}" for number in measured.lines)
    table = DataTable(numbers, measured.texts, places, (*notes, *left_out))
    table = _with_times(table, columns.speed_mm_s) if columns.speed_mm_s else _with_trials(table, source)
    return table if columns.surface_mm is None else _from_surface(table, columns.surface_mm, source, quiet=quiet)


def cell_rows(content: bytes, source: str) -> tuple[list[RowCells], str | None]:
    """Return the rows of cells of a text file, without empty lines and comments, and the separator of the cells.

    The separator is None if it is white space. Raises DataError if the file is empty or no text.
    """
    text = _text(content, source).replace("\r\n", "\n").replace("\r", "\n")
    lines = [
        (number, line)
        for number, line in enumerate(text.split("\n"), start=1)
        if line.strip() and (not line.lstrip().startswith(("#", "%")) or line.startswith(_ROS_HEADER))
    ]
    if not lines:
        raise DataError("is empty: it has no rows", source)
    separator = next((mark for mark in ";\t," if mark in lines[len(lines) // 2][1]), None)
    return [
        (number, cells_of(line, separator, number, source) if separator else line.split()) for number, line in lines
    ], separator


def _text(content: bytes, source: str) -> str:
    """Return the text of a file: UTF-16 if it begins with its mark, else UTF-8, else Windows-1252."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", "replace")
    try:
        content.decode()
    except UnicodeDecodeError:
        content = content.decode("cp1252", "replace").encode()
    return text_of(content, source)


def _from_surface(table: DataTable, surface_mm: float, source: str, *, quiet: bool) -> DataTable:
    """Return the table with depth and x counted from the surface, and y and z from their medians before the entry.

    With y or z, the rows before the entry are left out, because no path of the tip is defined there. Raises DataError
    for a trial that has no such row or does not enter, because the zero of its y and z is unknown. A record of noise
    (`quiet`) keeps its y and z, because only their scatter is used.
    """
    numbers, notes = dict(table.numbers), []
    for name in {"depth_mm", "x_mm"} & numbers.keys():
        numbers[name] = numbers[name] - surface_mm
        notes.append(f"{name} counts from the reading {surface_mm:g} mm")
    aside = sorted({"y_mm", "z_mm"} & numbers.keys())
    frame = RecordFrame(FrameName.SURFACE, "entry", f"--surface {surface_mm:g} for {source}")
    if quiet or not aside or "depth_mm" not in numbers:
        return replace(table, numbers=numbers, notes=(*table.notes, *notes), frame=frame)
    trials = np.array(table.texts.get("trial", ("",) * len(table)))
    kept = np.ones(len(table), bool)
    mistakes: list[Mistake] = []
    for trial in dict.fromkeys(trials.tolist()):
        rows = np.flatnonzero(trials == trial)
        inside = numbers["depth_mm"][rows] > 0
        before = rows[: int(np.argmax(inside))]
        for name in aside:
            known = numbers[name][before][np.isfinite(numbers[name][before])]
            if not inside.any() or not known.size:
                mistakes.append(Mistake(f"{name}{f' of {trial}' * bool(trial)}", "", _no_origin(inside, surface_mm)))
                continue
            numbers[name] = numbers[name].copy()
            numbers[name][rows] -= np.median(known)
        kept[before] = False
    if mistakes:
        raise DataError(mistakes, source)
    notes.append(f"{', '.join(aside)} count from their medians in the {int((~kept).sum())} rows before the entry")
    whole = replace(table, numbers=numbers, notes=(*table.notes, *notes), frame=frame)
    return whole.rows(np.flatnonzero(kept))


def _no_origin(inside: np.ndarray[tuple[int], np.dtype[np.bool_]], surface_mm: float) -> str:
    """Return the rule that a trial violates if it has no measured row before the entry, or no row after it."""
    if not inside.any():
        return f"has no origin: the depth never goes beyond the surface at the reading {surface_mm:g} mm"
    return (
        f"has no origin: no row with a number is before the entry, at the reading {surface_mm:g} mm. Record the needle "
        "before the tissue, or read the trial without --surface"
    )


def _counted(cells: Array, column: str) -> Array:
    """Return times counted from the first, so that a sum of seconds and nanoseconds loses no digits; else the cells."""
    return cells - cells[0] if column == "time_s" and np.isfinite(cells[0]) else cells


def number_rows(
    rows: Sequence[RowCells],
    sources: dict[str, list[ColumnSource]],
    texts: dict[str, int],
    source: str,
    *,
    decimal_comma: bool,
) -> NumberRows:
    """Return the rows that have a number. Raises DataError for cells that are neither numbers nor empty."""
    indices = sorted({part.index for parts in sources.values() for part in parts})
    widest = max([*indices, *texts.values()])
    kept: list[list[float]] = []
    words: list[list[str]] = []
    lines: list[int] = []
    mistakes: list[Mistake] = []
    for number, row in rows:
        if len(row) <= widest:
            mistakes.append(Mistake(f"line {number}", "", f"has {len(row)} cells, but column {widest + 1} is needed"))
        else:
            values = [number_in(row[index].replace(",", ".") if decimal_comma else row[index]) for index in indices]
            mistakes += [
                Mistake(f"line {number}, column {index + 1}", row[index], _no_number(row[index], decimal_comma))
                for index, value in zip(indices, values, strict=True)
                if value is None
            ]
            numbers = [np.nan if value is None else value for value in values]
            if not np.isnan(numbers).all():
                kept.append(numbers)
                words.append([row[index] for index in texts.values()])
                lines.append(number)
        if len(mistakes) >= _MOST_MISTAKES:
            break
    mistakes = mistakes or (_mixed_decimals(rows, indices) if decimal_comma else [])
    if mistakes:
        raise DataError(mistakes, source)
    table = np.array(kept).reshape(-1, len(indices))
    columns = {index: table[:, place] for place, index in enumerate(indices)}
    return NumberRows(columns, {name: tuple(row[i] for row in words) for i, name in enumerate(texts)}, tuple(lines))


def _no_number(cell: str, decimal_comma: bool) -> str:
    hint = ""
    if _SIGNED.fullmatch(cell):
        thousands = decimal_comma or "." in cell
        hint = "separators of thousands" if thousands else "decimal commas between commas that separate the cells"
        hint = f"; {hint} are not read"
    return f"must be a number, or empty{hint}"


def _mixed_decimals(rows: Sequence[RowCells], indices: Sequence[int]) -> list[Mistake]:
    """Return a mistake if some numbers have a comma and others a point: one of them may separate thousands."""
    first: dict[str, tuple[str, str]] = {}
    for number, row in rows:
        for index in indices:
            for sign in {",", "."} & set(row[index]):
                first.setdefault(sign, (f"line {number}, column {index + 1}", row[index]))
        if len(first) == 2:
            (place, comma), (where, point) = first[","], first["."]
            rule = f"has a comma, but {point} ({where}) has a point: write all numbers with one decimal sign"
            return [Mistake(place, comma, f"{rule}, and without separators of thousands")]
    return []


def _measurements(rows: NumberRows, sources: dict[str, list[ColumnSource]]) -> tuple[NumberRows, list[str]]:
    """Return the rows that hold a measurement, with notes on the others.

    Rows in which all numbers are zero are written before a sensor has measured. Such a row is kept if it is the only
    one, the first, and its time fits to the next one; or if there are no times.
    """
    table = np.column_stack(list(rows.cells.values()))
    empty = (table == 0).all(axis=1)
    times = sources.get("time_s", [])
    if not times:
        empty[:] = False
    elif empty.sum() == 1 and empty[0] and len(rows.lines) > 2:
        time = np.sum([part.factor * rows.cells[part.index] for part in times], axis=0)
        steps = np.abs(np.diff(time))
        empty[0] = steps[0] > _RESET_INTERVALS * np.median(steps[1:])
    same = np.zeros(len(table), bool)
    same[1:] = (table[1:] == table[:-1]).all(axis=1) & bool(times) & ~empty[1:]
    notes = []
    for mask, description in ((empty, "of zeros"), (same, "that repeat the row before")):
        if mask.any():
            first = rows.lines[int(np.flatnonzero(mask)[0])]
            count = int(mask.sum())
            notes.append(f"rows {description} were left out: {count}, the first in line {first}")
    return rows.where(~(empty | same)), notes


def _with_trials(table: DataTable, source: str) -> DataTable:
    """Return the table with a column `trial` if the clock begins again; else the table itself."""
    time = table.numbers["time_s"]
    if "trial" in table.texts or len(table) < 3:
        return table
    usual = float(np.nanmedian(np.abs(np.diff(time))))
    begins = np.flatnonzero((np.diff(time) < 0) & (np.abs(time[1:] - time[0]) <= _RESET_INTERVALS * usual)) + 1
    if not begins.size or disordered(time):
        return table
    part = np.searchsorted(begins, np.arange(len(table)), side="right") + 1
    trials = tuple(f"{Path(source).stem} part {number}" for number in part)
    places = ", ".join(table.places[row] for row in begins[:5])
    note = f"the clock begins again in {places}{' ...' * (begins.size > 5)}: {begins.size + 1} trials"
    return DataTable(table.numbers, {**table.texts, "trial": trials}, table.places, (*table.notes, note))


def _with_times(table: DataTable, speed_mm_s: float) -> DataTable:
    """Return the table of an insertion at constant speed, sorted by depth; equal depths are averaged."""
    depth = table.numbers["depth_mm"]
    back = int((np.diff(depth) < 0).sum())
    places, first, group = np.unique(depth, return_index=True, return_inverse=True)
    counts = np.bincount(group)
    numbers = {name: np.bincount(group, values) / counts for name, values in table.numbers.items()}
    numbers |= {
        "depth_mm": places,
        "time_s": (places - places[0]) / speed_mm_s,
        "velocity_mm_s": np.full(places.size, speed_mm_s),
    }
    notes = [f"times follow from the depth at {speed_mm_s:g} mm/s"]
    notes += [f"{back} points were sorted by depth"] * bool(back)
    notes += [f"{depth.size - places.size} points at equal depth were averaged"] * bool(depth.size > places.size)
    rows = table.rows(first)
    return DataTable(numbers, rows.texts, rows.places, (*table.notes, *notes))


def with_velocity(record: Record) -> Record:
    """Return the record with a velocity that follows from the depth; the record itself if it needs none.

    The depth is then constant where the needle stands, see `MeasuredMotion`. A record of noise needs no velocity.
    """
    if record.role is Role.NOISE or "depth_mm" not in record.columns or "velocity_mm_s" in record.columns:
        return record
    motion = MeasuredMotion.of(record["time_s"], record["depth_mm"])
    columns = {**record.columns, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    return replace(record, columns=columns, notes=(*record.notes, _motion_note(motion)))


def _motion_note(motion: MeasuredMotion) -> str:
    """Return the remark on a velocity that follows from the depth, with the steps of a stepwise insertion."""
    text = (
        f"velocity_mm_s follows from depth_mm (noise {motion.noise_mm:.2g} mm), by slopes over {motion.window_s:.2g} s"
    )
    stands = sum(still for _, still in motion.parts())
    if not stands:
        return f"{text}; the needle never stands for 0.5 s"
    share = float(np.mean(motion.standing))
    text += f"; it is 0 where the needle stands, {share:.0%} of the samples in {stands} part{'s' * (stands > 1)}"
    steps = np.abs(motion.steps_mm)
    if steps.size > 1:
        text += f", with {steps.size} movements of {np.median(steps):.3g} mm (median) between them"
    return text
