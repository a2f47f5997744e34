"""Files with the measurements of a registration: poses of a coil, and pairs of points.

- Poses: `x_mm, y_mm, z_mm, qw, qx, qy, qz` in the frame of the tracker, one row per frame. A row without numbers is a
  frame in which the coil was not visible.
- Points: `tracker_x_mm, tracker_y_mm, tracker_z_mm, plan_x_mm, plan_y_mm, plan_z_mm`, and optionally `name`. If the
  points were touched with the tip of the needle, the tracker columns hold the position of the coil, and the further
  columns `qw, qx, qy, qz` its rotation.

`needleplan.recording.pose_files` reads them: with these columns, with columns that a map names, and as exports of NDI
and ROS.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.artifacts import ShortRepr, digest
from needleplan.errors import DataError, Mistake, reading
from needleplan.recording.pose_files import POINTS, POSES, QUATERNION, TrackedRows, read_tracked
from needleplan.signals import Array, FrameName, RecordFrame

__all__ = ["Points", "Poses", "axes_of", "read_points", "read_poses"]

# Largest number of mistakes that are reported for one file.
_MOST_MISTAKES = 10

# Largest magnitude of a coordinate (mm); a larger number is refused.
_FARTHEST_MM = 1e5

# Largest deviation of the length of a quaternion from 1: files are written with few digits.
_UNIT = 0.01


@dataclass(frozen=True)
class Poses(ShortRepr):
    """Poses of a coil: positions, shape (n, 3), and unit quaternions with w first, shape (n, 4).

    `lines` holds the line of each pose in the file, `missing` the number of rows without a pose, `digest` the digest of
    the file, and `notes` how its columns were read.
    """

    positions_mm: Array
    quaternions: Array
    lines: tuple[int, ...]
    missing: int
    digest: str
    notes: tuple[str, ...] = ()

    @property
    def frame(self) -> RecordFrame:
        """Frame of the poses: that of the tracker."""
        return RecordFrame(FrameName.TRACKER, "tracker", self.digest)

    @property
    def axes(self) -> Array:
        """Direction of the z axis of the coil in each pose, shape (n, 3)."""
        return axes_of(self.quaternions)


@dataclass(frozen=True)
class Points(ShortRepr):
    """Pairs of points: coordinates in the frames of the tracker and of the plan, shape (n, 3) each.

    If `quaternions`, shape (n, 4), are given, `tracker_mm` holds positions of the coil while the tip touched the
    points. `names` holds the name of each point, or its line in the file; `digest` is the digest of the file, and
    `notes` say how its columns were read.
    """

    names: tuple[str, ...]
    tracker_mm: Array
    plan_mm: Array
    quaternions: Array | None
    digest: str
    notes: tuple[str, ...] = ()

    @property
    def frames(self) -> tuple[RecordFrame, RecordFrame]:
        """Frames of `tracker_mm` and of `plan_mm`."""
        named = (FrameName.TRACKER, "tracker"), (FrameName.PLAN, "plan")
        tracker, plan = (RecordFrame(name, origin, self.digest) for name, origin in named)
        return tracker, plan


def axes_of(quaternions: Array) -> Array:
    """Return the z axis rotated by quaternions (n, 4) with w first, shape (n, 3)."""
    from scipy.spatial.transform import Rotation

    if not len(quaternions):
        return np.zeros((0, 3))
    return np.asarray(Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).apply([0.0, 0.0, 1.0]))


def read_poses(path: str | os.PathLike[str], columns: str | Sequence[str] | None = None) -> Poses:
    """Read poses of a coil from a text file.

    Parameters
    ----------
    path : path
        The file.
    columns : str or sequence of str, optional
        A map such as `x=Tx[m], qw=Q0`; by default the columns are found by their names.

    Returns
    -------
    Poses
        The poses.

    Raises
    ------
    InputError
        The map is wrong.
    DataError
        The file cannot be read; or at most ten of its mistakes.

    """
    content, source = _content(path), os.fspath(path)
    rows = read_tracked(content, source, POSES, columns)
    numbers = _matrix(rows, tuple(POSES.columns.values()))
    mistakes = [
        Mistake(f"line {line}", "", "must have all seven numbers, or none of them")
        for line, partial in zip(rows.lines, _incomplete(numbers), strict=True)
        if partial
    ]
    _require(mistakes or [*_far_mistakes(rows), *_quaternion_mistakes(numbers[:, 3:], rows.lines)], source)
    return Poses(numbers[:, :3], _unit(numbers[:, 3:]), rows.lines, rows.missing, digest(content), rows.notes)


def read_points(path: str | os.PathLike[str], columns: str | Sequence[str] | None = None) -> Points:
    """Read pairs of points from a text file.

    Parameters
    ----------
    path : path
        The file.
    columns : str or sequence of str, optional
        A map such as `tracker_x=Tx[m], plan_x=R`; by default the columns are found by their names.

    Returns
    -------
    Points
        The pairs.

    Raises
    ------
    InputError
        The map is wrong.
    DataError
        The file cannot be read; or at most ten of its mistakes.

    """
    content, source = _content(path), os.fspath(path)
    rows = read_tracked(content, source, POINTS, columns)
    given = set(QUATERNION) <= set(rows.numbers)
    names = tuple(name for name in POINTS.columns.values() if name in rows.numbers)
    numbers = _matrix(rows, names)
    mistakes = [
        Mistake(f"line {line}", "", "must have a number in every column")
        for line, wrong in zip(rows.lines, _incomplete(numbers), strict=True)
        if wrong
    ]
    mistakes = mistakes or _far_mistakes(rows)
    if given and not mistakes:
        mistakes = _quaternion_mistakes(numbers[:, 6:], rows.lines)
    _require(mistakes, source)
    quaternions = _unit(numbers[:, 6:]) if given else None
    return Points(rows.names, numbers[:, :3], numbers[:, 3:6], quaternions, digest(content), rows.notes)


def _matrix(rows: TrackedRows, names: tuple[str, ...]) -> Array:
    return np.column_stack([np.broadcast_to(rows.numbers[name], len(rows.lines)) for name in names])


def _incomplete(numbers: Array) -> list[bool]:
    """Return for each row whether a number is missing."""
    return [bool(np.isnan(row).any()) for row in numbers]


def _require(mistakes: list[Mistake], source: str) -> None:
    if mistakes:
        raise DataError(mistakes[:_MOST_MISTAKES], source)


def _far_mistakes(rows: TrackedRows) -> list[Mistake]:
    return [
        Mistake(f"{name} (line {rows.lines[row]})", f"{values[row]:g}", f"must be at most {_FARTHEST_MM:g} mm")
        for name, values in rows.numbers.items()
        for row in np.flatnonzero(np.abs(values) > _FARTHEST_MM).tolist()
    ]


def _quaternion_mistakes(quaternions: Array, lines: tuple[int, ...]) -> list[Mistake]:
    with np.errstate(over="ignore"):  # an infinite length is refused as well
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
    with reading(path, DataError):
        return Path(path).read_bytes()
