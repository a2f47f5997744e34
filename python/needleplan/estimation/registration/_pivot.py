"""Where the tip is on a tracked needle, from poses about a fixed tip.

Pivoting about a fixed tip p, a sensor at t_i with rotation R_i sees t_i + R_i d = p for all i: linear in (d, p), and
solved by least squares (Yaniv, Proc. SPIE 9415 (2015) 941527, the algebraic one-step method). A coil with 5 degrees of
freedom gives only its axis z_i; then t_i + d z_i = p, with one number d. Fitting a sphere to the positions alone throws
the rotations away and is badly biased (for a cone of 30 degrees the distance comes out a third too small): it is not
offered.

Noise of the directions draws d to smaller values, by a share of about 2 (noise / spread)^2. With the least spread that
is accepted, 5 degrees, and half a degree of noise that is 2 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration._rigid import rows_of
from needleplan.signals import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["Pivot", "PivotStatus", "calibrate_axis", "calibrate_pivot"]

LEAST_POSES = 10
LEAST_SPREAD_RAD = math.radians(5)

_OUTLIER = 0.01
"""Probability to name a pose where all are alike."""


class PivotStatus(StrEnum):
    """Whether the poses say where the tip is."""

    DETERMINED = "determined"
    TOO_FEW_POSES = "too few poses"
    TOO_LITTLE_ROTATION = "too little rotation"
    """The needle did not turn in a cone: where it is along its axis is not in these poses."""


@dataclass(frozen=True)
class Pivot:
    """Tip in the frame of the sensor, (along,) for an axis or (x, y, z); where it stood; deviations of the tip.

    `tip_sd_mm` takes the errors of the poses as independent. `rms_mm` is the root mean square distance of the tips that
    the poses give from where it stood; `outliers` are the numbers, from 0, of poses that are further off than the
    others explain; they are not left out. All numbers of a pivot that is not DETERMINED are NaN, but for the spread
    and the condition.
    """

    status: PivotStatus
    tip_mm: Array
    pivot_mm: Array
    tip_sd_mm: Array
    rms_mm: float
    poses: int
    spread_rad: float
    """Root mean square angle by which the direction turned that turned least."""

    condition: float
    """Of the linear equations: their largest singular value over the smallest."""

    outliers: tuple[int, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the tip is determined."""
        return self.status is PivotStatus.DETERMINED

    @property
    def interval_mm(self) -> tuple[Array, Array]:
        """Lower and upper limits of the tip, 95 %."""
        from scipy import stats

        degrees = max(3 * self.poses - len(self.tip_mm) - 3, 1)
        reach = float(stats.t.ppf(0.975, degrees)) * self.tip_sd_mm
        return self.tip_mm - reach, self.tip_mm + reach


def calibrate_axis(positions_mm: Array, axes: Array) -> Pivot:
    """Return how far along its axis a 5-degree coil has the tip, from poses about a fixed tip.

    `positions_mm` (n, 3); `axes` (n, 3), directions of the coil's axis, normalised here; the distance is negative where
    they point away from the tip. Raises DataError for arrays of other shapes, and axes of length zero.
    """
    positions, directions = rows_of(positions_mm, "positions_mm"), rows_of(axes, "axes")
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if positions.shape != directions.shape or not (lengths > 0).all():
        rule = "must be as many as the positions, and not of length zero"
        raise DataError(Mistake("axes", f"shape {directions.shape}", rule))
    return _solve(positions, (directions / lengths)[:, :, None])


def calibrate_pivot(positions_mm: Array, rotations: Rotation) -> Pivot:
    """Return the tip in the frame of a 6-degree sensor, from poses about a fixed tip.

    `positions_mm` (n, 3); `rotations`, n of them, from the sensor's frame to the tracker's. Raises DataError for arrays
    of other shapes.
    """
    positions = rows_of(positions_mm, "positions_mm")
    matrices = np.atleast_3d(rotations.as_matrix())
    if matrices.shape != (len(positions), 3, 3):
        raise DataError(Mistake("rotations", f"shape {matrices.shape}", "must be as many as the positions"))
    return _solve(positions, matrices)


def _solve(positions: Array, turned: Array) -> Pivot:
    """Solve turned @ tip - pivot = -position; `turned` (n, 3, k)."""
    from scipy import stats

    count, _, unknowns = turned.shape
    matrix = np.concatenate([turned, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(-1, unknowns + 3)
    singular = np.linalg.svd(matrix, compute_uv=False) if count else np.zeros(1)
    # The smallest eigenvalue of the mean square is 1 - cos of the angle, on average.
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
    # From the median, which outliers leave alone.
    scale = float(np.median(distance)) / math.sqrt(stats.chi2.ppf(0.5, 3))
    limit = scale * math.sqrt(stats.chi2.isf(_OUTLIER / count, 3))
    outliers = tuple(np.flatnonzero(distance > max(limit, 1e-9)).tolist())
    rms = float(np.sqrt((distance**2).mean()))
    tip, pivot = solution[:unknowns], solution[unknowns:]
    return Pivot(PivotStatus.DETERMINED, tip, pivot, sd, rms, count, spread, condition, outliers)
