"""Pivot calibration: the position of the tip in the frame of a sensor, from poses about a fixed tip.

A sensor at t_i with rotation R_i that pivots about a fixed tip p satisfies t_i + R_i d = p for all i. The equations are
linear in (d, p) and solved by least squares (Yaniv, Proc. SPIE 9415 (2015) 941527, the algebraic one-step method). A
coil with 5 degrees of freedom has only its axis z_i; its equations are t_i + d z_i = p, where d is one number.

Two properties of the estimate:

- A sphere fitted to the positions alone ignores the rotations and is strongly biased: for a cone of 30 degrees, the
  distance is a third too small. It is not offered.
- Noise of the directions makes d too small, by a relative amount of about 2 (noise / spread)^2: 2 % for half a degree
  of noise and the least accepted spread, 5 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration._rigid import rows_of
from needleplan.signals import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["Pivot", "PivotStatus", "calibrate_axis", "calibrate_pivot"]

# Number of poses below which the tip is not determined.
LEAST_POSES = 10

# Root mean square rotation (rad) about the axis with the least rotation, below which the tip is not determined.
LEAST_SPREAD_RAD = math.radians(5)

# Probability that any pose is reported as an outlier if all poses have the same noise.
_OUTLIER = 0.01


class PivotStatus(StrEnum):
    """Whether the poses determine the tip."""

    DETERMINED = "determined"
    """The poses determine the tip."""

    TOO_FEW_POSES = "too few poses"
    """There are fewer than 10 poses."""

    TOO_LITTLE_ROTATION = "too little rotation"
    """The root mean square rotation about some axis is below 5 degrees, so the distance to the tip is undetermined."""


@dataclass(frozen=True)
class Pivot(ShortRepr):
    """Result of a pivot calibration. Without the status DETERMINED, tip, pivot, deviations and RMS are NaN.

    - `tip_mm`: tip in the frame of the sensor, shape (3,), or its distance along the axis of a coil, shape (1,).
    - `pivot_mm`: position of the tip in the frame of the tracker, shape (3,).
    - `tip_sd_mm`: standard deviation of `tip_mm` for independent errors of the poses, same shape.
    - `rms_mm`: root mean square distance between `pivot_mm` and the tips computed from the poses.
    - `poses`: number of poses.
    - `outliers`: indices of poses whose tips are farther from `pivot_mm` than the noise of the other poses explains.
      These poses are not excluded.
    """

    status: PivotStatus
    tip_mm: Array
    pivot_mm: Array
    tip_sd_mm: Array
    rms_mm: float
    poses: int
    spread_rad: float
    """Root mean square rotation (rad) of the poses about the axis with the least rotation."""

    condition: float
    """Condition number of the linear equations: ratio of their largest to their smallest singular value."""

    outliers: tuple[int, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the tip is determined."""
        return self.status is PivotStatus.DETERMINED

    @property
    def interval_mm(self) -> tuple[Array, Array]:
        """Lower and upper limit of the 95 % interval of `tip_mm`, each with the shape of `tip_mm`."""
        from scipy import stats

        degrees = max(3 * self.poses - len(self.tip_mm) - 3, 1)
        reach = float(stats.t.ppf(0.975, degrees)) * self.tip_sd_mm
        return self.tip_mm - reach, self.tip_mm + reach


def calibrate_axis(positions_mm: Array, axes: Array) -> Pivot:
    """Determine the distance of the tip along the axis of a coil with 5 degrees of freedom, from poses about the tip.

    Parameters
    ----------
    positions_mm : numpy.ndarray
        Positions of the coil in the frame of the tracker (mm), shape (n, 3).
    axes : numpy.ndarray
        Directions of the axis of the coil, shape (n, 3); they need not have unit length.

    Returns
    -------
    Pivot
        The distance is negative if the axes point away from the tip.

    Raises
    ------
    DataError
        The arrays have other shapes, a number is not finite, or an axis has length zero.
    """
    positions, directions = rows_of(positions_mm, "positions_mm"), rows_of(axes, "axes")
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if positions.shape != directions.shape or not (lengths > 0).all():
        rule = "must be as many as the positions, and not of length zero"
        raise DataError(Mistake("axes", f"shape {directions.shape}", rule))
    return _solve(positions, (directions / lengths)[:, :, None])


def calibrate_pivot(positions_mm: Array, rotations: Rotation) -> Pivot:
    """Determine the tip in the frame of a sensor with 6 degrees of freedom, from poses about the tip.

    Parameters
    ----------
    positions_mm : numpy.ndarray
        Positions of the sensor in the frame of the tracker (mm), shape (n, 3).
    rotations : scipy.spatial.transform.Rotation
        n rotations from the frame of the sensor to the frame of the tracker.

    Returns
    -------
    Pivot

    Raises
    ------
    DataError
        The arrays have other shapes, or a position is not finite.
    """
    positions = rows_of(positions_mm, "positions_mm")
    matrices = np.atleast_3d(rotations.as_matrix())
    if matrices.shape != (len(positions), 3, 3):
        raise DataError(Mistake("rotations", f"shape {matrices.shape}", "must be as many as the positions"))
    return _solve(positions, matrices)


def _solve(positions: Array, turned: Array) -> Pivot:
    """Solve turned @ tip - pivot = -position for (tip, pivot) by least squares, and return the result.

    `turned` has the shape (n, 3, k), where k is the number of unknowns of the tip.
    """
    from scipy import stats

    count, _, unknowns = turned.shape
    matrix = np.concatenate([turned, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(-1, unknowns + 3)
    singular = np.linalg.svd(matrix, compute_uv=False) if count else np.zeros(1)
    # The smallest eigenvalue of the mean normal matrix is the mean of 1 - cos(angle), about angle^2 / 2.
    spread = float(np.sqrt(2 / max(count, 1)) * singular[-1])
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else math.inf
    if count < LEAST_POSES or spread < LEAST_SPREAD_RAD:
        status = PivotStatus.TOO_FEW_POSES if count < LEAST_POSES else PivotStatus.TOO_LITTLE_ROTATION
        unknown = np.full(unknowns, np.nan)
        return Pivot(status, unknown, np.full(3, np.nan), unknown, math.nan, count, spread, condition)
    solution, *_ = np.linalg.lstsq(matrix, -positions.ravel(), rcond=None)
    left = (matrix @ solution + positions.ravel()).reshape(-1, 3)
    variance = float((left**2).sum()) / (3 * count - unknowns - 3)
    sd = np.sqrt(variance * np.diag(np.linalg.inv(matrix.T @ matrix))[:unknowns])
    distance = np.linalg.norm(left, axis=1)
    # The median is robust against outliers.
    scale = float(np.median(distance)) / math.sqrt(stats.chi2.ppf(0.5, 3))
    limit = scale * math.sqrt(stats.chi2.isf(_OUTLIER / count, 3))
    outliers = tuple(np.flatnonzero(distance > max(limit, 1e-9)).tolist())
    rms = float(np.sqrt((distance**2).mean()))
    tip, pivot = solution[:unknowns], solution[unknowns:]
    return Pivot(PivotStatus.DETERMINED, tip, pivot, sd, rms, count, spread, condition, outliers)
