"""Simple polygons: a rule that checks their corners."""

from __future__ import annotations

import re
from dataclasses import dataclass

from needleplan.config import Number, Pair, Violation, sequence

__all__ = ["TOLERANCE_MM", "Points", "SimplePolygon"]

TOLERANCE_MM = 1e-9
"""Distance (mm) from a boundary up to which a point counts as on the boundary, because of rounding."""

Points = tuple[tuple[float, float], ...]

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
                raise Violation(f"point {number} {broken}", value) from None
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
