"""The cells of a CSV file, before anybody asks what they mean.

UTF-8; separated by commas, semicolons or tabs, whichever the header uses; decimal points. An empty cell or `nan` is a
missing number. Lines that begin with `#`, and empty lines, are remarks.
"""

from __future__ import annotations

import csv
import math

from needleplan.errors import DataError, Mistake

__all__ = ["number_in", "rows_of_cells"]

_SEPARATORS = ",;\t"


def rows_of_cells(content: bytes, source: str) -> tuple[list[tuple[int, str]], list[tuple[int, list[str]]]]:
    """Return the lines that are not remarks and their cells, each with its number in the file; the header is the first.

    Raises DataError for what is no text in UTF-8, and for stray quotes.
    """
    text = _text(content, source)
    lines = [
        (number, line)
        for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        return [], []
    separator = max(_SEPARATORS, key=lines[0][1].count)
    # A quoted cell must not run over the end of its line: one stray quote would swallow the rest of the file.
    return lines, [(number, _cells(line, separator, number, source)) for number, line in lines]


def number_in(cell: str) -> float | None:
    """Return a number, NaN for a missing one, None for anything else; infinite ones and 1_000 are something else."""
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return None if math.isinf(value) or "_" in cell else value


def _text(content: bytes, source: str) -> str:
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


def _cells(line: str, separator: str, number: int, source: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True))]
    except (csv.Error, StopIteration) as error:
        raise DataError(Mistake(f"line {number}", line[:100], f"cannot be read: {error}"), source) from None
