"""The check of a plan: what the grid does not resolve is said, with the setting that helps."""

from dataclasses import replace

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import ScenarioError
from needleplan.planning import heading_refinement, resolution, what_helps
from needleplan.scenario import Needle, Scenario, Target, TipMotion, Transition, Workspace


def open_scene(**parts: object) -> Scenario:
    scene = Scenario(workspace=Workspace(60.0, 40.0), target=Target((50.0, 20.0), 2.0), needle=Needle(40.0))
    return replace(scene, **parts)  # type: ignore[arg-type]


def checked(scenario: Scenario) -> npl.planning.Resolution:
    table = npl.plan(scenario)
    return resolution(table, table.best_entry())


def test_the_defaults_keep_their_promise() -> None:
    found = checked(open_scene())
    assert found.warnings == ()
    assert abs(found.predicted - found.realised.value) < 0.03


def test_a_target_below_a_cell_is_not_resolved() -> None:
    table = npl.plan(open_scene(target=Target((50.0, 20.0), 0.05)))
    found = table.resolution
    assert found == resolution(table, table.best_entry())
    assert found.target_cells < 0.2
    assert found.warnings[0].startswith("the target is 0.0")
    assert "no grid resolves it" in found.warnings[0]
    assert any("500 executions realise" in warning for warning in found.warnings)


def test_a_gap_below_two_cells_is_not_resolved() -> None:
    walls = tuple(
        npl.Obstacle([(30.0, low), (33.0, low), (33.0, high), (30.0, high)]) for low, high in ((0, 19.4), (20.6, 40))
    )
    found = checked(open_scene(obstacles=walls, motion=TipMotion(tip_noise=(1.0,))))
    assert 1.2 <= found.passage_mm < 1.6
    assert any("narrowest passage" in warning and "grid.refinement = 2" in warning for warning in found.warnings)


def test_headings_are_raised_until_the_noise_is_that_of_the_scenario() -> None:
    motion = TipMotion(24, (0.6, 0.2), step_mm=4.0, tip_noise_step_deg=3.0)
    scenario = open_scene(motion=motion)
    assert heading_refinement(scenario) == 3
    table = npl.plan(scenario)
    assert table.values.shape == (61, 41, 72, 2)
    assert resolution(table, table.best_entry()).noise_ratio == pytest.approx(1.0)
    kept = replace(scenario, grid=replace(scenario.grid, heading_refinement=1))
    table = npl.plan(kept)
    assert table.values.shape == (61, 41, 24, 2)
    assert any("variance of tip_noise" in warning for warning in resolution(table, table.best_entry()).warnings)
    fine = open_scene(motion=replace(motion, tip_noise_step_deg=0.01))
    with pytest.raises(ScenarioError, match=r"motion\.headings = 24: must be at least 28461"):
        npl.plan(fine)


def test_a_thick_needle_keeps_its_distance() -> None:
    wall = npl.Obstacle([(30.0, 0.0), (33.0, 0.0), (33.0, 20.0), (30.0, 20.0)])
    thin, thick = (
        npl.plan(open_scene(obstacles=(wall,), needle=Needle(40.0, diameter_mm=diameter))) for diameter in (None, 2.0)
    )
    grown = npl.plan(open_scene(obstacles=(replace(wall, margin_mm=1.0),)))
    np.testing.assert_array_equal(thick.values, grown.values)
    assert (thick.success != thin.success).any()


def test_the_remedy_goes_beyond_the_settings() -> None:
    scenario = open_scene()
    grid = replace(scenario.grid, success_refinement=3)
    assert what_helps(replace(scenario, grid=grid)) == "grid.refinement = 2 brings them closer"
    grid = replace(grid, refinement=3)
    assert what_helps(replace(scenario, grid=grid)) == "half of grid.spacing_mm, [0.5, 0.5], brings them closer"
    nearest = replace(scenario.grid, transition=Transition.NEAREST)
    assert "interpolated" in what_helps(replace(scenario, grid=nearest))
