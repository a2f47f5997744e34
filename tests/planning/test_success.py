"""Success on a grid finer than that of the policy: against the slow oracle, and against what is realised."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle_arc import FREE
from oracle_mdp import build, success_of

import needleplan as npl
from needleplan.errors import ScenarioError
from needleplan.planning import _planner as planner
from needleplan.scenario import Scenario
from tests.planning import test_against_oracle as plain


def with_grid(scenario: dict[str, Any], **grid: Any) -> dict[str, Any]:
    return scenario | {"grid": scenario["grid"] | grid}


@pytest.mark.study
@given(scenario=plain.scenarios("interpolated"), times=st.sampled_from([2, 3]))
@settings(plain.random_cases, max_examples=6)
def test_it_is_what_executions_of_the_table_do_on_the_finer_grid(scenario: dict[str, Any], times: int) -> None:
    dx, dy = scenario["grid"]["spacing_mm"]
    mdp = build(plain.problem_of(with_grid(scenario, spacing_mm=[dx / times, dy / times])))
    assume(plain.clearance(mdp) > plain.MARGIN_MM)
    coarse = plain.planned(with_grid(scenario, success_refinement=1))
    table = plain.planned(with_grid(scenario, success_refinement=times))
    np.testing.assert_array_equal(table.values, coarse.values)
    np.testing.assert_array_equal(table.policy, coarse.policy)
    problem = mdp.problem
    axes = np.arange(problem.nx) * problem.dx, np.arange(problem.ny) * problem.dy
    headings, bevels = np.arange(problem.headings) * problem.alpha, np.array((-1, 1))
    poses = np.stack([axis.ravel() for axis in np.meshgrid(*axes, headings, bevels, indexing="ij")], axis=-1)
    actions = coarse.lookup_many(poses).action.reshape(problem.nx, problem.ny, problem.headings, 2)
    free = (mdp.kind == FREE)[:, :, None, None]
    expected = success_of(mdp, np.where(free, actions, 0).astype(np.uint8))
    # Where two actions cost the same, rounding decides.
    assert np.quantile(np.abs(table.success - expected[::times, ::times]), 0.99) < 1e-3


@pytest.mark.parametrize("width_mm", [12.2, 12.4])
def test_a_grid_need_not_end_where_the_workspace_ends(small: Scenario, width_mm: float) -> None:
    """12.4 mm ends beyond the workspace at 1.25 mm, where the finer grid has no point."""
    scene = replace(
        small,
        workspace=replace(small.workspace, width_mm=width_mm, height_mm=10.0),
        obstacles=(),
        target=replace(small.target, center_mm=(9.0, 5.0)),
        grid=replace(small.grid, spacing_mm=(1.25, 1.25), transition="interpolated", success_refinement=7),
    )
    table = npl.plan(scene)
    assert table.success.shape == table.values.shape
    assert 0.1 < table.success[:9].max() <= 1


@pytest.mark.study
def test_predictions_come_closer_to_what_is_realised() -> None:
    """From twelve entries of a scenario at 2 mm."""
    scenario = Scenario.read("prostate")
    starts = [(0.0, 10.0 * k, heading) for k in range(1, 7) for heading in (-0.35, 0.0)]
    gaps = []
    for times in (1, 3):
        grid = replace(scenario.grid, spacing_mm=(2.0, 2.0), success_refinement=times)
        table = npl.plan(replace(scenario, grid=grid))
        results = [table.rollout(start, runs=5000, seed=1) for start in starts]
        gaps.append(np.mean([abs(each.predicted_success - each.success) for each in results]))
    assert gaps[1] < 0.6 * gaps[0]


@pytest.mark.parametrize("value", [0, 11, -3, 1.5, "3", True])
def test_other_refinements_are_refused(small: Scenario, value: Any) -> None:
    with pytest.raises(ScenarioError, match=r"success_refinement.*whole number from 1 to 9"):
        replace(small.grid, success_refinement=value)


def test_the_finer_grid_must_fit_into_memory(small: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    small = replace(small, grid=replace(small.grid, transition="interpolated", success_refinement=1))
    monkeypatch.setattr(planner, "available_bytes", lambda: small.states * 100)
    npl.plan(small)
    with pytest.raises(ScenarioError, match=r"with success_refinement = 5, and needs about"):
        npl.plan(replace(small, grid=replace(small.grid, success_refinement=5)))
