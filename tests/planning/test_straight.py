"""The straight action: closed forms, executions, all methods, and what is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import needleplan as npl
from needleplan.control._preconditions import require_fitting
from needleplan.errors import ScenarioError, TableError
from needleplan.planning import Action, Outcome
from needleplan.scenario import Grid, Layer, Method, Needle, Objective, Obstacle, Scenario, Target, TipMotion, Workspace

SHARE = 0.1


def corridor(share: float | None, price: float | None = None, *, noise: tuple[float, ...] = (1.0,)) -> Scenario:
    """A target straight ahead of the left edge."""
    return Scenario(
        Workspace(100, 40), Target((80, 20), 2), Needle(40), [],
        TipMotion(60, noise, step_mm=4.0, straight_curvature_share=share), Grid((1.0, 1.0), "interpolated"),
        Objective(straight_per_mm=price),
    )  # fmt: skip


def passage(share: float | None = SHARE, price: float | None = 1.3) -> Scenario:
    """Two obstacles, tip noise, and a target between them."""
    scenario = corridor(share, price, noise=(0.466, 0.24, 0.027))
    gates = Obstacle(center_mm=(45, 8), radius_mm=8), Obstacle(center_mm=(45, 34), radius_mm=8)
    return replace(scenario, obstacles=gates, grid=replace(scenario.grid, refinement=2))


def test_straight_ahead_it_costs_its_price_and_nothing_else() -> None:
    table = npl.plan(corridor(0.0, 0.75))
    # The target begins at 78 mm: 20 steps of 4 mm.
    assert table.lookup(0, 20, 0, 1).value == pytest.approx(20 * 4 * 0.75, rel=1e-6)
    path = table.path((0, 20, 0, 1))
    assert path.outcome is Outcome.TARGET
    assert set(path.actions.tolist()) == {Action.STRAIGHT.code}
    assert path.straight_mm == path.length_mm == pytest.approx(80)
    np.testing.assert_allclose(path.poses[:, 1:], [[20, 0, 1]] * len(path.poses), atol=1e-9)
    assert str(path) == "<Path: target after 80.0 mm in 20 steps, 0 turns, 80.0 mm straight>"


def test_without_a_price_a_millimetre_costs_as_much_as_any_other() -> None:
    assert npl.plan(corridor(0.0)).lookup(0, 20, 0, 1).value == pytest.approx(80, rel=1e-6)


def test_the_curvature_that_is_left_is_that_of_a_longer_radius() -> None:
    path = npl.plan(corridor(0.25, 0.01)).path((0, 10, 0.2, 1))
    straight = np.flatnonzero(path.actions == Action.STRAIGHT.code)
    turns = np.diff(path.poses[:, 2])[straight[straight < len(path.actions) - 1]]
    np.testing.assert_allclose(turns, path.poses[straight[: len(turns)], 3] * 4.0 / (40 / 0.25))
    steps = np.hypot(*np.diff(path.poses[:, :2], axis=0).T)[straight[:-1]]
    np.testing.assert_allclose(steps, 2 * 160 * math.sin(4 / 320))  # chords


def test_a_layer_has_its_own_curvature_left() -> None:
    scenario = replace(corridor(0.5, 0.01), needle=Needle(60, (Layer(40, 30),)))
    path = npl.plan(scenario).path((0, 12, 0.1, 1))
    turned = np.abs(np.diff(path.poses[:, 2]))
    before = (path.actions == Action.STRAIGHT.code) & (path.poses[1:, 0] < 40)
    behind = (path.actions == Action.STRAIGHT.code) & (path.poses[:-1, 0] > 40)
    behind[-1] = False  # ends in the target
    assert before.any()
    assert behind.any()
    np.testing.assert_allclose(turned[before], 4 / 120)
    np.testing.assert_allclose(turned[behind], 4 / 60)


def test_a_step_of_all_the_curvature_changes_nothing() -> None:
    plain, same = npl.plan(passage(None, None)), npl.plan(passage(1.0, 1.0))
    assert not np.any(same.policy == Action.STRAIGHT.code)
    np.testing.assert_array_equal(same.values, plain.values)
    np.testing.assert_array_equal(same.policy, plain.policy)
    np.testing.assert_array_equal(same.success, plain.success)


@pytest.mark.slow
def test_it_never_costs_more_and_is_used_where_it_pays() -> None:
    plain, table = npl.plan(passage(None, None)), npl.plan(passage())
    slack = plain.stats.error_bound + table.stats.error_bound
    assert np.all(table.values <= plain.values + slack)
    assert 0.01 < np.mean(table.policy == Action.STRAIGHT.code) < 0.9
    dear = npl.plan(passage(SHARE, 1e6))
    assert not np.any(dear.policy == Action.STRAIGHT.code)
    np.testing.assert_allclose(dear.values, plain.values, atol=slack)


@pytest.mark.study
def test_predictions_hold_for_executions() -> None:
    table = npl.plan(passage())
    random = np.random.default_rng(4)
    differences = []
    for y, heading in zip(random.uniform(8, 32, 12), random.uniform(-0.4, 0.4, 12), strict=True):
        found = table.rollout((0, y, heading), runs=4000)
        differences.append(found.success - found.predicted_success)
        # Failures cost 10,000 each: the tolerance is 3 points of them.
        assert found.mean_cost == pytest.approx(found.predicted_value, abs=300)
        assert 0 < found.mean_straight_mm < found.mean_length_mm
    assert np.abs(differences).max() < 0.03
    assert abs(np.mean(differences)) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("transition", ["nearest", "interpolated"])
def test_all_methods_agree(transition: str) -> None:
    scenario = passage()
    scenario = replace(scenario, grid=Grid((2.0, 2.0), transition))
    solver = replace(scenario.solver, partitions=(4, 2))
    tables = [
        npl.plan(replace(scenario, solver=replace(solver, method=method, priority=priority)))
        for method, priority in (
            (Method.SWEEP, "bound"), (Method.PPVI, "bound"), (Method.PPVI, "H2"), (Method.VALUE_ITERATION, "bound"),
        )
    ]  # fmt: skip
    assert np.any(tables[0].policy == Action.STRAIGHT.code)
    for table in tables[1:]:
        slack = table.stats.error_bound + tables[0].stats.error_bound
        np.testing.assert_allclose(table.values, tables[0].values, atol=slack)


@pytest.mark.slow
def test_a_file_keeps_it_and_the_finer_success_follows_it(tmp_path: Path) -> None:
    scenario = passage()
    table = npl.plan(replace(scenario, grid=replace(scenario.grid, refinement=None, success_refinement=3)))
    table.write(tmp_path / "straight.h5")
    again = npl.PolicyTable.read(tmp_path / "straight.h5")
    assert again.scenario.motion.straight_curvature_share == SHARE
    assert again.lookup(0, 20, 0, 1) == table.lookup(0, 20, 0, 1)
    assert str(Action.STRAIGHT) == "insert straight"


def test_a_policy_with_an_action_that_the_scenario_lacks_is_refused() -> None:
    table = npl.plan(corridor(None))
    policy = table.policy.copy()
    policy[0, 0, 0, 0] = 2
    with pytest.raises(TableError, match=r"policy = 2: must be 0 \(insert\) or 1 \(rotate, then insert\)$"):
        npl.PolicyTable(table.values, policy, table.success, table.stats, table.scenario)
    with pytest.raises(ValueError, match="policy = 2: must be an action of the lattice"):
        table.lattice.success(policy)


def test_the_figure_shows_straight_steps() -> None:
    axes = npl.plan(corridor(0.0, 0.75)).path((0, 20, 0, 1)).plot(Figure().subplots())
    assert "straight steps (20)" in axes.get_legend_handles_labels()[1]


def test_a_robot_can_insert_it() -> None:
    require_fitting(npl.plan(corridor(0.0)), "straight.h5")


@pytest.mark.parametrize(
    ("share", "price", "message"),
    [
        (None, 1.0, r"objective\.straight_per_mm = 1\.0: is a price of straight steps"),
        (0.0, 0.0, r"straight_per_mm = 0: must be above 0 if the discount is 1"),
        (1.5, None, r"straight_curvature_share = 1\.5: must be"),
        (-0.1, None, r"straight_curvature_share = -0\.1: must be"),
        (math.nan, None, r"straight_curvature_share = nan: must be"),
        (0.1, -1.0, r"straight_per_mm = -1\.0: must be"),
    ],
)
def test_mistakes_are_named(share: float | None, price: float | None, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        corridor(share, price)
