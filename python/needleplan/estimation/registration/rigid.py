"""How two frames lie to each other, from pairs of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration.rows import FLAT, rows_of
from needleplan.signals import Array

__all__ = ["RigidMotion", "register"]


@dataclass(frozen=True)
class RigidMotion:
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


def register(first_mm: Array, second_mm: Array) -> RigidMotion:
    """Return the rigid motion that takes points (n, 3) to their partners (n, 3), by least squares (Kabsch).

    Never a reflection. Raises DataError for fewer than 3 pairs, and for points on one line.
    """
    first, second = rows_of(first_mm, "first_mm"), rows_of(second_mm, "second_mm")
    if first.shape != second.shape or len(first) < 3:
        raise DataError(
            Mistake("second_mm", f"shape {second.shape}", f"must be that of first_mm, {first.shape}; 3 or more")
        )
    middle_first, middle_second = first.mean(axis=0), second.mean(axis=0)
    centred = first - middle_first
    for name, points in (("first_mm", centred), ("second_mm", second - middle_second)):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= FLAT * spread[0] or spread[0] == 0:
            raise DataError(
                Mistake(name, "", "lies on one line, or in one place: the rotation about it is not determined")
            )
    rotation, _ = Rotation.align_vectors(second - middle_second, centred)
    translation = middle_second - rotation.apply(middle_first)
    left = rotation.apply(first) + translation - second
    _, singular, axes = np.linalg.svd(centred, full_matrices=True)
    squares = singular**2 / len(first)
    fre = float(np.sqrt((left**2).sum(axis=1).mean()))
    return RigidMotion(rotation, translation, fre, middle_first, squares.sum() - squares, axes, len(first))
