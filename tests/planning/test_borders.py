"""The border of the workspace: grids that do not end on it, and poses beyond it."""

import math
from dataclasses import replace

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import PoseError
from needleplan.planning import Edge, Outcome
from needleplan.scenario import Grid, Needle, Obstacle, Scenario, Target, Transition, Workspace


def scene(width_mm: float, height_mm: float, transition: str = "interpolated", *obstacles: Obstacle) -> Scenario:
    grid = Grid((1.0, 1.0), Transition(transition))
    return Scenario(Workspace(width_mm, height_mm), Target((50, 25), 3), Needle(40), obstacles, grid=grid)


@pytest.mark.parametrize(
    ("size_mm", "points"),
    [(40.0, 41), (40.1, 42), (40.5, 42), (40.6, 42), (41.5, 43), (40 + 1e-10, 41), (40 - 1e-10, 41)],
)
def test_grid_points_cover_the_workspace(size_mm: float, points: int) -> None:
    scenario = scene(size_mm + 20, size_mm)
    assert scenario.shape[:2] == (points + 20, points)
    assert len(scenario.y_mm) == points


@pytest.mark.parametrize("transition", Transition)
@pytest.mark.parametrize("height_mm", [40.0, 40.2, 40.5, 40.6, 40.9])
def test_predictions_at_the_border_are_near_what_happens(transition: str, height_mm: float) -> None:
    table = npl.plan(scene(60.0, height_mm, transition))
    for heading in (0.0, -1.0, -3.0, -8.0):
        for bevel in (-1, 1):
            found = table.rollout((0.0, height_mm, math.radians(6 * heading), bevel), runs=2000)
            assert found.success > 0.85
            assert found.predicted_success == pytest.approx(found.success, abs=0.05)


def test_success_on_a_finer_grid_agrees_at_the_border() -> None:
    scenario = scene(60.0, 40.6)
    table = npl.plan(replace(scenario, grid=replace(scenario.grid, success_refinement=3)))
    found = table.rollout((0.0, 40.6, -0.1, -1), runs=2000)
    assert found.predicted_success == pytest.approx(found.success, abs=0.05)


@pytest.mark.parametrize("edge", Edge)
@pytest.mark.parametrize("size_mm", [(60.5, 40.0), (60.0, 40.5), (60.5, 40.5), (60.3, 40.8)])
def test_entries_lie_on_the_border_and_can_be_executed(edge: Edge, size_mm: tuple[float, float]) -> None:
    table = npl.plan(scene(*size_mm))
    best = table.best_entry(edge)
    assert best.success > 0.8
    assert 0 <= best.pose.x_mm <= size_mm[0]
    assert 0 <= best.pose.y_mm <= size_mm[1]
    assert table.path(best).outcome is Outcome.TARGET


@pytest.mark.parametrize("beyond_mm", [1e-6, 0.4, 0.6])
@pytest.mark.parametrize("place", [(0, -1), (-1, 0), (60.2, 1), (1, 40.6)])
def test_poses_beyond_the_border_are_refused(place: tuple[float, float], beyond_mm: float) -> None:
    table = npl.plan(scene(60.2, 40.6))
    on = [min(max(coordinate, 0.0), size) for coordinate, size in zip(place, (60.2, 40.6), strict=True)]
    table.lookup(*on, 0.0, 1)
    outward = [(-1 if c < 0 else 0) or (1 if c == size else 0) for c, size in zip(place, (60.2, 40.6), strict=True)]
    pose = (*(c + side * beyond_mm for c, side in zip(on, outward, strict=True)), 0.0, 1)
    for call in (table.path, table.rollout, table.lookup, table.start, lambda row: table.lookup_many([row])):
        with pytest.raises(PoseError, match="workspace"):
            call(pose)


def test_an_obstacle_beyond_the_border_is_on_the_grid() -> None:
    """Its grid points stand for the border, on which the obstacle lies too."""
    wall = Obstacle([(20, 40.55), (30, 40.55), (30, 45), (20, 45)])
    table = npl.plan(scene(60.0, 40.6, "interpolated", wall))
    assert table.success[25, 41].max() == 0
    assert table.success[15, 41].max() > 0.5


@pytest.mark.parametrize("transition", Transition)
def test_no_entry_lies_in_an_obstacle(transition: str) -> None:
    """Every entry is hopeless, and an obstacle costs nothing more with nearest transitions."""
    ring = Obstacle([(10, 0), (15, 0), (15, 40), (10, 40)])
    slab = Obstacle([(-1, 5), (3, 5), (3, 35), (-1, 35)])
    table = npl.plan(scene(60.0, 40.0, transition, ring, slab))
    best = table.best_entry()
    assert best.success == 0
    assert best.pose.y_mm < 5 or best.pose.y_mm > 35
    with pytest.raises(PoseError, match=r'edge = "left": must have a position outside of all obstacles'):
        table.best_entry(y_mm=20.0)
    assert np.isfinite(best.value)
