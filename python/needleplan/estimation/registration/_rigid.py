"""How two frames lie to each other, from pairs of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["Outlier", "RigidMotion", "register", "rows_of", "worst_pair"]

FLAT = 1e-3
"""Ratio of singular values below which points lie on one line."""

_UNLIKELY = 0.01


@dataclass(frozen=True)
class RigidMotion:
    """A rigid motion from one frame to another, b = R a + t, from pairs of points.

    `fre_mm` is the root mean square distance at the points themselves: it says little about other places.
    """

    rotation: Rotation
    translation_mm: Array
    fre_mm: float
    distances_mm: Array
    """Of each point from its partner, (n,)."""

    mirrored_fre_mm: float
    """The same as `fre_mm` for the best reflection: smaller by far where one axis of one frame has the wrong sign."""

    centre_mm: Array
    moments_mm2: Array
    """Mean square distances of the points from their three principal axes, (3,), ..."""

    axes: Array
    """... which are the rows of this, (3, 3)."""

    @property
    def points(self) -> int:
        """How many pairs there were."""
        return len(self.distances_mm)

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


@dataclass(frozen=True)
class Outlier:
    """A pair that the others contradict: its number from 0, how far off it is from them, and how likely that is."""

    number: int
    distance_mm: float
    p_value: float


def register(first_mm: Array, second_mm: Array) -> RigidMotion:
    """Return the rigid motion that takes points (n, 3) to their partners (n, 3), by least squares (Kabsch).

    Never a reflection. Raises DataError for fewer than 3 pairs, and for points on one line.
    """
    from scipy.spatial.transform import Rotation

    first, second = rows_of(first_mm, "first_mm"), rows_of(second_mm, "second_mm")
    if first.shape != second.shape or len(first) < 3:
        raise DataError(
            Mistake("second_mm", f"shape {second.shape}", f"must be that of first_mm, {first.shape}; 3 or more")
        )
    middle_first, middle_second = first.mean(axis=0), second.mean(axis=0)
    centred, partners = first - middle_first, second - middle_second
    for name, points in (("first_mm", centred), ("second_mm", partners)):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= FLAT * spread[0] or spread[0] == 0:
            raise DataError(
                Mistake(name, "", "lies on one line, or in one place: the rotation about it is not determined")
            )
    rotation, _ = Rotation.align_vectors(partners, centred)
    translation = middle_second - rotation.apply(middle_first)
    distances = np.linalg.norm(rotation.apply(first) + translation - second, axis=1)
    # A reflection is minus a rotation.
    mirrored, _ = Rotation.align_vectors(partners, -centred)
    mirrored_left = np.linalg.norm(mirrored.apply(-centred) - partners, axis=1)
    _, singular, axes = np.linalg.svd(centred, full_matrices=True)
    squares = singular**2 / len(first)
    fre, mirrored_fre = (float(np.sqrt((each**2).mean())) for each in (distances, mirrored_left))
    return RigidMotion(
        rotation, translation, fre, distances, mirrored_fre, middle_first, squares.sum() - squares, axes
    )  # fmt: skip


def worst_pair(first_mm: Array, second_mm: Array) -> Outlier | None:
    """Return the pair that the others contradict, at 1 % for all together; None where all agree.

    Each pair is compared with what the others say of it: its squared distance from there over the variance that they
    show, as F(3, 3 (n - 1) - 6); one bad point spoils the distances of all in the common fit, but not that. Needs four
    pairs, and tells more with more of them. Raises DataError as `register` does.
    """
    from scipy import stats

    whole = register(first_mm, second_mm)
    first, second = np.asarray(first_mm, float), np.asarray(second_mm, float)
    degrees = 3 * (whole.points - 1) - 6
    found = []
    for number in range(whole.points if degrees > 0 else 0):
        others = np.arange(whole.points) != number
        try:
            motion = register(first[others], second[others])
        except DataError:
            continue
        off = float(np.linalg.norm(motion.apply(first[number]) - second[number]))
        variance = (motion.fre_mm**2 * motion.points + 1e-18) / degrees
        # Of the point itself, and of where the others put it.
        share = 1 + motion.tre_mm(first[number], 1.0) ** 2
        p_value = float(stats.f.sf(off**2 / (3 * share * variance), 3, degrees))
        found.append(Outlier(number, off, p_value))
    worst = min(found, key=lambda each: each.p_value, default=None)
    return worst if worst and worst.p_value < _UNLIKELY / whole.points else None


def rows_of(values: Array, name: str) -> Array:
    """Return values of shape (n, 3), finite numbers. Raises DataError."""
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise DataError(Mistake(name, f"shape {rows.shape}", "must have the shape (n, 3) and finite numbers"))
    return rows
