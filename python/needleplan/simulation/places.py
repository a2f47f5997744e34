"""Curvature by place, as a scenario has it: its needle, the layers of that and the tissues, on a fine grid."""

from __future__ import annotations

import math

from needleplan.scenario import Scenario

__all__ = ["PlannedCurvature"]

_SPACING_MM = 0.25


class PlannedCurvature:
    """The curvature (1/mm) that a scenario was planned with; looked up 0.25 mm apart, at its edges beyond them."""

    def __init__(self, scenario: Scenario) -> None:
        import numpy as np

        sizes = (scenario.workspace.width_mm, scenario.workspace.height_mm)
        self._steps = [size / max(math.ceil(size / _SPACING_MM), 1) for size in sizes]
        x, y = (np.arange(round(size / step) + 1) * step for size, step in zip(sizes, self._steps, strict=True))
        self._table: list[list[float]] = (1 / scenario.radius_mm(x[:, None], y[None, :])).tolist()

    def at(self, x_mm: float, y_mm: float) -> float:
        """Return the curvature at a place."""
        table = self._table
        row = table[min(max(round(x_mm / self._steps[0]), 0), len(table) - 1)]
        return row[min(max(round(y_mm / self._steps[1]), 0), len(row) - 1)]
