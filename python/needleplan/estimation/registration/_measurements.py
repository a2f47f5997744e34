"""CSV files with the measurements of a registration: poses of a pivoting needle, and pairs of points.

- Poses: `x_mm, y_mm, z_mm, qw, qx, qy, qz` in the frame of the tracker, one row per frame. A row without numbers is a
  frame in which the coil was not visible.
- Points: `tracker_x_mm, tracker_y_mm, tracker_z_mm, plan_x_mm, plan_y_mm, plan_z_mm`, and optionally `name`. If the
  points were touched with the tip of the needle, the tracker columns hold the position of the coil, and the further
  columns `qw, qx, qy, qz` its rotation.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.artifacts import digest
from needleplan.config import suggestion
from needleplan.errors import DataError, Mistake
from needleplan.recording.csv_file import number_in, rows_of_cells
from needleplan.signals import Array

__all__ = ["Points", "Poses", "read_points", "read_poses"]

# Largest number of mistakes that are reported for one file.
_MOST_MISTAKES = 10

# Largest magnitude of a cell; a larger number is refused.
_FARTHEST_MM = 1e5

_QUATERNION = ("qw", "qx", "qy", "qz")
_POSE = ("x_mm", "y_mm", "z_mm", *_QUATERNION)
_TRACKER = ("tracker_x_mm", "tracker_y_mm", "tracker_z_mm")
_PLAN = ("plan_x_mm", "plan_y_mm", "plan_z_mm")

# Largest deviation of the length of a quaternion from 1: files are written with few digits.
_UNIT = 0.01


@dataclass(frozen=True)
class Poses:
    """Poses of a coil: positions, shape (n, 3), and unit quaternions with w first, shape (n, 4).

    `lines` holds the line of each pose in the file, `missing` the number of rows without a pose, and `digest` the
    digest of the file.
    """

    positions_mm: Array
    quaternions: Array
    lines: tuple[int, ...]
    missing: int
    digest: str


@dataclass(frozen=True)
class Points:
    """Pairs of points: coordinates in the frames of the tracker and of the plan, shape (n, 3) each.

    If `quaternions`, shape (n, 4), are given, `tracker_mm` holds positions of the coil while the tip touched the
    points. `names` holds the name of each point, or its line in the file; `digest` is the digest of the file.
    """

    names: tuple[str, ...]
    tracker_mm: Array
    plan_mm: Array
    quaternions: Array | None
    digest: str


def read_poses(path: str | os.PathLike[str]) -> Poses:
    """Read the poses of a pivoting needle from a CSV file.

    Raises DataError if the file cannot be read, or with at most ten of its mistakes.
    """
    content, source = _content(path), os.fspath(path)
    table = _Table(content, source, _POSE, ())
    numbers = np.array([[row[name] for name in _POSE] for row in table.rows])
    unseen = np.isnan(numbers).all(axis=1)
    mistakes = [
        Mistake(f"line {line}", "", "must have all seven numbers, or none of them")
        for line, partial in zip(table.lines, np.isnan(numbers).any(axis=1) & ~unseen, strict=True)
        if partial
    ]
    kept = tuple(line for line, gone in zip(table.lines, unseen, strict=True) if not gone)
    seen = numbers[~unseen]
    mistakes += _quaternion_mistakes(seen[:, 3:], kept)
    if mistakes:
        raise DataError(mistakes[:_MOST_MISTAKES], source)
    return Poses(seen[:, :3], _unit(seen[:, 3:]), kept, int(unseen.sum()), digest(content))


def read_points(path: str | os.PathLike[str]) -> Points:
    """Read pairs of points from a CSV file. Raises DataError like `read_poses`."""
    content, source = _content(path), os.fspath(path)
    table = _Table(content, source, (*_TRACKER, *_PLAN), _QUATERNION)
    given = [name for name in _QUATERNION if name in table.columns]
    if given and len(given) < len(_QUATERNION):
        absent = ", ".join(name for name in _QUATERNION if name not in given)
        rule = f"are there without {absent}: a rotation needs all four columns"
        raise DataError(Mistake(", ".join(given), "", rule), source)
    names = (*_TRACKER, *_PLAN, *given)
    numbers = np.array([[row[name] for name in names] for row in table.rows])
    mistakes = [
        Mistake(f"line {line}", "", "must have a number in every column")
        for line, wrong in zip(table.lines, np.isnan(numbers).any(axis=1), strict=True)
        if wrong
    ]
    if given and not mistakes:
        mistakes = _quaternion_mistakes(numbers[:, 6:], table.lines)
    if mistakes:
        raise DataError(mistakes[:_MOST_MISTAKES], source)
    quaternions = _unit(numbers[:, 6:]) if given else None
    return Points(table.names, numbers[:, :3], numbers[:, 3:6], quaternions, digest(content))


class _Table:
    """The rows of a CSV file: numbers in the columns `needed` and `optional`; an empty cell is NaN.

    Other columns are ignored, except `name`. Raises DataError for mistakes in the header or the cells.
    """

    def __init__(self, content: bytes, source: str, needed: tuple[str, ...], optional: tuple[str, ...]) -> None:
        _, rows = rows_of_cells(content, source)
        if not rows:
            raise DataError(f"is empty: it must begin with a header, {','.join(needed)}", source)
        self.columns = rows[0][1]
        missing = [name for name in needed if name not in self.columns]
        unknown = [name for name in self.columns if name not in (*needed, *optional)]
        mistakes = [Mistake(name, "", f"column is missing{suggestion(name, unknown)}") for name in missing]
        mistakes += [
            Mistake(name, "", "column is there twice") for name in {*needed, *optional} if self.columns.count(name) > 1
        ]
        if mistakes:
            raise DataError(mistakes, source)
        self.lines = tuple(number for number, _ in rows[1:])
        self.rows: list[dict[str, float]] = []
        found: list[str] = []
        for line, cells in rows[1:]:
            if len(cells) != len(self.columns):
                mistakes.append(Mistake(f"line {line}", "", f"must have {len(self.columns)} cells, not {len(cells)}"))
                continue
            row = dict(zip(self.columns, cells, strict=True))
            found.append(row.get("name") or f"line {line}")
            self.rows.append(
                {
                    name: _read(row[name], f"{name} (line {line})", mistakes)
                    for name in row
                    if name in (*needed, *optional)
                }
            )
        if not rows[1:]:
            mistakes.append(Mistake("", "", "has a header but no rows"))
        if mistakes:
            raise DataError(mistakes[:_MOST_MISTAKES], source)
        self.names = tuple(found)


def _read(cell: str, key: str, mistakes: list[Mistake]) -> float:
    value = number_in(cell)
    if value is None or abs(value) > _FARTHEST_MM:
        mistakes.append(Mistake(key, cell, f"must be a number of at most {_FARTHEST_MM:g}, or empty"))
        return math.nan
    return value


def _quaternion_mistakes(quaternions: Array, lines: tuple[int, ...]) -> list[Mistake]:
    lengths = np.linalg.norm(quaternions, axis=1)
    rule = "must be a quaternion of length 1, w first"
    return [
        Mistake(f"qw to qz (line {line})", f"length {length:.3g}", rule)
        for line, length in zip(lines, lengths.tolist(), strict=True)
        if abs(length - 1) > _UNIT
    ]


def _unit(quaternions: Array) -> Array:
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def _content(path: str | os.PathLike[str]) -> bytes:
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot be read: {reason}", os.fspath(path)) from error
