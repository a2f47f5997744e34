"""Simple polygons: a rule that checks their corners."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from needleplan.config import Number, Pair, Violation, sequence

__all__ = ["TOLERANCE_MM", "Points", "SimplePolygon"]

TOLERANCE_MM = 1e-9
"""Distance (mm) from a boundary up to which a point counts as on the boundary, because of rounding."""

Points = tuple[tuple[float, float], ...]

# Largest number of corners whose edges are compared in pairs, which then takes less time than the import of shapely.
_FEW_CORNERS = 50

# Bound on the rounding of a doubled triangle area, as a part of the square of the extent of the polygon.
_ROUNDING = 1e-12

# Largest number of corners of a polygon.
_MOST_POINTS = 100_000


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
