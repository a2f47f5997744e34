"""The straight action against the slow oracle: tables, executions and predictions at exact poses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from oracle_cases import mirrored, with_straight
from oracle_rollout import rollout

from tests.planning import test_against_oracle as uniform
from tests.planning.test_clearance import priced
from tests.planning.test_predictions import assert_look_ahead
from tests.planning.test_tissues import METHODS, layered

few, many = (settings(uniform.random_cases, max_examples=number) for number in (12, 250))


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


def assert_table_is_the_oracles(scenario: dict[str, Any], method: str, partitions: list[int], priority: str) -> None:
    mdp, solution = uniform.oracle_of(scenario)
    table = uniform.planned(scenario, method=method, partitions=partitions, priority=priority)
    event("straight steps" if np.any(solution.policy == 2) else "no straight step")
    uniform.assert_agrees(table, mdp, solution)


@given(scenario=straight(), method=METHODS, partitions=uniform.PARTITIONS, priority=uniform.PRIORITIES)
@few
def test_tables_are_those_of_the_oracle(
    scenario: dict[str, Any], method: str, partitions: list[int], priority: str
) -> None:
    assert_table_is_the_oracles(scenario, method, partitions, priority)


@pytest.mark.slow
@given(scenario=straight(), method=METHODS, partitions=uniform.PARTITIONS, priority=uniform.PRIORITIES)
@many
def test_many_tables_are_those_of_the_oracle(
    scenario: dict[str, Any], method: str, partitions: list[int], priority: str
) -> None:
    assert_table_is_the_oracles(scenario, method, partitions, priority)


@given(scenario=straight(transition="interpolated"), seed=st.integers(0, 2**31))
@settings(few, max_examples=5)
def test_executions_go_as_the_oracles(scenario: dict[str, Any], seed: int) -> None:
    """Success, cost and lengths of look-up executions: the same table, independent randomness."""
    mdp, solution = uniform.oracle_of(scenario)
    table, runs = uniform.planned(scenario), 20_000
    used = np.where((solution.success < 1) & (table.policy == 2), solution.success, 0)
    i, j, k, b = np.unravel_index(np.argmax(used), used.shape)
    event("straight first step" if used[i, j, k, b] > 0 else "no straight first step")
    start = (i * mdp.problem.dx, j * mdp.problem.dy, k * mdp.problem.alpha, 2 * int(b) - 1)
    ours = rollout(mdp, start, runs, seed, policy=table.policy)
    theirs = table.rollout(start, runs=runs, seed=seed, nearest=True)
    share = max(ours.success * (1 - ours.success), 1e-3)
    assert theirs.success == pytest.approx(ours.success, abs=5 * math.sqrt(2 * share / runs))
    means = (
        (ours.cost, theirs.mean_cost), (ours.length, theirs.mean_length_mm),
        (ours.straight, theirs.mean_straight_mm), (ours.turns, theirs.mean_turns),
    )  # fmt: skip
    for mine, its in means:
        assert its == pytest.approx(mine.mean(), rel=1e-6, abs=5 * mine.std() * math.sqrt(2 / runs) + 1e-9)


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
