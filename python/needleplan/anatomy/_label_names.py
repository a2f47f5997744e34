"""Names of labels in the tables of other programs: 3D Slicer (.ctbl, .csv) and ITK-SNAP (.txt)."""

from __future__ import annotations

import csv
import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path

from needleplan.anatomy._labels import read_color_table
from needleplan.anatomy._volume import is_label
from needleplan.errors import Mistake, ScenarioError, reading

__all__ = ["BETWEEN", "OUTSIDE", "TABLE_ENDINGS", "name_mistakes", "read_label_names", "table_name"]

TABLE_ENDINGS = (".ctbl", ".csv", ".txt")
# Names of the label 0 of a case: with a mask of the body, and without one.
OUTSIDE, BETWEEN = "outside", "between"
# Columns of a table of 3D Slicer.
_NUMBER, _NAME = "LabelValue", "Name"
# Words of a line of ITK-SNAP: number, colours and visibilities, and the name in quotes.
_SNAP_WORDS = 8


def read_label_names(file: Path) -> dict[str, int]:
    """Return the label numbers of a table file, by label name.

    Raises ScenarioError if the file is not a label table of 3D Slicer (.ctbl, .csv) or ITK-SNAP (.txt).
    """
    if file.suffix.lower() == ".ctbl":
        return read_color_table(file)
    source = str(file)
    with reading(source, ScenarioError):
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    rows = _of_slicer(lines, source) if file.suffix.lower() == ".csv" else _of_snap(lines, source)
    names: dict[str, int] = {}
    for number, name in rows:
        if names.setdefault(name, number) != number:
            raise ScenarioError(Mistake(name, f"{number}", f"is also the name of label {names[name]}"), source)
    if not names:
        raise ScenarioError("contains no labels", source)
    return names


def table_name(name: str) -> str:
    """Return a name as colour tables have it, without blanks."""
    return "_".join(name.split())


def name_mistakes(names: Iterable[tuple[str, str]]) -> Iterator[Mistake]:
    """Yield the mistakes of names of structures, each with its file: every one must differ in a colour table."""
    first: dict[str, str] = {}
    for name, source in names:
        written = table_name(name)
        if not written or not written.isprintable():
            yield Mistake("name of a structure", name, f"must have letters and no control characters, in {source}")
        elif written in (OUTSIDE, BETWEEN):
            yield Mistake(name, "", f"is the name of what lies between structures: rename it in {source}")
        elif written in first:
            yield Mistake(name, "", f"is in {first[written]} and in {source}, as {written}")
        first.setdefault(written, source)


def _of_slicer(lines: list[str], source: str) -> list[tuple[int, str]]:
    try:
        rows = list(csv.DictReader(lines))
    except csv.Error as error:
        raise ScenarioError(f"cannot be read: {error}", source) from None
    if not rows or not {_NUMBER, _NAME} <= set(rows[0]):
        raise ScenarioError(f"must have the columns {_NUMBER} and {_NAME}", source)
    return [(_number(row[_NUMBER], number, source), row[_NAME] or "") for number, row in enumerate(rows, start=2)]


def _of_snap(lines: list[str], source: str) -> list[tuple[int, str]]:
    found = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            words = shlex.split(line)
        except ValueError:
            words = []
        if len(words) != _SNAP_WORDS:
            rule = 'must be IDX R G B A VIS MSH "LABEL", as ITK-SNAP writes it'
            raise ScenarioError(Mistake(f"line {number}", line.strip()[:60], rule), source)
        found.append((_number(words[0], number, source), words[-1]))
    return found


def _number(text: str | None, line: int, source: str) -> int:
    if text is None or not is_label(text.strip()):
        raise ScenarioError(Mistake(f"line {line}", str(text), "must begin with the number of a label"), source)
    return int(text)
