"""Where the tip is on a tracked needle, from poses about a fixed tip.

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
from needleplan.estimation.registration.rows import FLAT, rows_of
from needleplan.signals import Array

__all__ = ["Pivot", "calibrate_axis", "calibrate_pivot"]


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
    positions, directions = rows_of(positions_mm, "positions_mm"), rows_of(axes, "axes")
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
    positions = rows_of(positions_mm, "positions_mm")
    matrices = np.atleast_3d(rotations.as_matrix())
    if matrices.shape != (len(positions), 3, 3):
        raise DataError(Mistake("rotations", f"shape {matrices.shape}", "must be as many as the positions"))
    return _solve(positions, matrices)


def _solve(positions: Array, turned: Array) -> Pivot:
    """Solve turned @ tip - pivot = -position; `turned` (n, 3, k)."""
    count, _, unknowns = turned.shape
    matrix = np.concatenate([turned, np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2).reshape(-1, unknowns + 3)
    singular = np.linalg.svd(matrix, compute_uv=False)
    if count < 4 or singular[-1] < FLAT * singular[0]:
        rule = "must turn in a cone: these poses do not determine the tip"
        raise DataError(Mistake("poses", f"{count}, condition {singular[0] / max(singular[-1], 1e-300):.2g}", rule))
    solution, *_ = np.linalg.lstsq(matrix, -positions.ravel(), rcond=None)
    left = (matrix @ solution + positions.ravel()).reshape(-1, 3)
    variance = float((left**2).sum()) / (3 * count - unknowns - 3)
    sd = np.sqrt(variance * np.diag(np.linalg.inv(matrix.T @ matrix))[:unknowns])
    rms = float(np.sqrt((left**2).sum(axis=1).mean()))
    return Pivot(solution[:unknowns], solution[unknowns:], sd, rms, count)
