"""Planned curvature of the needle by position, tabulated for loops that ask once per step."""

from __future__ import annotations

import math

from needleplan.scenario._scenario import Scenario

__all__ = ["PlaneCurvatureMap"]

# Largest spacing (mm) of the grid on which the planned curvature is tabulated.
_SPACING_MM = 0.25


class PlaneCurvatureMap:
    """Planned curvature (1/mm) of a scenario, tabulated on a grid of at most 0.25 mm; constant beyond the edges.

    A look-up takes a microsecond; `Scenario.radius_mm` tests the polygon of each tissue.

    Parameters
    ----------
    scenario : Scenario
        Scenario in the plane.
    """

    def __init__(self, scenario: Scenario) -> None:
        sizes = (scenario.workspace.width_mm, scenario.workspace.height_mm)
        self._steps = [size / max(math.ceil(size / _SPACING_MM), 1) for size in sizes]
        import numpy as np

        x, y = (np.arange(round(size / step) + 1) * step for size, step in zip(sizes, self._steps, strict=True))
        self._table: list[list[float]] = (1 / scenario.radius_mm(x[:, None], y[None, :])).tolist()

    def at(self, x_mm: float, y_mm: float, z_mm: float = 0.0) -> float:  # noqa: ARG002
        """Return the curvature (1/mm) at the grid point nearest to a position.

        Parameters
        ----------
        x_mm, y_mm, z_mm : float
            Position (mm); z does not matter.

        Returns
        -------
        float
        """
        table = self._table
        row = table[min(max(round(x_mm / self._steps[0]), 0), len(table) - 1)]
        return row[min(max(round(y_mm / self._steps[1]), 0), len(row) - 1)]
