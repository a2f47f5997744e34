"""The scenario as a moving tip meets it: how far a step is, what it would touch, how near it comes to the target."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from needleplan.models import arc_step
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

__all__ = ["Scene"]

_SAMPLE_MM = 0.05


class Scene:
    """Questions about places in a scenario; x and y in mm."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._uniform = scenario.uniform

    def radius_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the planned radius of an arc that starts at a place."""
        if self._uniform:
            return self.scenario.needle.curvature_radius_mm
        return float(self.scenario.radius_mm(x_mm, y_mm))

    def step_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the length of the step that starts at a place: one heading of the table."""
        return 2 * math.pi * self.radius_mm(x_mm, y_mm) / self.scenario.motion.headings

    def clamped(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return the place, or the one on the edge of the workspace for which it stands: half a cell beyond it."""
        workspace, (dx, dy) = self.scenario.workspace, self.scenario.grid.spacing_mm
        x = min(max(x_mm, 0.0), workspace.width_mm)
        y = min(max(y_mm, 0.0), workspace.height_mm)
        return (x if abs(x - x_mm) <= dx / 2 else x_mm), (y if abs(y - y_mm) <= dy / 2 else y_mm)

    def outside(self, x_mm: float, y_mm: float) -> bool:
        """Whether a place is more than half a cell outside of the workspace."""
        x, y = self.clamped(x_mm, y_mm)
        workspace = self.scenario.workspace
        return not (0 <= x <= workspace.width_mm and 0 <= y <= workspace.height_mm)

    def decided_at(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return the place for which the table is asked where the tip is at another that is free.

        It is the same place, unless the grid point nearest to it lies in an obstacle, where nothing is decided: then it
        is the nearest corner of its cell that does not, if there is one.
        """
        (dx, dy), points = self.scenario.grid.spacing_mm, self.scenario.grid.points(self.scenario.workspace)
        corners = [
            (i * dx, j * dy)
            for i in (math.floor(x_mm / dx), math.floor(x_mm / dx) + 1)
            for j in (math.floor(y_mm / dy), math.floor(y_mm / dy) + 1)
            if 0 <= i < points[0] and 0 <= j < points[1]
        ]
        corners.sort(key=lambda at: math.hypot((at[0] - x_mm) / dx, (at[1] - y_mm) / dy))
        free = next((at for at in corners if not self.touches(*at)), None)
        return (x_mm, y_mm) if free is None or free == corners[0] else free

    def touches(self, x_mm: float, y_mm: float) -> str:
        """Return the name of the obstacle that a place is in, or nothing."""
        from shapely import Point

        point = Point(x_mm, y_mm)
        for name, polygon in self._obstacles:
            if polygon.intersects(point):
                return name
        return ""

    def target_distance_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the distance from the centre of the target."""
        x, y = self.scenario.target.center_mm
        return math.hypot(x_mm - x, y_mm - y)

    def closest(
        self, x_mm: float, y_mm: float, heading_rad: float, curvature_per_mm: float, length_mm: float
    ) -> tuple[float, float]:
        """Return where on an arc the tip is closest to the centre of the target, and how close: mm, mm."""
        lengths = np.linspace(0.0, length_mm, max(int(length_mm / _SAMPLE_MM), 1) + 1)
        x, y, _ = arc_step(x_mm, y_mm, heading_rad, curvature_per_mm, lengths)
        target_x, target_y = self.scenario.target.center_mm
        distances = np.hypot(x - target_x, y - target_y)
        at = int(distances.argmin())
        return float(lengths[at]), float(distances[at])

    def blocked(self, x_mm: float, y_mm: float, heading_rad: float, curvature_per_mm: float, length_mm: float) -> bool:
        """Whether an arc leaves the workspace or touches an obstacle."""
        lengths = np.linspace(0.0, length_mm, max(int(length_mm / _SAMPLE_MM), 1) + 1)
        x, y, _ = arc_step(x_mm, y_mm, heading_rad, curvature_per_mm, lengths)
        return any(self.outside(*at) or self.touches(*at) for at in zip(x.tolist(), y.tolist(), strict=True))

    @cached_property
    def _obstacles(self) -> list[tuple[str, BaseGeometry]]:
        from shapely import Polygon, prepare

        found: list[tuple[str, BaseGeometry]] = []
        for number, each in enumerate(self.scenario.obstacles, start=1):
            polygon = Polygon(each.polygon_mm)
            prepare(polygon)
            found.append((each.name or f"obstacle {number}", polygon))
        return found
