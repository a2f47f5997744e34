"""The target of a 3D plan where the push of the needle moves it, among the voxels of the anatomy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.anatomy import FREE, TARGET, SpaceScenario
from needleplan.models.path import Vector
from needleplan.planning import codes_along
from needleplan.signals import Array

__all__ = ["SpaceTarget"]


@dataclass(frozen=True, eq=False)
class SpaceTarget:
    """Target of `scenario`, which the needle has moved by the length `beyond_mm` (mm) along the unit vector `tangent`.

    Obstacles stay where they are. Positions are in the frame of the lattice.
    """

    scenario: SpaceScenario
    tangent: Vector
    beyond_mm: float

    @property
    def center_mm(self) -> Array:
        """Centre of the target (mm), shape (3,)."""
        return np.array(self.scenario.target_mm) + self._shift_mm

    def code(self, position_mm: Sequence[float]) -> int:
        """Return the voxel code of `AnatomyGrid` at a position."""
        points = np.array(position_mm[:3], float)
        return int(self._moved(self.scenario.codes(points), points))

    def codes_along(self, points_mm: Array) -> NDArray[Any]:
        """Return the codes at points along paths, (k, n, 3), as `planning.codes_along`."""
        return self._moved(codes_along(self.scenario, points_mm), points_mm)

    def distance_mm(self, position_mm: Sequence[float]) -> float:
        """Return the distance of a position from the centre of the target."""
        return math.dist(position_mm[:3], self.center_mm)

    def near(self, position_mm: Sequence[float]) -> bool:
        """Return whether the rim of the target is at most two steps away."""
        return self.distance_mm(position_mm) <= self.scenario.target_reach_mm + 2 * self.scenario.step_mm

    def outside_mm(self, position_mm: Sequence[float]) -> float:
        """Return the distance of a position from the nearest voxel of the target; 0 inside."""
        if self.code(position_mm) == TARGET:
            return 0.0
        grid = self.scenario.grid
        apart = np.abs(grid.target_points_mm + self._shift_mm - np.array(position_mm[:3])) - grid.voxel_mm / 2
        return float(np.linalg.norm(np.maximum(apart, 0.0), axis=1).min())

    @property
    def _shift_mm(self) -> Array:
        return self.beyond_mm * np.array(self.tangent)

    def _moved(self, codes: NDArray[Any], points_mm: Array) -> NDArray[Any]:
        """Return codes with the target moved: a point is in it if it was there before the push."""
        if not self.beyond_mm:
            return codes
        inside = self.scenario.codes(points_mm - self._shift_mm) == TARGET
        return np.where(np.isin(codes, (FREE, TARGET)), np.where(inside, TARGET, FREE), codes)
