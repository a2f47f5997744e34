"""Obstacles: polygons with holes, discs and capsules, each with a margin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from needleplan.config import ConfigTable, Maybe, Number, Text, ruled
from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario import _shape
from needleplan.scenario._shape import Points

__all__ = ["Obstacle"]

_ONE_SHAPE = _shape.one_shape("an obstacle", "; margin_mm widens it")


@dataclass(frozen=True)
class Obstacle(
    _shape.Shaped, ConfigTable, key="obstacle", error=ScenarioError, between=(_ONE_SHAPE, _shape.holes_inside)
):
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

    polygon_mm: Points | None = _shape.polygon("corners [x, y]; the tip must not touch the polygon")
    name: str = ruled(Text(), "", about="for messages and figures")
    holes_mm: tuple[Points, ...] | None = _shape.holes()
    center_mm: tuple[float, float] | None = _shape.center()
    ends_mm: Points | None = _shape.ends()
    radius_mm: float | None = _shape.radius()
    margin_mm: float | None = ruled(
        Maybe(Number("mm", at_least=0, at_most=1e6)), None, about="smallest distance of the tip from the shape"
    )

    @property
    def reach_mm(self) -> float:
        """Distance (mm) from `rings_mm` within which a point is in the obstacle: radius and margin."""
        return (self.radius_mm or 0.0) + (self.margin_mm or 0.0)

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
