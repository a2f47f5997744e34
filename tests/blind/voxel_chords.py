"""Chords of needle paths, and the voxels that they cross.

A path is given by the tip's poses after every insertion step. Between two poses it is the one arc that begins at the
first point with the step's first tangent and ends at the second point. Each arc is cut into chords that leave it by
less than SAGITTA_MM, and each chord visits every voxel that it crosses (Amanatides and Woo, A fast voxel traversal
algorithm, 1987).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.needle_executions import arc
from tests.blind.voxel_distance import Array, Indices

SAGITTA_MM = 5e-4  # largest distance between an arc and its chord
CHORD_MM = 1.0  # longest chord
OUTSIDE = 1  # code of all that is not in the volume


@dataclass(frozen=True)
class Path:
    """Tip positions (n, 3) in RAS mm and unit tangents (n, 3) after every step, n >= 1.

    Without tangents, straight lines join the positions. start_tangents (n - 1, 3) are the tangents after the tip noise,
    with which the steps begin; None: those of the poses.
    """

    points: Array
    tangents: Array | None = None
    start_tangents: Array | None = None


@dataclass(frozen=True)
class Chords:
    """Chords of all paths, in the order of the paths: RAS ends (m, 3), path, and length before and along each."""

    start: Array
    end: Array
    path: Indices
    before_mm: Array
    length_mm: Array


def _steps(path: Path) -> tuple[Array, Array, Array, Array]:
    """Start, start tangent, end, end tangent of each step; a path of one pose has one step of length zero."""
    points = np.atleast_2d(path.points).astype(float)
    starts, ends = (points[:-1], points[1:]) if len(points) > 1 else (points, points)
    if path.tangents is None:
        return starts, _units(ends - starts), ends, _units(ends - starts)
    after = np.atleast_2d(path.tangents).astype(float)
    before = after[: len(starts)] if path.start_tangents is None else np.asarray(path.start_tangents, float)
    return starts, _units(before), ends, after[-len(ends) :]


def _units(vectors: Array) -> Array:
    """Vectors of length one; a vector of zeros stays."""
    norms = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, norms, out=np.zeros_like(vectors), where=norms > 0.0)


def chords(paths: Sequence[Path]) -> tuple[Chords, Array, Array]:
    """Cuts all arcs into chords; also returns the largest curvature (1/mm) and the largest kink (rad) of each path."""
    steps = [_steps(path) for path in paths]
    step_path = np.repeat(np.arange(len(paths)), [len(step[0]) for step in steps])
    start, tangent, end, end_tangent = (np.concatenate(parts) for parts in zip(*steps, strict=True))
    secant = end - start
    along = (secant * tangent).sum(1)
    across = secant - along[:, None] * tangent
    aside, distance = np.linalg.norm(across, axis=1), np.linalg.norm(secant, axis=1)
    bending = _units(across)
    half_angle = np.arctan2(aside, along)
    length = distance / np.sinc(half_angle / np.pi)
    curvature = np.divide(2.0 * aside, distance**2, out=np.zeros(len(aside)), where=distance > 0.0)
    with np.errstate(divide="ignore"):
        radius = 1.0 / curvature
    counts = np.ceil(length / np.minimum(np.sqrt(8.0 * SAGITTA_MM * radius), CHORD_MM)).astype(int)
    counts = np.maximum(counts, 1)
    step = np.repeat(np.arange(len(start)), counts)
    number = np.arange(len(step)) - np.repeat(np.cumsum(counts) - counts, counts)
    part = length / counts
    first, _ = arc(start[step], tangent[step], bending[step], radius[step], number * part[step])
    last, reached = arc(start[step], tangent[step], bending[step], radius[step], (number + 1) * part[step])
    final = number == counts[step] - 1
    last[final] = end
    turned = np.linalg.norm(np.cross(reached[final], end_tangent), axis=1)
    kink = np.arctan2(turned, (reached[final] * end_tangent).sum(1))
    total = np.cumsum(length) - length
    total -= total[np.searchsorted(step_path, step_path)]
    largest, sharpest = np.zeros(len(paths)), np.zeros(len(paths))
    np.maximum.at(largest, step_path, curvature)
    np.maximum.at(sharpest, step_path, kink)
    return Chords(first, last, step_path[step], total[step] + number * part[step], part[step]), largest, sharpest


def visits(start: Array, end: Array, codes: NDArray[np.uint8]) -> tuple[Indices, Array, Array, Indices]:
    """Every voxel with a code that segments cross.

    Parameters
    ----------
    start, end : ndarray
        Ends in units of voxels, (m, 3); the voxel i is the interval [i, i + 1).
    codes : ndarray
        Codes of the voxels; a voxel outside has the code OUTSIDE.

    Returns
    -------
    segment, entered, left, voxel : ndarray
        The segment, the shares of it at which it enters and leaves the voxel, (v,), and the voxel, (v, 3); in no order.
    """
    course = end - start
    forward = course > 0.0
    step = np.sign(course).astype(int)
    cell = np.floor(start).astype(int)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = np.where(step != 0, (cell + forward - start) / course, np.inf)
        between = np.where(step != 0, 1.0 / np.abs(course), np.inf)
    segment, entered = np.arange(len(start)), np.zeros(len(start))
    passed = []
    while segment.size:
        left = crossing.min(1)
        known = ((cell >= 0) & (cell < codes.shape)).all(1)
        code = np.where(known, codes[tuple(np.where(known[:, None], cell, 0).T)], OUTSIDE)
        met = np.flatnonzero(code)
        passed.append((segment[met], entered[met], np.minimum(left[met], 1.0), cell[met]))
        moved = crossing == left[:, None]
        # The lower face belongs to a voxel, the upper one to its neighbour: upward steps come first.
        upward = moved & forward
        moved = np.where(upward.any(1, keepdims=True), upward, moved)
        cell = cell + moved * step
        crossing = np.where(moved, crossing + between, crossing)
        on = (left < 1.0) | ((left == 1.0) & upward.any(1))
        segment, entered, cell, crossing = segment[on], left[on], cell[on], crossing[on]
        step, between, forward = step[on], between[on], forward[on]
    return tuple(np.concatenate(parts) for parts in zip(*passed, strict=True))  # type: ignore[return-value]
