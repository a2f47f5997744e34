"""Planned curvature of the needle at a position: of a scenario in the plane, or in 3D."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from needleplan.anatomy import SpaceScenario
from needleplan.models.path import Vector
from needleplan.scenario import Scenario

__all__ = ["CurvatureMap", "PlaneCurvatureMap", "SpaceCurvatureMap", "curvature_map"]

# largest spacing (mm) of the grid on which the planned curvature is tabulated
_SPACING_MM = 0.25


class CurvatureMap(Protocol):
    """Curvature (1/mm) by position (mm)."""

    def at(self, position_mm: Vector) -> float:
        """Return the curvature (1/mm) at a position."""


class PlaneCurvatureMap:
    """Planned curvature (1/mm) of a scenario, tabulated on a grid of at most 0.25 mm; constant beyond the edges."""

    def __init__(self, scenario: Scenario) -> None:
        sizes = (scenario.workspace.width_mm, scenario.workspace.height_mm)
        self._steps = [size / max(math.ceil(size / _SPACING_MM), 1) for size in sizes]
        x, y = (np.arange(round(size / step) + 1) * step for size, step in zip(sizes, self._steps, strict=True))
        self._table: list[list[float]] = (1 / scenario.radius_mm(x[:, None], y[None, :])).tolist()

    def at(self, position_mm: Vector) -> float:
        """Return the curvature (1/mm) at the grid point nearest to a position; z does not matter."""
        table = self._table
        row = table[min(max(round(position_mm[0] / self._steps[0]), 0), len(table) - 1)]
        return row[min(max(round(position_mm[1] / self._steps[1]), 0), len(row) - 1)]


class SpaceCurvatureMap:
    """Planned curvature (1/mm) of a scenario in 3D, by the tissue of the nearest grid point."""

    def __init__(self, scenario: SpaceScenario) -> None:
        self._spacing_mm = scenario.grid.frame.spacing_mm
        self._tissues, self._most = scenario.grid.tissues, [each - 1 for each in scenario.grid.frame.shape]
        self._curvatures = [1 / radius for radius in scenario.grid.radii_mm]

    def at(self, position_mm: Vector) -> float:
        """Return the curvature (1/mm) at the grid point nearest to a position."""
        i, j, k = (
            min(max(math.floor(x / self._spacing_mm + 0.5), 0), most)
            for x, most in zip(position_mm, self._most, strict=True)
        )
        return self._curvatures[int(self._tissues[i, j, k])]


def curvature_map(scenario: Scenario | SpaceScenario) -> CurvatureMap:
    """Return the planned curvature of a scenario."""
    return SpaceCurvatureMap(scenario) if isinstance(scenario, SpaceScenario) else PlaneCurvatureMap(scenario)
