"""Shapes of obstacles and tissues: simple polygons with holes, discs and capsules; their rules and their geometry."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from needleplan.config import Maybe, Number, Pair, Violation, ruled, sequence
from needleplan.errors import Mistake

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray
    from shapely.geometry.base import BaseGeometry

__all__ = [
    "COORDINATE",
    "LENGTH",
    "TOLERANCE_MM",
    "Points",
    "Shaped",
    "SimplePolygon",
    "center",
    "ends",
    "holes",
    "holes_inside",
    "one_shape",
    "polygon",
    "radius",
]

TOLERANCE_MM = 1e-9
"""Distance (mm) from a boundary up to which a point counts as on the boundary, because of rounding."""

Points = tuple[tuple[float, float], ...]

# Largest number of corners whose edges are compared in pairs, which then takes less time than the import of shapely.
_FEW_CORNERS = 50

# Bound on the rounding of a doubled triangle area, as a part of the square of the extent of the polygon.
_ROUNDING = 1e-12

# Largest number of corners of a polygon.
_MOST_POINTS = 100_000


LENGTH = Number("mm", above=0, at_most=1e6)
COORDINATE = Number("mm", at_least=-1e6, at_most=1e6)


@dataclass(frozen=True)
class SimplePolygon:
    """Rule for the corners of a polygon whose boundary does not cross or touch itself. `coordinate` reads x and y."""

    coordinate: Number

    def read(self, value: object) -> Points:
        """Return the corners without successive repetitions, and without the last corner if it repeats the first.

        Raises Violation if `value` is not a list of at most 100,000 points, or the polygon is not simple.
        """
        entries = sequence(value)
        if entries is None or len(entries) > _MOST_POINTS:
            raise Violation("must be a list of points, [[x, y], [x, y], [x, y], ...]", value)
        corners: list[tuple[float, float]] = []
        for number, entry in enumerate(entries, start=1):
            try:
                corner = Pair(self.coordinate).read(entry)
            except Violation as broken:
                raise Violation(f"point {number}: {broken}", value) from None
            if not corners or corner != corners[-1]:
                corners.append(corner)
        if len(corners) > 1 and corners[0] == corners[-1]:
            corners.pop()
        if len(set(corners)) < 3:
            raise Violation("must have at least three different points", value)
        flaw = _flaw(corners)
        if flaw:
            raise Violation(flaw, value)
        return tuple(corners)


_POLYGON = SimplePolygon(COORDINATE)

# Straight pieces of a quarter circle in figures and in the geometry of shapely. At 64, the corners of the pieces are
# 0.008 % of the radius too far inside.
_QUARTER_PIECES = 64


@dataclass(frozen=True)
class _Holes:
    """Rule for the holes of a polygon: a list of simple polygons."""

    def read(self, value: object) -> tuple[Points, ...]:
        """Return the holes, each as its corners. Raises Violation."""
        entries = sequence(value)
        if entries is None:
            raise Violation(
                "must be a list of holes, each a list of points, [[[x, y], [x, y], [x, y], ...], ...]", value
            )
        holes = []
        for number, entry in enumerate(entries, start=1):
            try:
                holes.append(_POLYGON.read(entry))
            except Violation as broken:
                raise Violation(f"hole {number} {broken}", value) from None
        return tuple(holes)


@dataclass(frozen=True)
class _Ends:
    """Rule for the two ends of the axis of a capsule."""

    def read(self, value: object) -> Points:
        """Return both ends. Raises Violation."""
        entries = sequence(value)
        if entries is None or len(entries) != 2:
            raise Violation("must be two points, [[x, y], [x, y]]", value)
        try:
            return Pair(COORDINATE).read(entries[0]), Pair(COORDINATE).read(entries[1])
        except Violation as broken:
            raise Violation(f"each of the two points {broken}", value) from None


def polygon(about: str) -> Any:
    """Return the dataclass field `polygon_mm`, with its rule. `about` is its comment in commented files."""
    return ruled(Maybe(_POLYGON), None, about=about)


def holes() -> Any:
    """Return the dataclass field `holes_mm`, the holes of a polygon, with its rule."""
    return ruled(Maybe(_Holes()), None, about="holes of the polygon, corners of each")


def center() -> Any:
    """Return the dataclass field `center_mm`, the centre of a disc, with its rule."""
    return ruled(Maybe(Pair(COORDINATE)), None, about="centre [x, y] of a disc")


def ends() -> Any:
    """Return the dataclass field `ends_mm`, the two ends of the axis of a capsule, with its rule."""
    return ruled(Maybe(_Ends()), None, about="ends of the axis of a capsule")


def radius() -> Any:
    """Return the dataclass field `radius_mm`, the radius of a disc or capsule, with its rule."""
    return ruled(Maybe(LENGTH), None, about="radius of the disc or the capsule")


def one_shape(noun: str, hint: str = "") -> Callable[..., Iterator[Mistake]]:
    """Return the rule that a table has exactly one shape. `noun` names the table; `hint` is about polygons."""

    def rule(
        polygon_mm: Points | None,
        holes_mm: tuple[Points, ...] | None,
        center_mm: tuple[float, float] | None,
        ends_mm: Points | None,
        radius_mm: float | None,
    ) -> Iterator[Mistake]:
        shapes = {"polygon_mm": polygon_mm, "center_mm": center_mm, "ends_mm": ends_mm}
        given = [key for key, value in shapes.items() if value is not None]
        if not given:
            missing = f"is missing; {noun} has polygon_mm, or center_mm and radius_mm, or ends_mm and radius_mm"
            yield Mistake("polygon_mm", "", missing)
        if len(given) > 1:
            yield Mistake(given[1], "", f"must not be given beside {given[0]}; {noun} has one shape")
        elif given and (given == ["polygon_mm"]) != (radius_mm is None):
            unwanted = f"must not be given for a polygon{hint}"
            wrong = unwanted if radius_mm else f"is missing beside {given[0]}"
            yield Mistake("radius_mm", f"{radius_mm:g}" if radius_mm else "", wrong)
        if holes_mm is not None and polygon_mm is None:
            yield Mistake("holes_mm", "", "must not be given without polygon_mm")

    return rule


def holes_inside(polygon_mm: Points | None, holes_mm: tuple[Points, ...] | None) -> Iterator[Mistake]:
    """Yield a mistake for each hole that is not inside of the polygon or overlaps another hole."""
    if polygon_mm is None or not holes_mm:
        return
    from shapely import Polygon

    outline, inner = Polygon(polygon_mm), [Polygon(hole) for hole in holes_mm]
    for number, hole in enumerate(inner, start=1):
        if not outline.contains(hole):
            yield Mistake("holes_mm", "", f"hole {number} must lie inside of polygon_mm")
        for other, before in enumerate(inner[: number - 1], start=1):
            if before.intersects(hole) and not before.touches(hole):
                yield Mistake("holes_mm", "", f"hole {number} must not overlap hole {other}")


class Shaped:
    """Base class of tables with a shape: a polygon with holes, a disc or a capsule. Only one shape is not None."""

    polygon_mm: Points | None
    holes_mm: tuple[Points, ...] | None
    center_mm: tuple[float, float] | None
    ends_mm: Points | None
    radius_mm: float | None

    @property
    def rings_mm(self) -> tuple[Points, ...]:
        """The shape without radius and margin: outline and holes, a ring of one point, or a ring of two points."""
        if self.center_mm is not None:
            return ((self.center_mm,),)
        return (self.ends_mm or self.polygon_mm or (), *(self.holes_mm or ()))

    @property
    def reach_mm(self) -> float:
        """Distance (mm) from `rings_mm` within which a point is in the region: the radius, and a margin."""
        return self.radius_mm or 0.0

    def touches(self, x_mm: float, y_mm: float) -> bool:
        """Return whether a point is in the region, its boundary or its margin.

        Parameters
        ----------
        x_mm, y_mm : float
            The point in mm.

        Returns
        -------
        bool
            True also on the boundary.

        Examples
        --------
        >>> from needleplan.scenario import Obstacle
        >>> Obstacle(center_mm=[10, 20], radius_mm=2).touches(10, 22)
        True
        """
        reach = self.reach_mm + TOLERANCE_MM
        for at, (low, high) in zip((x_mm, y_mm), self._box, strict=True):
            if at < low - reach or at > high + reach:
                return False
        return bool(self.covers(x_mm, y_mm))

    def covers(self, x_mm: ArrayLike, y_mm: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of the points for which `touches` is True.

        Parameters
        ----------
        x_mm, y_mm : array_like
            Coordinates in mm, of the same shape.

        Returns
        -------
        numpy.ndarray
            Mask of this shape.

        Examples
        --------
        >>> from needleplan.scenario import Obstacle
        >>> Obstacle(center_mm=[10, 20], radius_mm=2).covers([10, 10], [22, 23]).tolist()
        [True, False]
        """
        import shapely

        found: NDArray[np.bool_] = shapely.dwithin(self._core, shapely.points(x_mm, y_mm), self.reach_mm + TOLERANCE_MM)
        return found

    def region(self) -> BaseGeometry:
        """Return the region with its margin as a geometry of shapely, in which circles are polygons.

        Returns
        -------
        shapely.Polygon or shapely.MultiPolygon
            The region in mm. Corners of circles lie on the circle, so the region is at most 0.01 % of the radius too
            small.

        Examples
        --------
        >>> from needleplan.scenario import Obstacle
        >>> round(Obstacle(center_mm=[10, 20], radius_mm=2).region().area, 1)
        12.6
        """
        return self._core.buffer(self.reach_mm, quad_segs=_QUARTER_PIECES) if self.reach_mm else self._core

    @cached_property
    def _box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The smallest and the largest x, and y, of the outline without radius and margin (mm)."""
        xs, ys = zip(*self.rings_mm[0], strict=True)
        return (min(xs), max(xs)), (min(ys), max(ys))

    @cached_property
    def _core(self) -> BaseGeometry:
        """The geometry of `rings_mm`, prepared for the insertion loop, which queries points one by one."""
        from shapely import LineString, Point, Polygon, prepare

        core: BaseGeometry
        if self.center_mm is not None:
            core = Point(self.center_mm)
        else:
            core = LineString(self.ends_mm) if self.ends_mm else Polygon(self.polygon_mm, self.holes_mm)
        prepare(core)
        return core


def _flaw(corners: list[tuple[float, float]]) -> str:
    """Return the rule that a polygon with these corners violates, or an empty text if the polygon is simple."""
    if _is_clearly_simple(corners):
        return ""
    from shapely import Polygon, is_valid_reason

    polygon = Polygon(corners)
    if polygon.convex_hull.area == 0:
        return "must enclose an area; all its points lie on one line"
    reason = is_valid_reason(polygon)
    if reason == "Valid Geometry":
        return ""
    where = re.search(r"\[(\S+) (\S+)\]", reason)
    place = f" at ({float(where[1]):g}, {float(where[2]):g})" if where else ""
    return f"must not cross or touch its own boundary; it does so{place}{_crossing(corners)}"


def _is_clearly_simple(corners: Sequence[tuple[float, float]]) -> bool:
    """Return whether a polygon is simple beyond doubt, without shapely. False for many corners and for close cases.

    Two segments have no common point if both ends of one lie on the same side of the line through the other.
    """
    count = len(corners)
    if count > _FEW_CORNERS:
        return False
    extent: float = max(max(axis) - min(axis) for axis in zip(*corners, strict=True))
    least = _ROUNDING * extent * extent

    def side(a: int, corner: int) -> int:
        """Return on which side of the line through corners a and a + 1 a corner lies; 0 if that is not certain."""
        area = _doubled_area(corners[a], corners[(a + 1) % count], corners[corner % count])
        return (area > least) - (area < -least)

    def apart(a: int, b: int) -> bool:
        """Return whether two edges certainly have no common point."""
        return side(a, b) * side(a, b + 1) > 0 or side(b, a) * side(b, a + 1) > 0

    # Neighbouring edges share a corner, and nothing else if they are not parallel.
    return all(side(a, a + 2) for a in range(count)) and all(
        apart(a, b) for a in range(count) for b in range(a + 2, count - (a == 0))
    )


def _doubled_area(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return twice the area of a triangle, positive if its corners run counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _crossing(corners: list[tuple[float, float]]) -> str:
    """Return which two edges of the polygon cross each other, as the end of a message; empty if none do."""
    from shapely import LineString, STRtree

    count = len(corners)
    edges = [LineString([corners[k], corners[(k + 1) % count]]) for k in range(count)]
    first, second = STRtree(edges).query(edges, predicate="crosses")
    pairs = sorted((int(a), int(b)) for a, b in zip(first, second, strict=True) if a < b)
    if not pairs:
        return ""
    a, b = pairs[0]
    names = [f"from point {k + 1} to point {(k + 1) % count + 1}" for k in (a, b)]
    return f", where it crosses itself: the edge {names[0]} and the edge {names[1]}"
