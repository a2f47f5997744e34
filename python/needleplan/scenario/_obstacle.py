"""Obstacles: polygons with holes, discs and capsules, each with a margin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from needleplan.config import ConfigTable, Maybe, Number, Pair, Text, Violation, ruled, sequence
from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario._polygon import TOLERANCE_MM, Points, SimplePolygon

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

__all__ = ["COORDINATE", "LENGTH", "POLYGON", "Obstacle"]

LENGTH = Number("mm", above=0, at_most=1e6)
COORDINATE = Number("mm", at_least=-1e6, at_most=1e6)
POLYGON = SimplePolygon(COORDINATE)

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
                holes.append(POLYGON.read(entry))
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


def _one_shape(
    polygon_mm: Points | None,
    holes_mm: tuple[Points, ...] | None,
    center_mm: tuple[float, float] | None,
    ends_mm: Points | None,
    radius_mm: float | None,
) -> Iterator[Mistake]:
    shapes = {"polygon_mm": polygon_mm, "center_mm": center_mm, "ends_mm": ends_mm}
    given = [key for key, value in shapes.items() if value is not None]
    if not given:
        rule = "is missing; an obstacle has polygon_mm, or center_mm and radius_mm, or ends_mm and radius_mm"
        yield Mistake("polygon_mm", "", rule)
    if len(given) > 1:
        yield Mistake(given[1], "", f"must not be given beside {given[0]}; an obstacle has one shape")
    elif given and (given == ["polygon_mm"]) != (radius_mm is None):
        rule = "must not be given for a polygon; margin_mm widens it" if radius_mm else f"is missing beside {given[0]}"
        yield Mistake("radius_mm", f"{radius_mm:g}" if radius_mm else "", rule)
    if holes_mm is not None and polygon_mm is None:
        yield Mistake("holes_mm", "", "must not be given without polygon_mm")


def _holes_inside(polygon_mm: Points | None, holes_mm: tuple[Points, ...] | None) -> Iterator[Mistake]:
    if polygon_mm is None or not holes_mm:
        return
    from shapely import Polygon

    outline, holes = Polygon(polygon_mm), [Polygon(hole) for hole in holes_mm]
    for number, hole in enumerate(holes, start=1):
        if not outline.contains(hole):
            yield Mistake("holes_mm", "", f"hole {number} must lie inside of polygon_mm")
        for other, before in enumerate(holes[: number - 1], start=1):
            if before.intersects(hole) and not before.touches(hole):
                yield Mistake("holes_mm", "", f"hole {number} must not overlap hole {other}")


@dataclass(frozen=True)
class Obstacle(ConfigTable, key="obstacle", error=ScenarioError, between=(_one_shape, _holes_inside)):
    """A region that the tip must not touch: a polygon, a disc or a capsule. It may reach beyond the workspace.

    Parameters
    ----------
    polygon_mm : array_like, shape (n, 2), optional
        Corners in mm, at least three, clockwise or counter-clockwise. The last corner may repeat the first. The
        boundary must not cross or touch itself.
    name : str, optional
        Name for messages and figures. Default: no name.
    holes_mm : sequence of array_like, optional
        Holes of the polygon, each given by its corners in mm.
    center_mm : sequence of float, optional
        Centre [x, y] of a disc in mm, instead of `polygon_mm`.
    ends_mm : array_like, shape (2, 2), optional
        Ends of the axis of a capsule in mm, instead of `polygon_mm`: all points within `radius_mm` of the axis.
    radius_mm : float, optional
        Radius of the disc or the capsule in mm.
    margin_mm : float, optional
        The tip must not come closer to the shape than this distance in mm. Default: no margin.

    Raises
    ------
    ScenarioError
        If there is no shape or more than one, if a polygon is not simple, or if a value violates the rule of its field.

    Examples
    --------
    >>> from needleplan.scenario import Obstacle
    >>> vessel = Obstacle([[25, 0], [40, 0], [40, 22]], "vessel", margin_mm=1.5)
    >>> vessel.polygon_mm
    ((25.0, 0.0), (40.0, 0.0), (40.0, 22.0))
    >>> artery = Obstacle(ends_mm=[[10, 20], [30, 25]], radius_mm=2)
    >>> artery.touches(20, 24), artery.touches(20, 26)
    (True, False)
    """

    polygon_mm: Points | None = ruled(Maybe(POLYGON), None, about="corners [x, y]; the tip must not touch the polygon")
    name: str = ruled(Text(), "", about="for messages and figures")
    holes_mm: tuple[Points, ...] | None = ruled(Maybe(_Holes()), None, about="holes of the polygon, corners of each")
    center_mm: tuple[float, float] | None = ruled(Maybe(Pair(COORDINATE)), None, about="centre [x, y] of a disc")
    ends_mm: Points | None = ruled(Maybe(_Ends()), None, about="ends of the axis of a capsule")
    radius_mm: float | None = ruled(Maybe(LENGTH), None, about="radius of the disc or the capsule")
    margin_mm: float | None = ruled(
        Maybe(Number("mm", at_least=0, at_most=1e6)), None, about="smallest distance of the tip from the shape"
    )

    @property
    def rings_mm(self) -> tuple[Points, ...]:
        """The shape without radius and margin: outline and holes, a ring of one point, or a ring of two points."""
        if self.center_mm is not None:
            return ((self.center_mm,),)
        return (self.ends_mm or self.polygon_mm or (), *(self.holes_mm or ()))

    @property
    def reach_mm(self) -> float:
        """Distance (mm) from `rings_mm` within which a point is in the obstacle: radius and margin."""
        return (self.radius_mm or 0.0) + (self.margin_mm or 0.0)

    def touches(self, x_mm: float, y_mm: float) -> bool:
        """Return whether a point is in the obstacle or its margin.

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
        from shapely import Point

        return bool(self._core().distance(Point(x_mm, y_mm)) <= self.reach_mm + TOLERANCE_MM)

    def region(self) -> BaseGeometry:
        """Return the obstacle with its margin as a geometry of shapely, in which circles are polygons.

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
        core = self._core()
        return core.buffer(self.reach_mm, quad_segs=_QUARTER_PIECES) if self.reach_mm else core

    def _core(self) -> BaseGeometry:
        from shapely import LineString, Point, Polygon

        if self.center_mm is not None:
            return Point(self.center_mm)
        return LineString(self.ends_mm) if self.ends_mm else Polygon(self.polygon_mm, self.holes_mm)

    @classmethod
    def from_shapely(cls, geometry: Any, name: str = "", *, margin_mm: float | None = None) -> tuple[Obstacle, ...]:
        """Return the obstacles of a geometry of shapely.

        Parameters
        ----------
        geometry : shapely geometry
            A polygon, with or without holes, or a collection of polygons, in mm.
        name : str, optional
            Name of the obstacles.
        margin_mm : float, optional
            Margin of the obstacles in mm.

        Returns
        -------
        tuple of Obstacle
            One obstacle a polygon.

        Raises
        ------
        ScenarioError
            If the geometry is neither a polygon nor a collection of polygons, or a polygon is not simple.

        Examples
        --------
        >>> import shapely
        >>> from needleplan.scenario import Obstacle
        >>> ring = shapely.Point(20, 20).buffer(5) - shapely.Point(20, 20).buffer(3)
        >>> [len(each.holes_mm) for each in Obstacle.from_shapely(ring, "ring of bone")]
        [1]
        """
        parts = getattr(geometry, "geoms", [geometry])
        found = []
        for part in parts:
            if getattr(part, "geom_type", "") != "Polygon":
                kind = getattr(part, "geom_type", type(part).__name__)
                rule = "must be a polygon or a collection of polygons; buffer() turns points and lines into polygons"
                raise ScenarioError(Mistake("geometry", kind, rule))
            rings = (part.exterior, *part.interiors)
            outline, *holes = (tuple((x, y) for x, y, *_ in ring.coords) for ring in rings)
            found.append(cls(outline, name, holes_mm=tuple(holes) or None, margin_mm=margin_mm))
        return tuple(found)
