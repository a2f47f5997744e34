"""The header of a foreign text file: where it is, and which of its columns and units a `ColumnMap` means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.config import closest
from needleplan.errors import DataError, InputError, Mistake
from needleplan.recording._column_map import ColumnMap, ColumnTerm, described, unit_in
from needleplan.recording.columns import unit_factor, units_of
from needleplan.recording.csv_file import number_in
from needleplan.signals import UNITS

__all__ = ["ColumnSource", "RowCells", "find_header", "find_sources"]

# Number of lines among which the header and the first row of numbers are looked for.
_MOST_PREAMBLE = 200
# Columns that a record of noise may lack: those of the motion.
_MOTION = ("depth_mm", "velocity_mm_s", "angle_rad")
# Columns with units; the unit of a duty cycle, 1, may be any number.
_WITH_UNITS = tuple(column for column in UNITS if column != "duty_cycle")

RowCells = tuple[int, list[str]]
"""Number of a line, and its cells."""


@dataclass(frozen=True)
class ColumnSource:
    """One column of the file: its index from 0, and the factor, with the sign, to the unit of the quantity."""

    index: int
    factor: float


def find_header(rows: Sequence[RowCells], columns: ColumnMap, source: str) -> tuple[list[str], int]:
    """Return the header, empty if there is none, and the index of the first row of numbers.

    The header is the row with the most named columns; if all columns are given by number, the row before the numbers.
    If a row of units stands between the header and the numbers, the names are returned with these units.
    """
    terms = [term for sums in columns.numbers.values() for term in sums]
    named = [term for term in terms if not term.number]
    header_row, header = -1, [""]
    if named:
        preamble = [cells for _, cells in rows[:_MOST_PREAMBLE]]
        hits = [sum(bool(term.places_in(cells)) for term in named) for cells in preamble]
        header_row = int(np.argmax(hits))
        header = preamble[header_row]
        if not hits[header_row]:
            rule = f"is not in the file, which begins with {', '.join(preamble[0][:12])}"
            hint = ". Without a header, give columns by number, as in force=2[N]"
            raise DataError([Mistake(f"column {term.name}", "", rule + hint) for term in named], source)
    places = [place for term in terms for place in term.places_in(header)]
    places = places or [term.number - 1 for term in terms if term.number]
    first = header_row + 1
    for index, (_, cells) in enumerate(rows[first : first + _MOST_PREAMBLE], start=first):
        if any(place < len(cells) and _is_number(cells[place]) for place in places):
            above = [row for _, row in rows[max(header_row, 0) : index]]
            last = above[-1] if above else []
            if named:
                return _with_units(header, last) or header, index
            names = above[-2] if len(above) > 1 else []
            return _with_units(names, last) or last, index
    raise DataError("has no row with numbers in the columns that were given", source)


def _is_number(cell: str) -> bool:
    value = number_in(cell.replace(",", "."))
    return value is not None and not np.isnan(value)


def find_sources(
    header: Sequence[str], columns: ColumnMap, quiet: bool, source: str
) -> tuple[dict[str, list[ColumnSource]], dict[str, int], list[str]]:
    """Return the columns of each quantity, the index of each text, and a note on how the quantities were read."""
    sources: dict[str, list[ColumnSource]] = {}
    descriptions: list[str] = []
    mistakes: list[Mistake] = []
    for column, terms in columns.numbers.items():
        if quiet and column in _MOTION and not all(term.places_in(header) for term in terms):
            continue
        parts: list[ColumnSource] = []
        units: list[str] = []
        for term in terms:
            try:
                place, unit = _place(term, header, column)
            except InputError as error:
                mistakes += error.mistakes
            else:
                units.append(unit)
                parts.append(ColumnSource(place, term.sign * ((unit_factor(column, unit) if unit else 1.0) or 1.0)))
        sources[column] = parts
        descriptions += [described(column, terms, units)] if len(units) == len(terms) else []
    texts = {}
    for name, wanted in columns.texts.items():
        places = ColumnTerm(wanted).places_in(header)
        if len(places) == 1:
            texts[name] = places[0]
        elif places:
            mistakes.append(_ambiguous(wanted, header, places))
        elif not quiet:
            mistakes.append(_unknown(wanted, header))
    if mistakes:
        raise DataError(mistakes, source)
    return sources, texts, [f"read {', '.join(descriptions)}"]


def _place(term: ColumnTerm, header: Sequence[str], column: str) -> tuple[int, str]:
    """Return index and unit of the column that a term names. Raises InputError if name or unit are not clear."""
    places = term.places_in(header)
    if len(places) > 1:
        raise InputError(_ambiguous(term.name, header, places))
    if not places and not term.number:
        raise InputError(_unknown(term.name, header))
    place = places[0] if places else (term.number or 1) - 1
    unit = term.unit_of(header[place] if place < len(header) else "", column)
    if unit and unit_factor(column, unit) is None:
        rule = f"is no known unit of {column}: give one of {', '.join(units_of(column))} in brackets"
        raise InputError(Mistake(f"unit of column {term.name}", unit, rule))
    return place, unit


def _with_units(names: Sequence[str], last: Sequence[str]) -> list[str]:
    """Return `names` with the units of the last line before the numbers; empty if this line is not a row of units."""
    units = [cell.strip("[]()") for cell in last]
    known = [any(unit_factor(column, unit) is not None for column in _WITH_UNITS) for unit in units if unit]
    if not known or not all(known) or len(units) != len(names):
        return []
    return [f"{name} [{unit}]" if unit and not unit_in(name) else name for name, unit in zip(names, units, strict=True)]


def _ambiguous(name: str, header: Sequence[str], places: Sequence[int]) -> Mistake:
    candidates = ", ".join(f"{place + 1} ({header[place]})" for place in places)
    return Mistake(f"column {name}", "", f"is ambiguous: it may be one of the columns {candidates}; give its number")


def _unknown(name: str, header: Sequence[str]) -> Mistake:
    close = closest(name, header, cutoff=0.5)
    hint = f'did you mean "{close}"?' if close else f"the columns are {', '.join(header[:12])}"
    return Mistake(f"column {name}", "", f"is not in the file; {hint}")
