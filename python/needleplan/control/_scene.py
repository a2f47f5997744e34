"""Geometry of a scenario along the path of the tip: step lengths, obstacles, and the approach to the target."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from needleplan.models import arc_step
from needleplan.planning import Pose
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

__all__ = ["GAIN_MM", "NEARLY_MM", "Approach", "ScenarioGeometry", "state_of"]

NEARLY_MM = 0.05
"""Distance to a goal (mm) below which the goal counts as reached. A tip in the target is done if the point closest to
the centre of the target is less than twice this distance ahead."""

# distance (mm) between the points at which an arc is checked
_SAMPLE_MM = 0.05
GAIN_MM = 0.1
"""Smallest reduction (mm) of the distance to the target that justifies a last step beside the target."""


class ScenarioGeometry:
    """Geometry of one scenario. Positive curvature (1/mm) bends to the left."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.center_mm: tuple[float, ...] = scenario.target.center_mm
        """Centre of the target."""

        self._uniform = scenario.uniform

    def pushed(self, heading_rad: float, length_mm: float) -> Self:
        """Return the geometry with the target moved along a heading.

        Parameters
        ----------
        heading_rad : float
            Heading (rad).
        length_mm : float
            Length (mm) by which the centre of the target moves.

        Returns
        -------
        ScenarioGeometry
        """
        x, y = self.center_mm
        moved = copy(self)
        moved.center_mm = (x + length_mm * math.cos(heading_rad), y + length_mm * math.sin(heading_rad))
        return moved

    def radius_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the planned radius of curvature of an arc that starts at a point.

        Parameters
        ----------
        x_mm, y_mm : float
            Point (mm).

        Returns
        -------
        float
            Radius (mm).
        """
        if self._uniform:
            return self.scenario.needle.curvature_radius_mm
        return float(self.scenario.radius_mm(x_mm, y_mm))

    def step_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the length of a step from a point.

        Parameters
        ----------
        x_mm, y_mm : float
            Point (mm).

        Returns
        -------
        float
            Length (mm).
        """
        return self.scenario.motion.step_length_mm(self.radius_mm(x_mm, y_mm))

    def clamped(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return the point; a coordinate that is at most half a cell outside the workspace is moved to the edge.

        Parameters
        ----------
        x_mm, y_mm : float
            Point (mm).

        Returns
        -------
        tuple of float
            x and y (mm).
        """
        workspace, (dx, dy) = self.scenario.workspace, self.scenario.grid.spacing_mm
        x = min(max(x_mm, 0.0), workspace.width_mm)
        y = min(max(y_mm, 0.0), workspace.height_mm)
        return (x if abs(x - x_mm) <= dx / 2 else x_mm), (y if abs(y - y_mm) <= dy / 2 else y_mm)

    def outside(self, x_mm: float, y_mm: float) -> bool:
        """Return whether a point is more than half a cell outside the workspace.

        Parameters
        ----------
        x_mm, y_mm : float
            Point (mm).

        Returns
        -------
        bool
        """
        x, y = self.clamped(x_mm, y_mm)
        workspace = self.scenario.workspace
        return not (0 <= x <= workspace.width_mm and 0 <= y <= workspace.height_mm)

    def touches(self, x_mm: float, y_mm: float) -> str:
        """Return the name of the obstacle that contains a point.

        Parameters
        ----------
        x_mm, y_mm : float
            Point (mm).

        Returns
        -------
        str
            Empty if no obstacle contains the point.
        """
        from shapely import Point

        point = Point(x_mm, y_mm)
        for name, polygon in self._obstacles:
            if polygon.intersects(point):
                return name
        return ""

    def target_distance_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the distance of a point from the centre of the target.

        Parameters
        ----------
        x_mm, y_mm : float
            Point (mm).

        Returns
        -------
        float
            Distance (mm).
        """
        x, y = self.center_mm
        return math.hypot(x_mm - x, y_mm - y)

    def closest(
        self, x_mm: float, y_mm: float, heading_rad: float, curvature_per_mm: float, length_mm: float
    ) -> tuple[float, float]:
        """Return where an arc is closest to the centre of the target.

        Parameters
        ----------
        x_mm, y_mm : float
            Start of the arc (mm).
        heading_rad : float
            Heading at the start (rad).
        curvature_per_mm : float
            Curvature (1/mm), positive to the left.
        length_mm : float
            Length of the arc (mm).

        Returns
        -------
        tuple of float
            Length along the arc to the closest point, and distance of this point from the centre (mm).
        """
        lengths = np.linspace(0.0, length_mm, max(int(length_mm / _SAMPLE_MM), 1) + 1)
        x, y, _ = arc_step(x_mm, y_mm, heading_rad, curvature_per_mm, lengths)
        target_x, target_y = self.center_mm
        distances = np.hypot(x - target_x, y - target_y)
        at = int(distances.argmin())
        return float(lengths[at]), float(distances[at])

    def blocked(self, x_mm: float, y_mm: float, heading_rad: float, curvature_per_mm: float, length_mm: float) -> bool:
        """Return whether an arc leaves the workspace or touches an obstacle.

        Parameters
        ----------
        x_mm, y_mm : float
            Start of the arc (mm).
        heading_rad : float
            Heading at the start (rad).
        curvature_per_mm : float
            Curvature (1/mm), positive to the left.
        length_mm : float
            Length of the arc (mm).

        Returns
        -------
        bool
        """
        lengths = np.linspace(0.0, length_mm, max(int(length_mm / _SAMPLE_MM), 1) + 1)
        x, y, _ = arc_step(x_mm, y_mm, heading_rad, curvature_per_mm, lengths)
        return any(self.outside(*at) or self.touches(*at) for at in zip(x.tolist(), y.tolist(), strict=True))

    @cached_property
    def _obstacles(self) -> list[tuple[str, BaseGeometry]]:
        from shapely import prepare

        polygons: list[tuple[str, BaseGeometry]] = []
        for number, obstacle in enumerate(self.scenario.obstacles, start=1):
            polygon = obstacle.region()
            prepare(polygon)
            polygons.append((obstacle.name or f"obstacle {number}", polygon))
        return polygons


def state_of(scenario: Scenario, pose: Pose) -> tuple[int, int, int, int]:
    """Return the indices (x, y, heading, bevel) of the table state nearest to a pose."""
    (dx, dy), headings = scenario.grid.spacing_mm, scenario.motion.headings
    turn = round(pose.heading_rad / (2 * math.pi / headings)) % headings
    return round(pose.x_mm / dx), round(pose.y_mm / dy), turn, (pose.bevel + 1) // 2


@dataclass(frozen=True)
class Approach:
    """Decisions near the target of `scene`, for a needle with the estimated curvature `curvature_per_mm` (1/mm)."""

    scene: ScenarioGeometry
    curvature_per_mm: float

    def inside(self, pose: Pose) -> bool:
        """Return whether the tip is in the target."""
        distance = self.scene.target_distance_mm(pose.x_mm, pose.y_mm)
        return distance <= self.scene.scenario.target.radius_mm

    def done(self, pose: Pose) -> bool:
        """Return whether the tip is in the target and a further step would not bring the tip nearer to the centre."""
        return self.inside(pose) and self.closest(pose)[0] < 2 * NEARLY_MM

    def closest(self, pose: Pose) -> tuple[float, float]:
        """Return the length (mm) along the next step to its point closest to the centre, and the distance (mm)."""
        step = self.scene.step_mm(pose.x_mm, pose.y_mm)
        bend = pose.bevel * self.curvature_per_mm
        return self.scene.closest(pose.x_mm, pose.y_mm, pose.heading_rad, bend, step)

    def length_mm(self, pose: Pose, room_mm: float) -> tuple[float, bool]:
        """Return the length of the next step, and whether this step is the last one.

        The last step ends at `room_mm`, or in the target at the point closest to the centre.

        Parameters
        ----------
        pose : Pose
            Pose of the tip.
        room_mm : float
            Largest length (mm).

        Returns
        -------
        tuple of float and bool
            Length (mm), and whether the step is the last one.
        """
        step = self.scene.step_mm(pose.x_mm, pose.y_mm)
        along, distance = self.closest(pose)
        if room_mm < step:
            return room_mm, True
        if NEARLY_MM <= along < step and distance <= self.scene.scenario.target.radius_mm:
            return along, True
        return step, False

    def near(self, pose: Pose) -> bool:
        """Return whether the rim of the target is at most two steps away."""
        scene = self.scene
        reach = scene.scenario.target.radius_mm + 2 * scene.step_mm(pose.x_mm, pose.y_mm)
        return scene.target_distance_mm(pose.x_mm, pose.y_mm) <= reach

    def beside(self, pose: Pose) -> tuple[Pose, float] | None:
        """Return start pose and length (mm) of a last step that ends beside the target, for the better of both bevels.

        Returns None if the target is not near, if the step would bring the tip nearer to the centre by less than 0.1
        mm, or if the step would leave the workspace or touch an obstacle.
        """
        if not self.near(pose):
            return None
        best = min((pose, pose._replace(bevel=-pose.bevel)), key=lambda sided: self.closest(sided)[1])
        along, distance = self.closest(best)
        gain = self.scene.target_distance_mm(pose.x_mm, pose.y_mm) - distance
        bend = best.bevel * self.curvature_per_mm
        if gain < GAIN_MM or self.scene.blocked(best.x_mm, best.y_mm, best.heading_rad, bend, along):
            return None
        return best, along
