"""Rigid registration of two frames from pairs of points, its error, and the pair that contradicts the others most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals import Array, RigidError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["Outlier", "RigidMotion", "register", "rows_of", "worst_pair"]

# Ratio of the second to the first singular value below which points count as collinear and are refused.
FLAT = 1e-3

# Significance level (for all pairs together) below which a pair is reported as an outlier.
_UNLIKELY = 0.01


@dataclass(frozen=True)
class RigidMotion(ShortRepr):
    """A rigid motion b = R a + t from one frame to another, fitted to pairs of points.

    `fre_mm` is the fiducial registration error: the root mean square distance of the moved points from their partners.
    For the error at other places, use `tre_mm`. `centre_mm` is the mean of the points of the first frame.
    """

    rotation: Rotation
    translation_mm: Array
    fre_mm: float
    distances_mm: Array
    """Distance of each moved point from its partner, shape (n,)."""

    mirrored_fre_mm: float
    """FRE of the best motion with a reflection: much smaller than `fre_mm` if an axis of a frame has the wrong sign."""

    centre_mm: Array
    moments_mm2: Array
    """Mean square distances of the points from their three principal axes, shape (3,)."""

    axes: Array
    """Principal axes of the points: the rows of an array of shape (3, 3)."""

    @property
    def points(self) -> int:
        """Number of pairs."""
        return len(self.distances_mm)

    def apply(self, points_mm: Array) -> Array:
        """Return points of the first frame, shape (n, 3) or (3,), in the second frame."""
        return np.asarray(self.rotation.apply(points_mm) + self.translation_mm)

    @property
    def fle_mm(self) -> float:
        """Fiducial localisation error: RMS error (mm) of a measured point, estimated by FRE^2 = (1 - 2/n) FLE^2."""
        return float(self.fre_mm / np.sqrt(1 - 2 / self.points))

    def tre_mm(self, target_mm: Array, fle_mm: float | None = None) -> float:
        """Return the expected root mean square error at a target (target registration error), to first order.

        Parameters
        ----------
        target_mm : numpy.ndarray
            Target in the first frame (mm), shape (3,).
        fle_mm : float, optional
            Root mean square error of the points (mm). Default: the estimate `self.fle_mm`.

        Returns
        -------
        float
            Error (mm).

        Notes
        -----
        TRE^2 = FLE^2 / n (1 + 1/3 sum_k d_k^2 / f_k^2), where d_k is the distance of the target, and f_k the root mean
        square distance of the points, from principal axis k. Source: Fitzpatrick et al., IEEE Trans. Medical Imaging 17
        (1998) 694.
        """
        size = self.fle_mm if fle_mm is None else fle_mm
        along = self.axes @ (np.asarray(target_mm, float) - self.centre_mm)
        squares = along @ along - along**2
        return float(size * np.sqrt((1 + np.sum(squares / self.moments_mm2) / 3) / self.points))

    @property
    def error(self) -> RigidError:
        """Error of the motion in the second frame, by its covariance to first order (docs/explanation/promise.md).

        Examples
        --------
        >>> import numpy as np
        >>> from needleplan.estimation.registration import register
        >>> points = np.array([[0, 0, 0], [50, 0, 0], [0, 50, 0], [0, 0, 50.0]])
        >>> motion = register(points, points + np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]))
        >>> bool(np.isclose(motion.error.tre_mm(motion.apply(points[0])), motion.tre_mm(points[0])))
        True
        """
        size = self.fle_mm**2 / (3 * self.points)
        axes = self.rotation.apply(self.axes)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = axes.T @ np.diag(size / self.moments_mm2) @ axes
        covariance[3:, 3:] = size * np.eye(3)
        return RigidError(self.apply(self.centre_mm), (covariance + covariance.T) / 2)


@dataclass(frozen=True)
class Outlier:
    """A pair of points that contradicts the other pairs: index, distance (mm) from the fit of the others, p-value.

    The p-value is the probability of such a distance for this pair alone.
    """

    number: int
    distance_mm: float
    p_value: float


def register(
    first_mm: Array, second_mm: Array, names: tuple[str, str] = ("first_mm", "second_mm")
) -> RigidMotion:  # fmt: skip
    """Return the rigid motion that moves points to their partners, by least squares (Kabsch).

    The result is never a reflection.

    Parameters
    ----------
    first_mm : numpy.ndarray
        Points (mm), shape (n, 3).
    second_mm : numpy.ndarray
        Their partners (mm), shape (n, 3).
    names : tuple of str, optional
        Names of the two sets of points in messages.

    Returns
    -------
    RigidMotion

    Raises
    ------
    DataError
        The shapes differ, a number is not finite, there are fewer than 3 pairs, or points lie on one line.
    """
    from scipy.spatial.transform import Rotation

    first, second = rows_of(first_mm, names[0]), rows_of(second_mm, names[1])
    if first.shape != second.shape:
        raise DataError(Mistake(names[1], f"shape {second.shape}", f"must be that of {names[0]}, {first.shape}"))
    if len(first) < 3:
        raise DataError(Mistake(names[0], f"{len(first)} points", "must be at least 3, not on one line"))
    middle_first, middle_second = first.mean(axis=0), second.mean(axis=0)
    centred, partners = first - middle_first, second - middle_second
    for name, points in zip(names, (centred, partners), strict=True):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= FLAT * spread[0] or spread[0] == 0:
            where = "in one place" if spread[0] == 0 else "on one line"
            rule = f"must not lie {where}: the rotation is not determined; measure points around the target"
            raise DataError(Mistake(name, f"{len(first)} points", rule))
    rotation, _ = Rotation.align_vectors(partners, centred)
    translation = middle_second - rotation.apply(middle_first)
    distances = np.linalg.norm(rotation.apply(first) + translation - second, axis=1)
    # A reflection is minus a rotation.
    mirrored, _ = Rotation.align_vectors(partners, -centred)
    mirrored_left = np.linalg.norm(mirrored.apply(-centred) - partners, axis=1)
    _, singular, axes = np.linalg.svd(centred, full_matrices=True)
    squares = singular**2 / len(first)
    fre, mirrored_fre = (float(np.sqrt((lengths**2).mean())) for lengths in (distances, mirrored_left))
    return RigidMotion(
        rotation, translation, fre, distances, mirrored_fre, middle_first, squares.sum() - squares, axes
    )  # fmt: skip


def worst_pair(first_mm: Array, second_mm: Array) -> Outlier | None:
    """Return the pair of points that contradicts the others most, or None if none does at the 1 % level.

    Each pair is tested against the fit of the other pairs, and the level holds for all pairs together (Bonferroni).
    Fewer than four pairs are not tested, and neither is a pair without which the points are collinear.

    Parameters
    ----------
    first_mm : numpy.ndarray
        Points (mm), shape (n, 3).
    second_mm : numpy.ndarray
        Their partners (mm), shape (n, 3).

    Returns
    -------
    Outlier or None

    Raises
    ------
    DataError
        The points are invalid, as in `register`.

    Notes
    -----
    The squared distance of a pair, divided by 3 (1 + t^2) s^2, has the distribution F(3, 3 (n - 1) - 6): s^2 is the
    residual variance per coordinate of the other pairs, and t is `tre_mm` of their fit at the point for an FLE of 1.
    """
    from scipy import stats

    whole = register(first_mm, second_mm)
    first, second = np.asarray(first_mm, float), np.asarray(second_mm, float)
    degrees = 3 * (whole.points - 1) - 6
    outliers = []
    for number in range(whole.points if degrees > 0 else 0):
        others = np.arange(whole.points) != number
        try:
            motion = register(first[others], second[others])
        except DataError:
            continue
        off = float(np.linalg.norm(motion.apply(first[number]) - second[number]))
        variance = (motion.fre_mm**2 * motion.points + 1e-18) / degrees
        # Variance of the point itself, plus the variance of its prediction by the others.
        share = 1 + motion.tre_mm(first[number], 1.0) ** 2
        p_value = float(stats.f.sf(off**2 / (3 * share * variance), 3, degrees))
        outliers.append(Outlier(number, off, p_value))
    worst = min(outliers, key=lambda outlier: outlier.p_value, default=None)
    return worst if worst and worst.p_value < _UNLIKELY / whole.points else None


def rows_of(values: Array, name: str) -> Array:
    """Return `values` as an array of finite numbers of shape (n, 3). Raises DataError for anything else."""
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise DataError(Mistake(name, f"shape {rows.shape}", "must have the shape (n, 3) and finite numbers"))
    return rows
