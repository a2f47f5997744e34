"""CSV: a header with the names of the columns, then one row a sample.

UTF-8; separated by commas, semicolons or tabs, whichever the header uses; decimal points. An empty cell or `nan` is a
missing number. Lines that begin with `#`, and empty lines, are remarks.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.recording.cells import number_in, rows_of_cells
from needleplan.recording.columns import NUMBERS, TEXTS, judge_names
from needleplan.recording.table import Table
from needleplan.signals import Record
from needleplan.signals.record import UNITS

__all__ = ["parse_csv", "to_csv"]

_MOST_MISTAKES = 10
_PRECISION = ".17g"


def parse_csv(content: bytes, source: str) -> Table:
    """Return the rows of a CSV file. Raises DataError with the mistakes of the header, or of the first bad rows."""
    lines, rows = rows_of_cells(content, source)
    if not lines:
        raise DataError("is empty: it must begin with a header such as time_s,depth_mm,force_n", source)
    header = rows[0][1]
    _require_names(header, lines[0], source)
    unknown, mistakes = judge_names(header)
    if mistakes:
        raise DataError(mistakes, source)
    if len(rows) == 1:
        raise DataError("has a header but no rows", source)
    numbers: dict[str, list[float]] = {name: [] for name in header if name in NUMBERS}
    texts: dict[str, list[str]] = {name: [] for name in header if name in TEXTS}
    for number, cells in rows[1:]:
        mistakes += _read_row(number, header, cells, numbers, texts)
        if len(mistakes) >= _MOST_MISTAKES:
            break
    if mistakes:
        raise DataError(mistakes, source)
    notes = (f"columns that nothing here needs were left out: {', '.join(unknown)}",) if unknown else ()
    return Table(
        {name: np.array(values) for name, values in numbers.items()},
        {name: tuple(values) for name, values in texts.items()},
        tuple(f"line {number}" for number, _ in rows[1:]),
        notes,
    )


def to_csv(records: Sequence[Record]) -> str:
    """Return the text of a CSV file that reads back as these records; numbers to the last bit, missing ones empty.

    Raises DataError for names of trials or phases with a line break.
    """
    if any("\n" in text or "\r" in text for record in records for text in (record.trial, *record.phase)):
        raise DataError("names of trials and phases must not have line breaks")
    numbers = [name for name in UNITS if any(name in record.columns for record in records)]
    phases = ["phase"] if any(record.phase for record in records) else []
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*numbers, *phases, "trial", "role"])
    for record in records:
        for row in range(len(record)):
            cells = [_cell(record.columns[name][row]) if name in record.columns else "" for name in numbers]
            phase = [record.phase[row] if record.phase else ""] if phases else []
            writer.writerow([*cells, *phase, record.trial, record.role])
    return stream.getvalue()


def _require_names(header: Sequence[str], line: tuple[int, str], source: str) -> None:
    """Raise DataError where the first line is no header at all, which the names of its columns would not explain."""
    number, text = line
    if all(number_in(cell) is not None for cell in header):
        rule = "holds numbers: a header with the names of the columns must stand above them, such as time_s,depth_mm"
    elif len(header) == 1 and "time_s" in text.split():
        rule = "is one cell: columns must be separated by commas, semicolons or tabs, not by spaces"
    else:
        return
    raise DataError(Mistake(f"line {number}", text[:60], rule), source)


def _cell(number: float) -> str:
    return "" if math.isnan(number) else format(number, _PRECISION)


def _read_row(
    number: int,
    header: Sequence[str],
    cells: Sequence[str],
    numbers: dict[str, list[float]],
    texts: dict[str, list[str]],
) -> list[Mistake]:
    if len(cells) != len(header):
        rule = f"must have {len(header)} cells like the header, not {len(cells)}; decimal commas are not read"
        return [Mistake(f"line {number}", "", rule)]
    mistakes = []
    for name, cell in zip(header, cells, strict=True):
        if name in texts:
            texts[name].append(cell)
        elif name in numbers:
            value = number_in(cell)
            if value is None:
                rule = f"must be a number in {UNITS[name]}, or empty"
                if "," in cell:
                    rule += "; decimal commas are not read: write decimal points"
                mistakes.append(Mistake(f"{name} (line {number})", cell, rule))
            else:
                numbers[name].append(value)
    return mistakes
