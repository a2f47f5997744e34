"""The path of one insertion: entry pose and curvature by depth, fitted to tracked points.

With the length s of the path from the entry, offset o, heading h and curvature k(s), equation (2) of
docs/explanation/curvature.md::

    x' = cos(theta),    y' = sin(theta),    theta' = k(s),    y(0) = o,    theta(0) = h

k is a member of one family (`PathShape`): uniform, layered (constant between edges), or smooth (linear between knots).
A smooth curvature is represented by many short arcs.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._arc_chain import ArcChain, along_circle
from needleplan.identification._circle import Circle, fit_circle
from needleplan.identification._fitted_arcs import FittedArcs, TrackerNoise, fit_arcs
from needleplan.models import arc_step
from needleplan.signals import Array

__all__ = ["EntryPath", "PathShape", "ShapeKind", "entry_path", "layered", "trace"]

# Number of arcs that represent a curvature that is linear between knots.
_SMOOTH_ARCS = 16


class ShapeKind(StrEnum):
    """How the curvature depends on the depth."""

    UNIFORM = "uniform"
    """One curvature."""

    LAYERED = "layered"
    """Constant between edges."""

    SMOOTH = "smooth"
    """Linear between knots, constant beyond the last knot."""


@dataclass(frozen=True)
class PathShape:
    """A form of the curvature as a function of the depth.

    `places_mm` are positions along the path: the edges between layers, or all knots of a smooth curvature; empty for a
    uniform curvature.
    """

    kind: ShapeKind = ShapeKind.UNIFORM
    places_mm: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Number of coefficients: the curvature of each layer, or at each knot."""
        return max(len(self.places_mm), 1) if self.kind is ShapeKind.SMOOTH else len(self.places_mm) + 1

    def arcs(self, end_mm: float) -> tuple[Array, Array]:
        """Return the edges of arcs from 0 to `end_mm`, shape (arcs + 1,), and their basis, shape (arcs, size)."""
        if self.kind is ShapeKind.SMOOTH:
            last = max(end_mm, self.places_mm[-1] * (1 + 1e-9))
            edges = np.linspace(0.0, last, _SMOOTH_ARCS + 1)
            middle = (edges[1:] + edges[:-1]) / 2
            return edges, np.column_stack([np.interp(middle, self.places_mm, row) for row in np.eye(self.size)])
        inner = [place_mm for place_mm in self.places_mm if place_mm < end_mm]
        edges = np.array([0.0, *inner, end_mm])
        return edges, np.eye(len(inner) + 1, self.size)

    def curvature(self, coefficients: Array, along_mm: Array) -> Array:
        """Return the curvature (1/mm) at positions along the path, shape of `along_mm`."""
        if self.kind is ShapeKind.SMOOTH:
            return np.asarray(np.interp(along_mm, self.places_mm, coefficients))
        return np.asarray(coefficients)[np.searchsorted(np.array(self.places_mm), along_mm, side="right")]

    def names(self) -> tuple[str, ...]:
        """Return a name for each coefficient."""
        if self.kind is ShapeKind.UNIFORM:
            return ("curvature_per_mm",)
        starts = (0.0, *self.places_mm) if self.kind is ShapeKind.LAYERED else self.places_mm
        word = "from" if self.kind is ShapeKind.LAYERED else "at"
        return tuple(f"curvature {word} {start:.4g} mm" for start in starts)

    def __str__(self) -> str:
        if self.kind is ShapeKind.UNIFORM:
            return "uniform"
        number = f"{self.size} layers" if self.kind is ShapeKind.LAYERED else f"{self.size} knots"
        return f"{self.kind}, {number}"


def layered(number: int, first_mm: float, last_mm: float) -> PathShape:
    """Return the shape with a number of layers, equal parts of the range from `first_mm` to `last_mm`."""
    if number == 1:
        return PathShape()
    inner = np.linspace(first_mm, last_mm, number + 1)[1:-1]
    return PathShape(ShapeKind.LAYERED, tuple(float(place) for place in inner))


def trace(shape: PathShape, x_mm: float, values: Array, along_mm: Array) -> Array:
    """Return the path at positions along it, shape (3, n): x (mm), y (mm) and heading (rad).

    `values` holds offset (mm), heading (rad) and the coefficients of the curvature; `x_mm` is the x of the entry.
    """
    along = np.atleast_1d(np.asarray(along_mm, float))
    edges, basis = shape.arcs(max(float(along.max(initial=0.0)), 1e-3))
    bends = basis @ values[2:]
    pose = (x_mm, float(values[0]), float(values[1]))
    index = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(bends) - 1)
    poses = np.empty((3, along.size))
    for number, bend in enumerate(bends):
        here = index == number
        poses[:, here] = np.array(np.broadcast_arrays(*arc_step(*pose, bend, along[here] - edges[number])))
        x, y, heading = arc_step(*pose, bend, edges[number + 1] - edges[number])
        pose = (float(x), float(y), float(heading))
    return poses


