"""The straight action against the slow oracle: tables, executions and predictions at exact poses."""

import math
import os
from typing import Any

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from oracle_arc import Problem, follow_pieces
from oracle_cases import case, mirrored, with_straight
from oracle_mdp import build, solve
from oracle_rollout import rollout

from tests.planning import test_against_oracle as uniform
from tests.planning.test_clearance import priced
from tests.planning.test_predictions import assert_look_ahead
from tests.planning.test_tissues import METHODS, layered

few = settings(uniform.random_cases, max_examples=6)


@st.composite
def straight(draw: st.DrawFn, transition: str | None = None) -> dict[str, Any]:
    """A small scenario with straight steps; some with layers and tissues, a price of clearance, or a free step length.

    The pages leave the mean curvature of a planned step open, so a step length comes only with one radius everywhere.
    """
    scenario = draw(st.one_of(uniform.scenarios(transition), layered(transition), priced(transition)))
    share = draw(st.one_of(st.sampled_from([0.0, 1.0]), st.integers(1, 99).map(lambda number: number / 100)))
    price = draw(st.one_of(st.none(), st.integers(1, 24).map(lambda number: number / 8)))
    motion = {}
    if not scenario["tissue"] and not scenario["needle"]["layer"] and draw(st.booleans()):
        longest = int(1400 * scenario["needle"]["curvature_radius_mm"])
        motion["step_mm"] = draw(st.integers(900, max(1000, min(3000, longest)))) / 1000 + 0.000213
    if draw(st.booleans()):
        reach = len(scenario["motion"]["tip_noise"]) - 1
        motion["tip_noise_step_deg"] = draw(st.integers(5, 150 // max(reach, 1))) + 0.37
    return with_straight(scenario, share, price, **motion)


@pytest.mark.study
@given(scenario=straight(), method=METHODS, partitions=uniform.PARTITIONS, priority=uniform.PRIORITIES)
@settings(uniform.random_cases, max_examples=int(os.environ.get("NEEDLEPLAN_EXAMPLES", "8")))
def test_tables_are_those_of_the_oracle(
    scenario: dict[str, Any], method: str, partitions: list[int], priority: str
) -> None:
    mdp, solution = uniform.oracle_of(scenario)
    table = uniform.planned(scenario, method=method, partitions=partitions, priority=priority)
    event("straight steps" if np.any(solution.policy == 2) else "no straight step")
    uniform.assert_agrees(table, mdp, solution)


@pytest.mark.slow
def test_a_success_whose_steps_have_no_bound_has_none() -> None:
    """Steps of 0.47 mm on cells of 0.5 mm by 1 mm: by magnitudes of cubic weights, steps are infinitely many."""
    scenario = case(
        (5.0, 7.0),
        target=(1.22, 1.84, 0.503),
        rho=1.200377,
        headings=16,
        samples=1,
        spacing=(0.5, 1.0),
        transition="interpolated",
        objective=(1.0, 22.0, 193.0, 95.0, 0.8),
    )
    scenario = with_straight(scenario, 1.0, None)
    assert uniform.planned(scenario).stats.success_error_bound == 1.0


@pytest.mark.slow
@given(scenario=straight(transition="interpolated"), seed=st.integers(0, 2**31))
@settings(few, max_examples=5)
def test_executions_go_as_the_oracles(scenario: dict[str, Any], seed: int) -> None:
    """Success, cost and lengths of look-up executions: the same table, independent randomness."""
    mdp, solution = uniform.oracle_of(scenario)
    table = uniform.planned(scenario)
    used = np.where((solution.success < 1) & (table.policy == 2), solution.success, 0)
    i, j, k, b = np.unravel_index(np.argmax(used), used.shape)
    event("straight first step" if used[i, j, k, b] > 0 else "no straight first step")
    start = (i * mdp.problem.dx, j * mdp.problem.dy, k * mdp.problem.alpha, 2 * int(b) - 1)
    assert_executions(table, mdp.problem, start, seed)


def assert_executions(table: Any, problem: Problem, start: tuple[float, float, float, int], seed: int) -> None:
    runs = 2_000
    ours = rollout(problem, start, runs, seed, policy=table.policy)
    theirs = table.rollout(start, runs=runs, seed=seed, nearest=True)
    share = max(ours.success * (1 - ours.success), 1e-3)
    assert theirs.success == pytest.approx(ours.success, abs=5 * math.sqrt(2 * share / runs))
    means = (
        (ours.cost, theirs.mean_cost), (ours.length, theirs.mean_length_mm),
        (ours.straight, theirs.mean_straight_mm), (ours.turns, theirs.mean_turns),
    )  # fmt: skip
    for mine, its in means:
        assert its == pytest.approx(mine.mean(), rel=1e-6, abs=5 * mine.std() * math.sqrt(2 / runs) + 1e-9)


def soft(share: float, step_mm: float | None, **motion: Any) -> dict[str, Any]:
    """Layers and a tissue of several radii, with a step length also a straight one, and cheap straight steps."""
    scenario = case(
        (24.0, 16.0),
        target=(20.03, 8.3, 1.503),
        rho=6.000377,
        headings=20,
        obstacles=([[10.25, 0], [13.25, 0], [12.25, 5.5]], [[10.25, 16], [13.25, 16], [12.25, 10.5]]),
        noise=(0.7, 0.1, 0.05),
        samples=3,
        transition="interpolated",
        objective=(1.0, 2.0, 100.0, 80.0, 1.0),
        layers=((5.3, 4.1), (8.6, 9.3 if step_mm is None else math.inf)),
        tissues=(([[14.2, 3.1], [17.3, 3.1], [17.3, 12.2], [14.2, 12.2]], 5.2),),
    )
    return with_straight(scenario, share, 0.9, **({} if step_mm is None else {"step_mm": step_mm}), **motion)


@pytest.mark.parametrize("step_mm", [None, 2.3])
@pytest.mark.parametrize("share", [0.0, 0.35])
def test_executions_through_tissues_go_as_the_oracles(share: float, step_mm: float | None) -> None:
    scenario = soft(share, step_mm)
    table = uniform.planned(scenario)
    start = (0.3, 7.6, 0.1, 1)
    found = table.rollout(start, runs=1000, nearest=True)
    assert 0.1 < found.mean_straight_mm / found.mean_length_mm < 0.9
    assert_executions(table, uniform.problem_of(scenario), start, 5)


@pytest.mark.parametrize("step_mm", [None, 2.3])
def test_steps_of_a_path_bend_as_the_tissues_under_them(step_mm: float | None) -> None:
    """Without arc_samples, a step is four pieces with the radius at the middle of each."""
    scenario = soft(0.35, step_mm)
    problem = uniform.problem_of(scenario | {"motion": scenario["motion"] | {"arc_samples": 4}})
    del scenario["motion"]["arc_samples"]
    path = uniform.planned(scenario).path((0.3, 7.6, 0.1, 1), noise_seed=3)
    x, y, theta, bevel = path.poses[:-1].T
    actions = np.asarray(path.actions).astype(int)
    assert {0, 2} <= {*actions.tolist()}
    for action, steps in ((0, problem), (2, problem.straight)):
        assert steps is not None
        at = np.flatnonzero(actions[:-1] == action)
        _, *reached = follow_pieces(steps, x[at], y[at], theta[at], bevel[at].astype(int), ahead=0.5)
        np.testing.assert_allclose(np.stack(reached[:2], axis=1), path.poses[at + 1, :2], rtol=1e-9, atol=1e-9)
        noise = (path.poses[at + 1, 2] - reached[2]) / problem.eta
        np.testing.assert_allclose(noise, np.round(noise), atol=1e-9)


@pytest.mark.parametrize("samples", [None, 8])
@pytest.mark.parametrize("transition", ["nearest", "interpolated"])
def test_a_line_along_an_edge_touches_it(transition: str, samples: int | None) -> None:
    """Along the top of one obstacle and to the corner of another. The borders belong to the workspace."""
    scenario = case(
        (16.0, 8.0),
        target=(14.0, 4.0, 1.003),
        rho=6.000377,
        headings=8,
        obstacles=([[5.3, 1], [9.7, 1], [9.7, 3], [5.3, 3]], [[7, 5], [8.2, 7], [5.8, 7]]),
        samples=8,
        transition=transition,
        objective=(1.0, 4.0, 100.0, 80.0, 1.0),
    )
    scenario = with_straight(scenario, 0.0, 0.01, step_mm=4.0)
    mdp = build(uniform.problem_of(scenario))
    solution = solve(mdp, 1e-9)
    if samples is None:
        del scenario["motion"]["arc_samples"]
    table = uniform.planned(scenario, tolerance=1e-4)
    # From x = 1 to the right along y = 4: three lines of 4 mm between the obstacles, and the target.
    assert (table.policy[1, 4, 0] == 2).all()
    np.testing.assert_allclose(table.values[1, 4, 0], 3 * 4 * 0.01, atol=1e-3)
    # Along y = 3 the second line touches the edge, along y = 5 the corner.
    assert (table.values[1, (3, 5), 0] > 1).all()
    # A line along a border of the workspace, and up to one, is no exit.
    assert (np.abs(table.values[:13, (0, -1), 0] - 80.04) > 0.03).all()
    if samples is not None:
        uniform.assert_agrees(table, mdp, solution)


@pytest.mark.slow
@given(scenario=straight())
@few
def test_it_is_the_look_ahead_of_the_oracle(scenario: dict[str, Any]) -> None:
    assert_look_ahead(scenario)


@given(scenario=straight(), method=METHODS)
@settings(few, max_examples=5)
def test_a_mirrored_scenario_has_the_mirrored_table(scenario: dict[str, Any], method: str) -> None:
    solution = uniform.oracle_of(scenario)[1]
    one, other = uniform.planned(scenario, method=method), uniform.planned(mirrored(scenario), method=method)
    back = np.roll(other.values[:, ::-1, ::-1, ::-1], 1, axis=2)
    allowed = one.stats.error_bound + other.stats.error_bound + uniform.float32_allowance(solution)
    assert np.max(np.abs(one.values - back)) <= allowed
