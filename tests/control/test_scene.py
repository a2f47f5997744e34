"""The scenario as a moving tip meets it."""

import math
from dataclasses import replace

import pytest

import needleplan as npl
from needleplan.control import ScenarioGeometry
from needleplan.scenario import Obstacle, Scenario

FOUR = Scenario.read("four_obstacles")


def test_beside_an_obstacle_there_is_a_decision_all_the_same() -> None:
    """The tip is free 0.4 mm beside an obstacle that a grid point is in: the loop does not give up for that."""
    scenario = replace(FOUR, obstacles=(Obstacle([(29.5, 10), (31, 10), (31, 40), (29.5, 40)]),))
    table, scene = npl.plan(scenario), ScenarioGeometry(scenario)
    x, y = 31.4, 20.2
    assert not scene.touches(x, y)
    assert scene.touches(31, 20)
    assert table.lookup(x, y, 0.0, 1, nearest=True).success == 0
    assert table.lookup(x, y, 0.0, 1).success > 0.5


def test_a_target_that_is_pushed_ahead_moves_along_the_heading() -> None:
    scene = ScenarioGeometry(FOUR)
    x, y = FOUR.target.center_mm
    pushed = scene.pushed(math.pi / 2, 1.5)
    assert pushed.target_distance_mm(x, y + 1.5) == pytest.approx(0.0, abs=1e-12)
    along, distance = pushed.closest(x, y - 1.0, math.pi / 2, 0.0, 4.0)
    assert (along, distance) == (pytest.approx(2.5), pytest.approx(0.0, abs=1e-12))
    assert scene.target_distance_mm(x, y) == 0.0
