"""Poses of the tip in the frame of a lattice."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["SpacePose"]


class SpacePose(NamedTuple):
    """Position (mm) and unit tangent of the tip in the frame of the lattice; `SpaceFrame` converts from and to RAS."""

    x_mm: float
    y_mm: float
    z_mm: float
    dx: float
    dy: float
    dz: float

    @property
    def position_mm(self) -> tuple[float, float, float]:
        """The position."""
        return self.x_mm, self.y_mm, self.z_mm

    @property
    def tangent(self) -> tuple[float, float, float]:
        """The unit tangent."""
        return self.dx, self.dy, self.dz

    def __str__(self) -> str:
        heading, elevation = (math.degrees(angle_rad) for angle_rad in self.angles_rad)
        return (
            f"lattice x {self.x_mm:.2f} mm, y {self.y_mm:.2f} mm, z {self.z_mm:.2f} mm, heading {heading:.1f} deg, "
            f"elevation {elevation:.1f} deg"
        )

    @property
    def angles_rad(self) -> tuple[float, float]:
        """Heading of the tangent from +x to +y, and elevation towards +z."""
        return math.atan2(self.dy, self.dx), math.atan2(self.dz, math.hypot(self.dx, self.dy))
