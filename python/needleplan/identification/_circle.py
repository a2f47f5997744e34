"""Circle fits to points of a short arc.

The plain algebraic fit (Kasa), which minimises the sum of (x^2 + y^2 + B x + C y + D)^2, is not offered: on short noisy
arcs its radius is too small. For noise sigma on an arc of length L and radius R, R_kasa / R = 1 / (1 + 720 sigma^2 R^2
/ L^4). With sigma = 0.1 mm, L = 80 mm and R = 1200 mm, that is 0.8.

The algebraic fits here normalise A (x^2 + y^2) + B x + C y + D by its mean squared gradient (Taubin, IEEE Trans. PAMI
13 (1991) 1115) or by B^2 + C^2 - 4 A D (Pratt, Computer Graphics 21 (1987) 145). The geometric fit minimises the
distances. All of them fit straight lines too. Source: N. Chernov, Circular and Linear Regression, CRC Press 2010,
chapters 3 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array

__all__ = ["Circle", "CircleMethod", "arc_distance", "checked_points", "fit_circle"]


class CircleMethod(StrEnum):
    """Objective of a circle fit."""

    PRATT = "pratt"
    """Algebraic fit, normalised by B^2 + C^2 - 4 A D."""

    TAUBIN = "taubin"
    """Algebraic fit, normalised by the mean squared gradient."""

    GEOMETRIC = "geometric"
    """Sum of squared distances: the maximum-likelihood fit for white noise."""


@dataclass(frozen=True)
class Circle:
    """A circle or straight line with a direction of travel, which is the order of the fitted points.

    `curvature_per_mm` is positive if the path bends to the left (from +x towards +y). `point_mm` is a point of the
    circle, and `heading_rad` the heading of the tangent at this point, from +x. `rms_mm` is the root mean square
    distance of the fitted points from the circle.
    """

    curvature_per_mm: float
    point_mm: tuple[float, float]
    heading_rad: float
    rms_mm: float

    @property
    def radius_mm(self) -> float:
        """Radius (mm), positive; infinite for a straight line."""
        return abs(1 / self.curvature_per_mm) if self.curvature_per_mm else float("inf")

    @property
    def center_mm(self) -> tuple[float, float]:
        """Centre (mm); infinite or NaN for a straight line."""
        reach = 1 / self.curvature_per_mm if self.curvature_per_mm else float("inf")
        x, y = self.point_mm
        return (x - reach * float(np.sin(self.heading_rad)), y + reach * float(np.cos(self.heading_rad)))

    def distances(self, points_mm: Array) -> Array:
        """Return the signed distances (mm) of points, shape (n, 2), from the circle: positive to the left of the path.

        The result has shape (n,).
        """
        return arc_distance(points_mm, *self.point_mm, self.heading_rad, self.curvature_per_mm)


def arc_distance(points_mm: Array, x_mm: float, y_mm: float, heading_rad: float, curvature_per_mm: float) -> Array:
    """Return the signed distances (mm) of points from a circle that passes (x, y) with the given heading.

    `points_mm` has shape (n, 2), the result (n,). Distances are positive to the left of the path. Equation (1) of
    docs/explanation/curvature.md is exact for every curvature, including zero.
    """
    away = points_mm - np.array([x_mm, y_mm])
    along = away @ np.array([np.cos(heading_rad), np.sin(heading_rad)])
    across = away @ np.array([-np.sin(heading_rad), np.cos(heading_rad)])
    power = across - curvature_per_mm / 2 * (along**2 + across**2)
    return np.asarray(2 * power / (1 + np.sqrt(np.maximum(1 - 2 * curvature_per_mm * power, 0))))


def fit_circle(points_mm: Array, method: CircleMethod = CircleMethod.GEOMETRIC) -> Circle:
    """Fit a circle to points in their order along the path.

    Parameters
    ----------
    points_mm : numpy.ndarray
        Points (mm), shape (n, 2).
    method : CircleMethod, default CircleMethod.GEOMETRIC
        Method of the fit.

    Returns
    -------
    Circle

    Raises
    ------
    DataError
        The points have another shape, are fewer than 3, are not finite, or all coincide.
    """
    points = checked_points(points_mm)
    middle = points.mean(axis=0)
    size = float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean()))
    scaled = (points - middle) / size
    circle = _algebraic(scaled, method)
    if method is CircleMethod.GEOMETRIC:
        circle = _geometric(scaled, circle)
    curvature, x, y, heading = circle
    along = scaled @ np.array([np.cos(heading), np.sin(heading)])
    if np.polyfit(np.arange(len(along)), along, 1)[0] < 0:
        curvature, heading = -curvature, heading + np.pi
    heading = float((heading + np.pi) % (2 * np.pi) - np.pi)
    place = (float(middle[0] + size * x), float(middle[1] + size * y))
    distance = arc_distance(points, *place, heading, curvature / size)
    return Circle(float(curvature / size), place, heading, float(np.sqrt((distance**2).mean())))


def checked_points(points_mm: Array) -> Array:
    """Return the points as a float array of shape (n, 2).

    Raises DataError for another shape, fewer than 3 points, numbers that are not finite, or points that all coincide.
    """
    points = np.asarray(points_mm, float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise DataError(Mistake("points_mm", f"shape {points.shape}", "must have the shape (n, 2), n at least 3"))
    if not np.isfinite(points).all():
        count = int((~np.isfinite(points)).any(axis=1).sum())
        raise DataError(Mistake("points_mm", f"{count} points", "must be finite numbers"))
    if not np.ptp(points, axis=0).any():
        raise DataError(Mistake("points_mm", "", "must differ, but are all in one place"))
    return points


def _algebraic(points: Array, method: CircleMethod) -> tuple[float, float, float, float]:
    """Return curvature, point (x, y) and heading of an algebraic fit, by singular values (Chernov 5.6, 5.9)."""
    square = (points**2).sum(axis=1)
    if method is CircleMethod.TAUBIN:
        mean = square.mean()
        rows = np.column_stack([(square - mean) / (2 * np.sqrt(mean)), points])
        a, b, c = np.linalg.svd(rows, full_matrices=False)[2][-1]
        a = a / (2 * np.sqrt(mean))
        d = -mean * a
    else:
        _, singular, directions = np.linalg.svd(np.column_stack([square, points, np.ones(len(points))]))
        if len(points) < 4 or singular[-1] < 1e-11 * singular[0]:
            a, b, c, d = directions[-1]
        else:
            root = (directions.T * singular) @ directions
            constraint = np.zeros((4, 4))
            constraint[0, 3] = constraint[3, 0] = -0.5  # the inverse of B^2 + C^2 - 4 A D
            constraint[1, 1] = constraint[2, 2] = 1
            values, vectors = np.linalg.eigh(root @ constraint @ root)
            smallest = int(np.flatnonzero(values > 0)[0])
            a, b, c, d = np.linalg.solve(root, vectors[:, smallest])
    norm = np.sqrt(max(b * b + c * c - 4 * a * d, 1e-300))
    a, b, c, d = (coefficient / norm for coefficient in (a, b, c, d))
    # a r^2 + b x + c y + d = 0; the gradient at the point nearest to the origin is the normal to the left of the path.
    steep = np.hypot(b, c) or 1.0
    normal = np.array([b, c]) / steep
    reach = -2 * d / (steep + 1)
    x, y = reach * normal
    return -2 * a, float(x), float(y), float(np.arctan2(-normal[0], normal[1]))


def _geometric(points: Array, start: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Return curvature, point (x, y) and heading of the geometric fit.

    Curvature, lateral shift and turn are optimised, starting from the algebraic fit `start`.
    """
    from scipy.optimize import least_squares

    curvature, x, y, heading = start

    def place(unknown: Array) -> tuple[float, float, float, float]:
        turned = heading + unknown[2]
        shifted = (x - unknown[1] * np.sin(heading), y + unknown[1] * np.cos(heading))
        return float(unknown[0]), float(shifted[0]), float(shifted[1]), float(turned)

    def distance(unknown: Array) -> Array:
        bend, at_x, at_y, turned = place(unknown)
        return arc_distance(points, at_x, at_y, turned, bend)

    solution = least_squares(distance, np.array([curvature, 0.0, 0.0]), method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return place(solution.x)
