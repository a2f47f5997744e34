"""Arguments of the calls of a 3D table: poses, numbers of executions, seeds and threads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.errors import Mistake, PoseError
from needleplan.planning._poses import number_rows, whole_number
from needleplan.planning._space_pose import SpacePose

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["MOST_RUNS", "pose_numbers", "pose_rows", "run_number", "seed_number", "thread_number"]

MOST_RUNS = 50_000_000
"""Largest number of executions of one call; limited by memory."""

# Largest difference of the length of a tangent from 1: that of three decimals.
_LENGTH = 1e-3
# Largest number of threads of a call.
_MOST_THREADS = 4096
_RULE = "must be six finite numbers: position (mm) and tangent"


def pose_numbers(pose: Any) -> NDArray[np.float64]:
    """Return a pose as an array, shape (6,). Raises PoseError unless it is six finite numbers with a unit tangent."""
    try:
        row = np.array(pose, np.float64)
    except (TypeError, ValueError):
        raise PoseError(Mistake("pose", str(pose), _RULE)) from None
    if row.shape != (6,) or not np.isfinite(row).all():
        raise PoseError(Mistake("pose", str(pose), _RULE))
    length = float(np.linalg.norm(row[3:]))
    if abs(length - 1) > _LENGTH:
        rule = f"must be a tangent of length 1, not {length:.4g}"
        raise PoseError(Mistake("pose", str(tuple(row.tolist())), rule))
    return row


def pose_rows(poses: ArrayLike) -> NDArray[np.float64]:
    """Return poses as an array, shape (n, 6). Raises PoseError unless it has this shape and unit tangents."""
    rows = number_rows(poses, SpacePose._fields)
    if rows.ndim != 2 or rows.shape[1] != 6:
        rule = "must have the shape (n, 6): rows of position (mm) and tangent"
        raise PoseError(Mistake("poses", f"shape {rows.shape}", rule))
    wrong = ~np.isfinite(rows).all(-1) | (abs(np.linalg.norm(rows[:, 3:], axis=-1) - 1) > _LENGTH)
    if wrong.any():
        row = int(wrong.argmax())
        rule = "must be finite, with a tangent of length 1"
        raise PoseError(Mistake(f"poses[{row}]", str(tuple(rows[row].tolist())), rule))
    return rows


def run_number(runs: Any, most: int) -> int:
    """Return a number of executions. Raises PoseError unless it is a whole number from 1 to `most`."""
    return whole_number("runs", runs, 1, most, f"from 1 to {most:,}")


def seed_number(seed: Any) -> int:
    """Return a seed. Raises PoseError unless it is a whole number from 0 to 2^64 - 1."""
    return whole_number("seed", seed, 0, 2**64 - 1, "from 0 to 2^64 - 1")


def thread_number(threads: Any) -> int | None:
    """Return a number of threads, or None. Raises PoseError unless it is None or a whole number from 1."""
    return None if threads is None else whole_number("threads", threads, 1, _MOST_THREADS, f"from 1 to {_MOST_THREADS}")
