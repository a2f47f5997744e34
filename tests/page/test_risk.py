"""Distances from obstacles that the page shows."""

from dataclasses import replace

import numpy as np
import pytest

import needleplan as npl
from needleplan.page._recorded import nearest_risk, risk_distances


def test_the_nearest_risk_is_the_clearance_of_the_path(table: npl.PolicyTable) -> None:
    path = table.path(table.best_entry())
    risk = nearest_risk(table.scenario, path.points_mm)
    assert risk
    assert risk["distance_mm"] == pytest.approx(path.clearance_mm, abs=0.05)
    rows = risk_distances(table.scenario, path.points_mm)
    assert rows.shape == (len(table.scenario.obstacles), len(path.points_mm))
    inside = np.array([[*table.scenario.obstacles[0].region().representative_point().coords[0]]])
    assert risk_distances(table.scenario, inside)[0, 0] == 0
    assert nearest_risk(replace(table.scenario, obstacles=()), path.points_mm) is None
