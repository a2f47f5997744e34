"""Planned curvature of the needle at a position: of a scenario in the plane, or in 3D."""

from __future__ import annotations

import math
from typing import Protocol

from needleplan.anatomy import SpaceScenario
from needleplan.scenario import PlaneCurvatureMap, Scenario

__all__ = ["CurvatureMap", "SpaceCurvatureMap", "curvature_map"]


class CurvatureMap(Protocol):
    """Curvature (1/mm) by position (mm)."""

    def at(self, x_mm: float, y_mm: float, z_mm: float) -> float:
        """Return the curvature (1/mm) at a position."""


class SpaceCurvatureMap:
    """Planned curvature (1/mm) of a scenario in 3D, by the tissue of the nearest grid point."""

    def __init__(self, scenario: SpaceScenario) -> None:
        self._spacing_mm = scenario.grid.frame.spacing_mm
        self._tissues, self._most = scenario.grid.tissues, [each - 1 for each in scenario.grid.frame.shape]
        self._curvatures = [1 / radius for radius in scenario.grid.radii_mm]

    def at(self, x_mm: float, y_mm: float, z_mm: float) -> float:
        """Return the curvature (1/mm) at the grid point nearest to a position."""
        i, j, k = (
            min(max(math.floor(x / self._spacing_mm + 0.5), 0), most)
            for x, most in zip((x_mm, y_mm, z_mm), self._most, strict=True)
        )
        return self._curvatures[int(self._tissues[i, j, k])]


def curvature_map(scenario: Scenario | SpaceScenario) -> CurvatureMap:
    """Return the planned curvature of a scenario."""
    return SpaceCurvatureMap(scenario) if isinstance(scenario, SpaceScenario) else PlaneCurvatureMap(scenario)
