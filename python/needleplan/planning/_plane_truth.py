"""Errors of the entry and of the registration in the plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from needleplan.planning._poses import Pose, wrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from needleplan.planning._promise import Truths
    from needleplan.scenario import Workspace

__all__ = ["plane_truths", "scattered_poses"]


def scattered_poses(
    size: Workspace, tip: Pose, shift_mm: NDArray[np.float64], turn_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return poses of the entry that are shifted across the heading and turned, shape (n, 4).

    A point slides along the edge at which the needle enters: the part of a shift across the edge does not count. Poses
    outside of the workspace are NaN.
    """
    x = tip.x_mm - shift_mm * math.sin(tip.heading_rad)
    y = tip.y_mm + shift_mm * math.cos(tip.heading_rad)
    x = np.where((x < 0) & (tip.x_mm <= 0) | (x > size.width_mm) & (tip.x_mm >= size.width_mm), tip.x_mm, x)
    y = np.where((y < 0) & (tip.y_mm <= 0) | (y > size.height_mm) & (tip.y_mm >= size.height_mm), tip.y_mm, y)
    heading = np.array([wrapped(tip.heading_rad + turn) for turn in turn_rad.tolist()])
    poses = np.stack([x, y, heading, np.full(x.size, float(tip.bevel))], axis=1)
    poses[(x < 0) | (x > size.width_mm) | (y < 0) | (y > size.height_mm)] = math.nan
    return poses


def plane_truths(truths: Truths, target_mm: Sequence[float]) -> NDArray[np.float64]:
    """Project rigid motions onto the plane, for the compiled executions.

    Parameters
    ----------
    truths : Truths
        Rigid motions in three dimensions, relative curvatures, and distance of the coil.
    target_mm : sequence of float
        Centre of the target in the plane.

    Returns
    -------
    numpy.ndarray
        Rows of the turn about the origin (rad), the shifts along x and y, the distance from the plane at the target
        (mm), the ratio, and the distance of the coil (mm), shape (n, 6). The target is moved exactly.
    """
    (motions, ratios, coil_mm), (x, y) = truths, target_mm
    at = motions @ np.array([x, y, 0.0, 1.0])
    turn = np.arctan2(motions[:, 1, 0] - motions[:, 0, 1], motions[:, 0, 0] + motions[:, 1, 1])
    sine, cosine = np.sin(turn), np.cos(turn)
    shift = [at[:, 0] - (cosine * x - sine * y), at[:, 1] - (sine * x + cosine * y), at[:, 2]]
    return np.stack([turn, *shift, ratios, np.full(len(ratios), coil_mm)], 1)
