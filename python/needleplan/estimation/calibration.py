"""Calibration of trackers: where the tip is on a tracked needle, and how two frames lie to each other.

Pivoting about a fixed tip p, a sensor at t_i with rotation R_i sees t_i + R_i d = p for all i: linear in (d, p), and
solved by least squares. A coil with 5 degrees of freedom gives only its axis z_i; then t_i + d z_i = p, with one number
d. Fitting a sphere to the positions alone throws the rotations away and is badly biased (for a cone of 30 degrees the
distance comes out a third too small): it is not offered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array

__all__ = ["Pivot", "Registration", "calibrate_axis", "calibrate_pivot", "register"]

_FLAT = 1e-3
"""Ratio of singular values below which rotations or points do not determine what is asked."""


@dataclass(frozen=True)
class Pivot:
    """Tip in the frame of the sensor, (along,) for an axis or (x, y, z); where it stood; deviations of the tip.

    `rms_mm` is the root mean square distance of the tips that the poses give from where it stood.
    """

    tip_mm: Array
    pivot_mm: Array
    tip_sd_mm: Array
    rms_mm: float
    poses: int


def calibrate_axis(positions_mm: Array, axes: Array) -> Pivot:
    """Return how far along its axis a 5-degree coil has the tip, from poses about a fixed tip.

    `positions_mm` (n, 3); `axes` (n, 3), directions of the coil's axis towards the tip, normalised here. Raises
    DataError where the axes are all parallel: turn the needle in a cone.
    """
    positions, directions = _rows(positions_mm, "positions_mm"), _rows(axes, "axes")
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if positions.shape != directions.shape or not (lengths > 0).all():
        rule = "must be as many as the positions, and not of length zero"
        raise DataError(Mistake("axes", f"shape {directions.shape}", rule))
    return _solve(positions, (directions / lengths)[:, :, None])


def calibrate_pivot(positions_mm: Array, rotations: Rotation) -> Pivot:
    """Return the tip in the frame of a 6-degree sensor, from poses about a fixed tip.

    `positions_mm` (n, 3); `rotations`, n of them, from the sensor's frame to the tracker's. Raises DataError where they
    turn about one axis only or not at all.
    """
    positions = _rows(positions_mm, "positions_mm")
    matrices = np.atleast_3d(rotations.as_matrix())
    if matrices.shape != (len(positions), 3, 3):
        raise DataError(Mistake("rotations", f"shape {matrices.shape}", "must be as many as the positions"))
    return _solve(positions, matrices)


def _solve(positions: Array, turned: Array) -> Pivot:
    """Solve turned @ tip - pivot = -position; `turned` (n, 3, k)."""
    count, _, unknowns = turned.shape
    matrix = np.concatenate([turned, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(-1, unknowns + 3)
    singular = np.linalg.svd(matrix, compute_uv=False)
    if count < 4 or singular[-1] < _FLAT * singular[0]:
        rule = "must turn in a cone: these poses do not determine the tip"
        raise DataError(Mistake("poses", f"{count}, condition {singular[0] / max(singular[-1], 1e-300):.2g}", rule))
    solution, *_ = np.linalg.lstsq(matrix, -positions.ravel(), rcond=None)
    left = (matrix @ solution + positions.ravel()).reshape(-1, 3)
    variance = float((left**2).sum()) / (3 * count - unknowns - 3)
    sd = np.sqrt(variance * np.diag(np.linalg.inv(matrix.T @ matrix))[:unknowns])
    rms = float(np.sqrt((left**2).sum(axis=1).mean()))
    return Pivot(solution[:unknowns], solution[unknowns:], sd, rms, count)


@dataclass(frozen=True)
class Registration:
    """A rigid motion from one frame to another, b = R a + t, from pairs of points.

    `fre_mm` is the root mean square distance at the points themselves: it says little about other places.
    """

    rotation: Rotation
    translation_mm: Array
    fre_mm: float
    centre_mm: Array
    moments_mm2: Array
    """Mean square distances of the points from their three principal axes, (3,), ..."""

    axes: Array
    """... which are the rows of this, (3, 3)."""

    points: int

    def apply(self, points_mm: Array) -> Array:
        """Return points (n, 3) or (3,) of the first frame in the second."""
        return np.asarray(self.rotation.apply(points_mm) + self.translation_mm)

    @property
    def fle_mm(self) -> float:
        """Root mean square error of a point that explains the FRE: FRE^2 = (1 - 2/n) FLE^2 on average."""
        return float(self.fre_mm / np.sqrt(1 - 2 / self.points))

    def tre_mm(self, target_mm: Array, fle_mm: float | None = None) -> float:
        """Return the expected root mean square error at a target of the first frame, to first order.

        Fitzpatrick et al., IEEE Trans. Medical Imaging 17 (1998) 694: TRE^2 = FLE^2 / n (1 + 1/3 sum of d_k^2 / f_k^2),
        with the distance d_k of the target and f_k of the points from principal axis k.
        """
        size = self.fle_mm if fle_mm is None else fle_mm
        along = self.axes @ (np.asarray(target_mm, float) - self.centre_mm)
        squares = along @ along - along**2
        return float(size * np.sqrt((1 + np.sum(squares / self.moments_mm2) / 3) / self.points))


def register(first_mm: Array, second_mm: Array) -> Registration:
    """Return the rigid motion that takes points (n, 3) to their partners (n, 3), by least squares (Kabsch).

    Never a reflection. Raises DataError for fewer than 3 pairs, and for points on one line.
    """
    first, second = _rows(first_mm, "first_mm"), _rows(second_mm, "second_mm")
    if first.shape != second.shape or len(first) < 3:
        raise DataError(
            Mistake("second_mm", f"shape {second.shape}", f"must be that of first_mm, {first.shape}; 3 or more")
        )
    middle_first, middle_second = first.mean(axis=0), second.mean(axis=0)
    centred = first - middle_first
    for name, points in (("first_mm", centred), ("second_mm", second - middle_second)):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= _FLAT * spread[0] or spread[0] == 0:
            raise DataError(
                Mistake(name, "", "lies on one line, or in one place: the rotation about it is not determined")
            )
    rotation, _ = Rotation.align_vectors(second - middle_second, centred)
    translation = middle_second - rotation.apply(middle_first)
    left = rotation.apply(first) + translation - second
    _, singular, axes = np.linalg.svd(centred, full_matrices=True)
    squares = singular**2 / len(first)
    fre = float(np.sqrt((left**2).sum(axis=1).mean()))
    return Registration(rotation, translation, fre, middle_first, squares.sum() - squares, axes, len(first))


def _rows(values: Array, name: str) -> Array:
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise DataError(Mistake(name, f"shape {rows.shape}", "must have the shape (n, 3) and finite numbers"))
    return rows
