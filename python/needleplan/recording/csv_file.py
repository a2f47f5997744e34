"""CSV files of trials: a header with the names of the columns, then one row for each sample.

The text is UTF-8 with decimal points. The separator is the comma, semicolon or tab that occurs most in the header. An
empty cell or `nan` is a missing number. Empty lines and lines that begin with `#` are ignored.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.recording.columns import NUMBERS, TEXTS, validate_names
from needleplan.recording.table import DataTable
from needleplan.signals import UNITS, Record

__all__ = ["cells_of", "number_in", "parse_csv", "rows_of_cells", "text_of", "to_csv"]

_SEPARATORS = ",;\t"


def rows_of_cells(content: bytes, source: str) -> tuple[list[tuple[int, str]], list[tuple[int, list[str]]]]:
    """Return the lines of a CSV file and the cells of these lines, each with the line number; the header is first.

    Empty lines and comment lines are left out. Raises DataError if the content is not UTF-8 text, or a quoted cell does
    not end on its line.
    """
    text = text_of(content, source)
    lines = [
        (number, line)
        for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        return [], []
    separator = max(_SEPARATORS, key=lines[0][1].count)
    # Each line is parsed separately, so that a missing closing quote cannot extend a cell to the end of the file.
    return lines, [(number, cells_of(line, separator, number, source)) for number, line in lines]


def number_in(cell: str) -> float | None:
    """Return the number in a cell, NaN for an empty cell, None for other text.

    Infinite numbers and numbers with underscores, such as 1_000, count as other text.
    """
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return None if math.isinf(value) or "_" in cell else value


def text_of(content: bytes, source: str) -> str:
    """Return the text of a file. Raises DataError if it is not UTF-8, or not a text."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise DataError("is UTF-16: save it as UTF-8", source)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise DataError(Mistake(f"line {line}", "", f"is not UTF-8 (byte {error.start})"), source) from None
    if "\0" in text:
        raise DataError("holds null characters: it is not a CSV file", source)
    return text


def cells_of(line: str, separator: str, number: int, source: str) -> list[str]:
    """Return the cells of a line. Raises DataError if a quoted cell does not end on the line."""
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True))]
    except (csv.Error, StopIteration) as error:
        raise DataError(Mistake(f"line {number}", line[:100], f"cannot be read: {error}"), source) from None


_MOST_MISTAKES = 10  # number of mistakes at which reading stops
_PRECISION = ".17g"  # format of numbers: 17 digits, so that reading returns identical numbers


def parse_csv(content: bytes, source: str) -> DataTable:
    """Return the rows of a CSV file as a table.

    Raises DataError if `content` is not UTF-8 text with a header and rows; with all mistakes in the header or, if there
    are none, with the first mistakes in the rows.
    """
    lines, rows = rows_of_cells(content, source)
    if not lines:
        raise DataError("is empty: it must begin with a header such as time_s,depth_mm,force_n", source)
    header = rows[0][1]
    _require_names(header, lines[0], source)
    unknown, mistakes = validate_names(header)
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
    notes = (f"unknown columns were left out: {', '.join(unknown)}",) if unknown else ()
    return DataTable(
        {name: np.array(values) for name, values in numbers.items()},
        {name: tuple(values) for name, values in texts.items()},
        tuple(f"line {number}" for number, _ in rows[1:]),
        notes,
    )


def to_csv(records: Sequence[Record]) -> str:
    """Return the records as CSV text; reading it returns identical numbers. Missing numbers become empty cells.

    Raises DataError if the name of a trial or phase has a line break.
    """
    if any(
        "\n" in text or "\r" in text for record in records for text in (record.trial, record.frame.text, *record.phase)
    ):
        raise DataError("names of trials, phases and frames must not have line breaks")
    numbers = [name for name in UNITS if any(name in record.columns for record in records)]
    phases = ["phase"] if any(record.phase for record in records) else []
    frames = ["coordinate_frame"] if any(record.frame.known for record in records) else []
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*numbers, *phases, "trial", "role", *frames])
    for record in records:
        for row in range(len(record)):
            cells = [_cell(record.columns[name][row]) if name in record.columns else "" for name in numbers]
            phase = [record.phase[row] if record.phase else ""] if phases else []
            writer.writerow([*cells, *phase, record.trial, record.role, *(record.frame.text for _ in frames)])
    return stream.getvalue()


def _require_names(header: Sequence[str], line: tuple[int, str], source: str) -> None:
    """Raise DataError if the first line contains only numbers, or is a single cell with several column names."""
    number, text = line
    if all(number_in(cell) is not None for cell in header):
        rule = (
            "holds numbers: the first line must be a header with the names of the columns, such as time_s,depth_mm; "
            "without one, --columns gives them by number, as in depth=1[mm]"
        )
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
        rule = f"must have {len(header)} cells like the header, not {len(cells)}"
        if len(cells) > len(header):
            ends = "the line ends with a separator that the header does not have"
            rule += f"; {'decimal commas are not read' if cells[-1] else ends}"
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