@dataclass(frozen=True)
class EntryPath:
    """The fitted path of one insertion.

    `values` holds offset (mm), heading (rad) and the coefficients of the curvature (1/mm), shape (2 + size,), and
    `covariance` their covariance with the correlation of the noise integrated out, matched to the 95 % intervals.
    `x_mm` is the x of the entry. `fitted` is the fitted chain of arcs, with positions along the path from the entry.
    """

    name: str
    shape: PathShape
    x_mm: float
    values: Array
    covariance: Array
    fitted: FittedArcs

    @property
    def first_mm(self) -> float:
        """Smallest position (mm) of a point along the path."""
        return float(self.fitted.chain.position.min())

    @property
    def deepest_mm(self) -> float:
        """Largest position (mm) of a point along the path."""
        return float(self.fitted.chain.position.max())

    def tip(self, along_mm: float) -> float:
        """Return y (mm) of the fitted path at a position along it."""
        return float(trace(self.shape, self.x_mm, self.values, np.array([along_mm]))[1, 0])

    def measured(self, along_mm: float, within_mm: float = 1.0) -> float:
        """Return the median y (mm) of the points within `within_mm` of a position, or of the nearest point."""
        apart = np.abs(self.fitted.chain.position - along_mm)
        return float(np.median(self.fitted.chain.points[apart <= max(within_mm, float(apart.min())), 1]))

    def divided(self, segments: int, *, noise: TrackerNoise, correlation_mm: float | None) -> FittedArcs:
        """Return the path fitted again with a curvature for each of several segments of equal length.

        Raises DataError if a segment has fewer than 5 points.
        """
        chain = self.fitted.chain
        edges, _ = layered(segments, self.first_mm, self.deepest_mm).arcs(self.deepest_mm)
        arcs = ArcChain(chain.points, chain.position, edges, chain.pose, float(self.values[2]), upright=True)
        arcs.require_points()
        return fit_arcs(arcs, noise=noise, correlation_mm=correlation_mm)

    def misfit(self, coefficients: Array) -> float:
        """Return the mean squared distance (mm2) of the points from a path with this curvature and any entry pose."""
        chain = self.fitted.chain
        return float(np.mean(chain.distance(chain.solve(coefficients)) ** 2))


def entry_path(
    points: Array,
    depth: Array | None,
    shape: PathShape,
    name: str = "",
    *,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
) -> EntryPath:
    """Return the path fitted to the points of one insertion.

    Parameters
    ----------
    points
        Points in mm, shape (n, 2), in their order along the path.
    depth
        Depth (mm) of each point, shape (n,). None: the entry is at x = 0, or at the smallest x if x = 0 is farther
        from the points than the points are from each other.
    shape
        Dependence of the curvature on the depth.
    name
        Name of the trial.
    noise, correlation_mm
        As for `fit_arcs`.

    Raises
    ------
    DataError
        There are too few points for the unknowns, or the points do not reach as deep as the last layer or knot.
    """
    circle = fit_circle(points)
    along = along_circle(points, circle)
    start = _at_x(circle, points) if depth is None else float(np.median(along - depth))
    position = along - start
    x, y, heading = (float(number) for number in arc_step(
        *circle.point_mm, circle.heading_rad, circle.curvature_per_mm, start
    ))  # fmt: skip
    end = float(position.max())
    if shape.kind is ShapeKind.LAYERED and shape.places_mm[-1] >= end:
        rule = f"must be less than {end:.4g} mm, the end of the path"
        raise DataError(Mistake("layers", f"{shape.places_mm[-1]:.4g} mm", rule), name)
    edges, basis = shape.arcs(end)
    chain = ArcChain(
        points, position, edges, (x, y, heading), circle.curvature_per_mm, basis=basis, upright=True
    )  # fmt: skip
    fitted = fit_arcs(chain, noise=noise, correlation_mm=correlation_mm)
    values = fitted.values
    values[:2] += (y, heading)
    return EntryPath(name, shape, x, values, fitted.covariance, fitted)


def _at_x(circle: Circle, points: Array) -> float:
    """Return the arc length (mm) from the point of the circle to x = 0, or to the smallest x if x = 0 is too far."""
    reach = float(np.hypot(*np.ptp(points, axis=0)))
    first = float(points[:, 0].min())
    wanted = 0.0 if abs(first) <= reach else first
    distance = np.linspace(-2 * reach, 2 * reach, 4001)
    x, _, heading = arc_step(*circle.point_mm, circle.heading_rad, circle.curvature_per_mm, distance)
    forward = np.abs(heading) < np.pi / 2
    return float(np.interp(wanted, x[forward], distance[forward]))
