"""Text files of other laboratories, whose columns a `ColumnMap` names: with or without a header, in any known units.

Lines before the header, or before the first row of numbers, are left out, and so are rows of units after the header.
The separator is a semicolon, tab, comma or white space; decimal commas are read if the separator is not a comma. Left
out with a note are rows without any number, rows of zeros before a sensor has measured, and rows that repeat the row
before them. If the clock begins again, the rows after it are a further trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needleplan.config import closest
from needleplan.errors import DataError, Mistake
from needleplan.recording._column_map import ColumnMap, ColumnTerm, described
from needleplan.recording.columns import unit_factor, units_of
from needleplan.recording.csv_file import cells_of, number_in, text_of
from needleplan.recording.table import Table
from needleplan.signals import Array, MeasuredMotion, Record, Role

__all__ = ["parse_foreign", "with_velocity"]

# Number of lines among which the header and the first row of numbers are looked for.
_MOST_PREAMBLE = 200
# Number of mistakes at which reading stops.
_MOST_MISTAKES = 10
# Number of median intervals from the first time, up to which a smaller time is a clock that begins again.
_RESET_INTERVALS = 5.0
# Columns that a record of noise may lack: those of the motion.
_MOTION = ("depth_mm", "velocity_mm_s", "angle_rad")

_Row = tuple[int, list[str]]


@dataclass(frozen=True)
class _Source:
    """One column of the file: its index from 0, and the factor, with the sign, to the unit of the quantity."""

    index: int
    factor: float


@dataclass(frozen=True)
class _Rows:
    """Rows of numbers: `cells` by index of the column, each of shape (samples,), texts, and lines in the file."""

    cells: dict[int, Array]
    texts: dict[str, tuple[str, ...]]
    lines: tuple[int, ...]

    def where(self, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> _Rows:
        """Return the rows of a mask."""
        at = np.flatnonzero(kept)
        return _Rows(
            {index: values[at] for index, values in self.cells.items()},
            {name: tuple(values[row] for row in at) for name, values in self.texts.items()},
            tuple(self.lines[row] for row in at),
        )


def parse_foreign(content: bytes, source: str, columns: ColumnMap, *, quiet: bool = False) -> Table:
    """Return the rows of a text file in the columns and units of `columns`, times counted from the first row.

    `quiet` marks a record of noise, which may lack the columns of the motion. Raises DataError with all mistakes if a
    column is not in the file, its unit is not known, or a cell is not a number.
    """
    text = _text(content, source).replace("\r\n", "\n").replace("\r", "\n")
    lines = [
        (number, line)
        for number, line in enumerate(text.split("\n"), start=1)
        if line.strip() and not line.lstrip().startswith(("#", "%"))
    ]
    if not lines:
        raise DataError("is empty: it has no rows", source)
    separator = next((each for each in ";\t," if each in lines[len(lines) // 2][1]), None)
    rows = [
        (number, cells_of(line, separator, number, source) if separator else line.split()) for number, line in lines
    ]
    header, first = _header(rows, columns, source)
    sources, texts, notes = _sources(header, columns, quiet, source)
    if rows[first][0] > (2 if header else 1):
        notes.append(f"the rows of numbers begin in line {rows[first][0]}")
    found = _numbers(rows[first:], sources, texts, source, decimal_comma=separator != ",")
    found, left_out = _measurements(found, sources)
    numbers = {
        column: np.sum([each.factor * _counted(found.cells[each.index], column) for each in parts], axis=0)
        for column, parts in sources.items()
    }
    places = tuple(f"line {number}" for number in found.lines)
    table = Table(numbers, found.texts, places, (*notes, *left_out))
    table = _with_times(table, columns.speed_mm_s) if columns.speed_mm_s else _with_trials(table, source)
    return table if columns.surface_mm is None else _from_surface(table, columns.surface_mm)


def _text(content: bytes, source: str) -> str:
    """Return the text of a file: UTF-16 if it begins with its mark, else UTF-8, else Windows-1252."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", "replace")
    try:
        content.decode()
    except UnicodeDecodeError:
        content = content.decode("cp1252", "replace").encode()
    return text_of(content, source)


