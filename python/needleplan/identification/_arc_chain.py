"""A chain of tangent arcs in the plane, and the distances of tracked points from it as a function of its unknowns.

The chain begins at an entry pose and consists of arcs between given positions along the path. The curvatures of the
arcs are `basis` @ coefficients: an identity matrix gives every arc its own curvature, a column of ones gives one
circle, and hat functions on many short arcs give a curvature that is piecewise linear along the path.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from needleplan.errors import DataError, Mistake
from needleplan.identification._circle import Circle, arc_distance
from needleplan.models import arc_step
from needleplan.signals import Array

__all__ = ["ArcChain", "along_circle"]


class ArcChain:
    """Distances of points from a chain of tangent arcs.

    The unknowns are the lateral shift (mm) and the turn (rad) of the entry pose, unless `free` is False, and then the
    m coefficients of the curvature (1/mm).

    Parameters
    ----------
    points
        Points in mm, shape (n, 2), in their order along the path.
    position
        Position (mm) of each point along the path, shape (n,).
    edges
        Increasing positions (mm) at which the arcs begin and end, shape (arcs + 1,).
    pose
        Entry pose at `edges[0]` before shift and turn: x (mm), y (mm), heading (rad).
    curvature_per_mm
        Initial value of every coefficient.
    basis
        Curvature of each arc for a unit value of each coefficient, shape (arcs, m); None for the identity.
    free
        Whether shift and turn are unknowns.
    upright
        Whether the shift is along y; otherwise it is normal to the heading of `pose`.
    """

    points: Array
    position: Array
    edges: Array
    pose: tuple[float, float, float]
    free: bool

    def __init__(
        self,
        points: Array,
        position: Array,
        edges: Array,
        pose: tuple[float, float, float],
        curvature_per_mm: float,
        *,
        basis: Array | None = None,
        free: bool = True,
        upright: bool = False,
    ) -> None:
        self.points, self.position, self.edges, self.pose, self.free = points, position, edges, pose, free
        arcs = len(edges) - 1
        self.index: NDArray[np.intp] = np.clip(np.searchsorted(edges, position, side="right") - 1, 0, arcs - 1)
        self.basis: Array = np.eye(arcs) if basis is None else basis
        self.normal: tuple[float, float] = (0.0, 1.0) if upright else (-float(np.sin(pose[2])), float(np.cos(pose[2])))
        self.size: int = self.basis.shape[1]
        extent = float(edges[-1] - edges[0])
        bends = np.full(self.size, 1 / extent)
        pose_start, pose_scale, pose_steps = ([0.0, 0.0], [1.0, 1 / extent], [1e-3, 1e-4]) if free else ([], [], [])
        self.start: Array = np.concatenate([pose_start, np.full(self.size, curvature_per_mm)])
        self.scale: Array = np.concatenate([pose_scale, bends / extent])
        self.steps: Array = np.concatenate([pose_steps, bends * 1e-3])

    def require_points(self) -> None:
        """Raise DataError if an arc has fewer than 5 points."""
        counts = np.bincount(self.index, minlength=len(self.edges) - 1)
        for number in np.flatnonzero(counts < 5):
            where = f"{self.edges[number]:.4g} to {self.edges[number + 1]:.4g} mm"
            raise DataError(Mistake("edges_mm", where, f"holds {counts[number]} points; a segment needs at least 5"))

    def entry(self, unknown: Array) -> tuple[float, float, float]:
        """Return the entry pose for the unknowns: x (mm), y (mm), heading (rad)."""
        x, y, heading = self.pose
        if not self.free:
            return x, y, heading
        shift, turn = float(unknown[0]), float(unknown[1])
        return x + shift * self.normal[0], y + shift * self.normal[1], heading + turn

    def distance(self, unknown: Array) -> Array:
        """Return the signed distances (mm) of the points from the chain, shape (n,): positive to its left."""
        x, y, heading = self.entry(unknown)
        distance = np.empty(len(self.points))
        for number, bend in enumerate(self.basis @ unknown[-self.size :]):
            here = self.index == number
            distance[here] = arc_distance(self.points[here], float(x), float(y), float(heading), float(bend))
            x, y, heading = arc_step(x, y, heading, bend, self.edges[number + 1] - self.edges[number])
        return distance

    def jacobian(self, unknown: Array) -> Array:
        """Return d(distance)/d(unknown) by central differences, shape (n, unknowns)."""
        columns = []
        for number, step in enumerate(self.steps):
            shift = np.zeros(unknown.size)
            shift[number] = step
            columns.append((self.distance(unknown + shift) - self.distance(unknown - shift)) / (2 * step))
        return np.column_stack(columns)

    def solve(self, fixed: Array | None = None) -> Array:
        """Return the unknowns with the least sum of squared distances.

        With `fixed`, the coefficients of the curvature have these values, and only shift and turn are solved for.
        """
        from scipy.optimize import least_squares

        if fixed is None:
            return np.asarray(
                least_squares(self.distance, self.start, x_scale=self.scale, jac="3-point", method="trf", xtol=1e-12).x
            )

        def held(pose: Array) -> Array:
            return self.distance(np.concatenate([pose, fixed]))

        solution = least_squares(held, [0.0, 0.0], xtol=1e-10)
        return np.concatenate([solution.x, fixed])


def along_circle(points: Array, circle: Circle) -> Array:
    """Return the arc lengths (mm) from the point of a circle to the projections of points, shape (n,)."""
    away = points - np.array(circle.point_mm)
    heading, bend = circle.heading_rad, circle.curvature_per_mm
    along = away @ np.array([np.cos(heading), np.sin(heading)])
    across = away @ np.array([-np.sin(heading), np.cos(heading)])
    if abs(bend) < 1e-12:
        return np.asarray(along)
    return np.asarray(np.arctan2(bend * along, 1 - bend * across) / bend)
