"""Text files of tracked poses and of pairs of points: own columns, columns that a map names, and exports of others.

Preambles, decimal commas, units and signs are read as in `_foreign_file`. Without a map, the columns are
found by their names in the header:

- own names, such as x_mm and qw,
- the names of NDI ToolBox, Tx, Ty, Tz, Q0, Qx, Qy, Qz (mm),
- the names of ROS exports that end in position.x and orientation.w, or translation.x and rotation.w, with points or
  slashes (m).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.recording._column_map import ColumnMap, ColumnTerm, Vocabulary
from needleplan.recording._foreign_file import cell_rows, number_rows
from needleplan.recording._foreign_header import RowCells, find_header, find_sources
from needleplan.signals import Array

__all__ = ["POINTS", "POSES", "QUATERNION", "TrackedRows", "read_tracked"]

QUATERNION = ("qw", "qx", "qy", "qz")
"""Columns of a unit quaternion."""

POSES = Vocabulary({**{axis: f"{axis}_mm" for axis in "xyz"}, **{name: name for name in QUATERNION}})
"""Quantities of a file of poses."""

POINTS = Vocabulary(
    {
        **{f"{frame}_{axis}": f"{frame}_{axis}_mm" for frame in ("tracker", "plan") for axis in "xyz"},
        **{name: name for name in QUATERNION},
    },
    ("name",),
)
"""Quantities of a file of points: coordinates in both frames, and optionally the rotation of the coil, and names."""

_Terms = dict[str, tuple[ColumnTerm, ...]]

# Number of rows among which a header is looked for.
_MOST_PREAMBLE = 200

_NDI = {"x_mm": "Tx", "y_mm": "Ty", "z_mm": "Tz", "qw": "Q0", "qx": "Qx", "qy": "Qy", "qz": "Qz"}
_ROS = re.compile(r"(?P<prefix>.*?)(?P<part>position|translation|orientation|rotation)[./](?P<axis>[xyzw])")
_ROS_PARTS = {"position": "{}_mm", "translation": "{}_mm", "orientation": "q{}", "rotation": "q{}"}


@dataclass(frozen=True)
class TrackedRows(ShortRepr):
    """Rows of a file: `numbers` by column, shape (rows,), `names`, lines in the file, and how the file was read.

    Rows without any number are not among them; `missing` is their number.
    """

    numbers: dict[str, Array]
    names: tuple[str, ...]
    lines: tuple[int, ...]
    missing: int
    notes: tuple[str, ...]


def read_tracked(
    content: bytes, source: str, vocabulary: Vocabulary, columns: str | Sequence[str] | None = None
) -> TrackedRows:
    """Return the rows of a text file of poses or points.

    Parameters
    ----------
    content : bytes
        Content of the file.
    source : str
        Name of the file in messages.
    vocabulary : Vocabulary
        `POSES` or `POINTS`. The quaternion of `POINTS` may be missing.
    columns : str or sequence of str, optional
        A map such as `x=Tx[m], qw=Q0`; by default the columns are found by their names.

    Returns
    -------
    TrackedRows
        The rows that have a number.

    Raises
    ------
    InputError
        The map is wrong.
    DataError
        A column is missing or ambiguous, its unit is not known, or a cell is not a number.

    """
    rows, separator = cell_rows(content, source)
    plan = ColumnMap.parse(columns, vocabulary=vocabulary) if columns else _map_of_header(rows, vocabulary, source)
    given = [name for name in QUATERNION if name in plan.numbers]
    needed = [name for name in vocabulary.columns.values() if name not in QUATERNION or given or vocabulary is POSES]
    if absent := [name for name in needed if name not in plan.numbers]:
        rule = "a rotation needs all four columns" if set(absent) <= set(QUATERNION) else "all coordinates are needed"
        raise DataError(Mistake(", ".join(absent), "", f"column is missing: {rule}"), source)
    header, first = find_header(rows, plan, source)
    sources, texts, notes = find_sources(header, plan, False, source)
    found = number_rows(rows[first:], sources, texts, source, decimal_comma=separator != ",")
    numbers = {
        column: np.sum([part.factor * found.cells[part.index] for part in parts], axis=0)
        for column, parts in sources.items()
    }
    names = found.texts.get("name", ("",) * len(found.lines))
    named = tuple(name or f"line {line}" for name, line in zip(names, found.lines, strict=True))
    return TrackedRows(numbers, named, found.lines, len(rows) - first - len(found.lines), tuple(notes))


def _map_of_header(rows: Sequence[RowCells], vocabulary: Vocabulary, source: str) -> ColumnMap:
    """Return the map of the columns that the header names.

    For poses, the first row that has all names of needleplan, of NDI ToolBox or of ROS is the header. Without such a
    row, and for points, the names of needleplan are expected; a missing column is then reported by the caller.
    """
    native: _Terms = {column: (ColumnTerm(column),) for column in vocabulary.columns.values()}
    ndi: _Terms = {column: (ColumnTerm(name),) for column, name in _NDI.items()}
    early = [[cell.strip() for cell in cells] for _, cells in rows[:_MOST_PREAMBLE]]
    if vocabulary is POSES:
        for header in early:
            for terms in (native, ndi, _ros(header, source)):
                if terms and all(term.places_in(header) for (term,) in terms.values()):
                    return ColumnMap(terms)
        return ColumnMap(native)
    header = max(early, key=lambda cells: sum(column in cells for column in native))
    columns = {column: terms for column, terms in native.items() if column not in QUATERNION or column in header}
    return ColumnMap(columns, {"name": "name"} if "name" in header else {})


def _ros(header: Sequence[str], source: str) -> _Terms:
    """Return the columns of the one pose in a header of ROS, empty if there is none; DataError if there are several."""
    poses: dict[str, _Terms] = {}
    for cell in header:
        if match := _ROS.fullmatch(cell.removeprefix("%")):
            column = _ROS_PARTS[match["part"]].format(match["axis"])
            poses.setdefault(match["prefix"], {})[column] = (ColumnTerm(cell, "" if column[0] == "q" else "m"),)
    whole = {prefix: terms for prefix, terms in poses.items() if set(terms) == set(POSES.columns.values())}
    if len(whole) > 1:
        rule = f"are several poses: choose one with --columns, as in x={next(iter(whole))}position.x[m]"
        raise DataError(Mistake(", ".join(whole), "", rule), source)
    return next(iter(whole.values()), {})