def _from_surface(table: Table, surface_mm: float) -> Table:
    """Return the table with depth and x counted from the surface, and y and z from their medians before the entry.

    With y or z, the rows before the entry are left out, because no path of the tip is defined there.
    """
    numbers, notes = dict(table.numbers), []
    for name in {"depth_mm", "x_mm"} & numbers.keys():
        numbers[name] = numbers[name] - surface_mm
        notes.append(f"{name} counts from the reading {surface_mm:g} mm")
    aside = {"y_mm", "z_mm"} & numbers.keys()
    if not aside or "depth_mm" not in numbers:
        return replace(table, numbers=numbers, notes=(*table.notes, *notes))
    inside = numbers["depth_mm"] > 0
    trials = np.array(table.texts.get("trial", ("",) * len(table)))
    kept = np.zeros(len(table), bool)
    for trial in dict.fromkeys(trials.tolist()):
        rows = np.flatnonzero(trials == trial)
        before = int(np.argmax(inside[rows])) if inside[rows].any() else 0
        kept[rows[before:]] = True
        for name in sorted(aside) if before else ():
            numbers[name] = numbers[name].copy()
            numbers[name][rows] -= np.nanmedian(numbers[name][rows[:before]])
    notes.append(
        f"{', '.join(sorted(aside))} count from their medians in the {int((~kept).sum())} rows before the entry"
    )
    return replace(table, numbers=numbers, notes=(*table.notes, *notes)).rows(np.flatnonzero(kept))


def _counted(cells: Array, column: str) -> Array:
    """Return times counted from the first, so that a sum of seconds and nanoseconds loses no digits; else the cells."""
    return cells - cells[0] if column == "time_s" and np.isfinite(cells[0]) else cells


def _header(rows: Sequence[_Row], columns: ColumnMap, source: str) -> tuple[list[str], int]:
    """Return the header, empty if there is none, and the index of the first row of numbers.

    The header is the row with the most named columns; if all columns are given by number, the row before the numbers.
    """
    terms = [term for each in columns.numbers.values() for term in each]
    named = [term for term in terms if not term.number]
    at, header = -1, [""]
    if named:
        early = [cells for _, cells in rows[:_MOST_PREAMBLE]]
        hits = [sum(term.place_in(cells) is not None for term in named) for cells in early]
        at = int(np.argmax(hits))
        header = early[at]
        if not hits[at]:
            rule = f"is not in the file, which begins with {', '.join(early[0][:12])}"
            hint = ". Without a header, give columns by number, as in force=2[N]"
            raise DataError([Mistake(f"column {term.name}", "", rule + hint) for term in named], source)
    places = [place[0] for term in terms if (place := term.place_in(header))]
    places = places or [term.number - 1 for term in terms if term.number]
    for index, (_, cells) in enumerate(rows[at + 1 : at + 1 + _MOST_PREAMBLE], start=at + 1):
        if any(place < len(cells) and _is_number(cells[place]) for place in places):
            return (header if named else rows[index - 1][1] if index else []), index
    raise DataError("has no row with numbers in the columns that were given", source)


def _is_number(cell: str) -> bool:
    value = number_in(cell.replace(",", "."))
    return value is not None and not np.isnan(value)


def _sources(
    header: Sequence[str], columns: ColumnMap, quiet: bool, source: str
) -> tuple[dict[str, list[_Source]], dict[str, int], list[str]]:
    """Return the columns of each quantity, the index of each text, and a note on how the quantities were read."""
    found: dict[str, list[_Source]] = {}
    said: list[str] = []
    mistakes: list[Mistake] = []
    for column, terms in columns.numbers.items():
        places = [term.place_in(header) or ((term.number - 1, term.unit) if term.number else None) for term in terms]
        if quiet and column in _MOTION and None in places:
            continue
        units = [place[1] if place else "" for place in places]
        factors = [unit_factor(column, unit) if unit else 1.0 for unit in units]
        for term, place, unit, factor in zip(terms, places, units, factors, strict=True):
            if place is None:
                mistakes.append(_unknown(term.name, header))
            elif factor is None:
                rule = f"is no known unit of {column}: give one of {', '.join(units_of(column))} in brackets"
                mistakes.append(Mistake(f"unit of column {term.name}", unit, rule))
        found[column] = [
            _Source(place[0], term.sign * factor)
            for term, place, factor in zip(terms, places, factors, strict=True)
            if place and factor
        ]
        said.append(described(column, terms, units))
    texts = {}
    for name, wanted in columns.texts.items():
        place = ColumnTerm(wanted).place_in(header)
        if place:
            texts[name] = place[0]
        elif not quiet:
            mistakes.append(_unknown(wanted, header))
    if mistakes:
        raise DataError(mistakes, source)
    return found, texts, [f"read {', '.join(said)}"]


