"""The scenario as a moving tip meets it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import needleplan as npl
from needleplan.control import ScenarioGeometry
from needleplan.scenario import Obstacle, Scenario

FOUR = Scenario.read("four_obstacles")


@settings(max_examples=200, deadline=None)
@given(x=st.one_of(st.floats(0, 120), st.integers(0, 120)), y=st.one_of(st.floats(0, 80), st.integers(0, 80)))
def test_the_table_is_asked_at_the_nearest_free_grid_point_of_the_cell(x: float, y: float) -> None:
    """A slow twin: of all grid points at most one spacing away in x and in y."""
    scene = ScenarioGeometry(FOUR)
    # The tip is at a free point. One in an obstacle is in one cell all the same, unless it is on a line of the grid.
    assume(not scene.touches(x, y) or not (float(x).is_integer() or float(y).is_integer()))
    asked = scene.decided_at(x, y)
    around = [(i, j) for i in range(121) for j in range(81) if abs(i - x) <= 1 and abs(j - y) <= 1]
    distances = {at: math.hypot(at[0] - x, at[1] - y) for at in around}
    free = {at: distance for at, distance in distances.items() if not scene.touches(*at)}
    nearest = min(distances.values())
    if asked == (x, y):
        assert not free or min(free.values()) == pytest.approx(nearest)
    else:
        assert asked in free
        assert math.hypot(asked[0] - x, asked[1] - y) == pytest.approx(min(free.values()))
        assert any(at not in free for at, distance in distances.items() if distance == nearest)


def test_beside_an_obstacle_there_is_a_decision_all_the_same() -> None:
    """The tip is free 0.4 mm beside an obstacle that a grid point is in: the loop does not give up for that."""
    scenario = replace(FOUR, obstacles=(Obstacle([(29.5, 10), (31, 10), (31, 40), (29.5, 40)]),))
    table, scene = npl.plan(scenario), ScenarioGeometry(scenario)
    x, y = 29.55 - 0.05 - 0.001, 45.0
    assert scene.decided_at(x, y) == (x, y)
    x, y = 31.4, 20.2
    assert not scene.touches(x, y)
    assert scene.touches(31, 20)
    assert table.lookup(x, y, 0.0, 1).success == 0
    assert scene.decided_at(x, y) == (32, 20)
    assert np.isclose(table.lookup(*scene.decided_at(x, y), 0.0, 1).success, table.lookup(32, 20, 0, 1).success)
    assert table.lookup(32, 20, 0.0, 1).success > 0.5