def _unknown(name: str, header: Sequence[str]) -> Mistake:
    close = closest(name, header, cutoff=0.5)
    hint = f'did you mean "{close}"?' if close else f"the columns are {', '.join(header[:12])}"
    return Mistake(f"column {name}", "", f"is not in the file; {hint}")


def _numbers(
    rows: Sequence[_Row], sources: dict[str, list[_Source]], texts: dict[str, int], source: str, *, decimal_comma: bool
) -> _Rows:
    """Return the rows that have a number. Raises DataError for cells that are neither numbers nor empty."""
    indices = sorted({each.index for parts in sources.values() for each in parts})
    widest = max([*indices, *texts.values()])
    kept: list[list[float]] = []
    words: list[list[str]] = []
    lines: list[int] = []
    mistakes: list[Mistake] = []
    for number, row in rows:
        if len(row) <= widest:
            mistakes.append(Mistake(f"line {number}", "", f"has {len(row)} cells, but column {widest + 1} is needed"))
        else:
            cells = [row[index].replace(",", ".") if decimal_comma else row[index] for index in indices]
            values = [number_in(cell) for cell in cells]
            mistakes += [
                Mistake(f"line {number}, column {index + 1}", cell, "must be a number, or empty")
                for index, cell, value in zip(indices, cells, values, strict=True)
                if value is None
            ]
            numbers = [np.nan if value is None else value for value in values]
            if not np.isnan(numbers).all():
                kept.append(numbers)
                words.append([row[index] for index in texts.values()])
                lines.append(number)
        if len(mistakes) >= _MOST_MISTAKES:
            break
    if mistakes:
        raise DataError(mistakes, source)
    table = np.array(kept).reshape(-1, len(indices))
    columns = {index: table[:, place] for place, index in enumerate(indices)}
    return _Rows(columns, {name: tuple(row[i] for row in words) for i, name in enumerate(texts)}, tuple(lines))


def _measurements(rows: _Rows, sources: dict[str, list[_Source]]) -> tuple[_Rows, list[str]]:
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
        time = np.sum([each.factor * rows.cells[each.index] for each in times], axis=0)
        steps = np.abs(np.diff(time))
        empty[0] = steps[0] > _RESET_INTERVALS * np.median(steps[1:])
    same = np.zeros(len(table), bool)
    same[1:] = (table[1:] == table[:-1]).all(axis=1) & bool(times) & ~empty[1:]
    notes = []
    for mask, what in ((empty, "of zeros"), (same, "that repeat the row before")):
        if mask.any():
            first = rows.lines[int(np.flatnonzero(mask)[0])]
            count = int(mask.sum())
            notes.append(f"rows {what} were left out: {count}, the first in line {first}")
    return rows.where(~(empty | same)), notes


def _with_trials(table: Table, source: str) -> Table:
    """Return the table with a column `trial` if the clock begins again; else the table itself."""
    time = table.numbers["time_s"]
    if "trial" in table.texts or len(table) < 3:
        return table
    usual = float(np.nanmedian(np.abs(np.diff(time))))
    begins = np.flatnonzero((np.diff(time) < 0) & (np.abs(time[1:] - time[0]) <= _RESET_INTERVALS * usual)) + 1
    if not begins.size:
        return table
    part = np.searchsorted(begins, np.arange(len(table)), side="right") + 1
    trials = tuple(f"{Path(source).stem} part {number}" for number in part)
    places = ", ".join(table.places[row] for row in begins[:5])
    note = f"the clock begins again in {places}{' ...' * (begins.size > 5)}: {begins.size + 1} trials"
    return Table(table.numbers, {**table.texts, "trial": trials}, table.places, (*table.notes, note))


def _with_times(table: Table, speed_mm_s: float) -> Table:
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
    return Table(numbers, rows.texts, rows.places, (*table.notes, *notes))


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
    said = (
        f"velocity_mm_s follows from depth_mm (noise {motion.noise_mm:.2g} mm), by slopes over {motion.window_s:.2g} s"
    )
    stands = sum(still for _, still in motion.parts())
    if not stands:
        return f"{said}; the needle never stands for 0.5 s"
    share = float(np.mean(motion.standing))
    said += f"; it is 0 where the needle stands, {share:.0%} of the samples in {stands} part{'s' * (stands > 1)}"
    steps = np.abs(motion.steps_mm)
    if steps.size > 1:
        said += f", with {steps.size} movements of {np.median(steps):.3g} mm (median) between them"
    return said
