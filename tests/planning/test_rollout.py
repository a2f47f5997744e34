"""Many executions with noise, and their statistics."""

from dataclasses import replace

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import PoseError
from needleplan.planning import Outcome, wilson
from needleplan.scenario import Grid, Scenario, Transition


@pytest.mark.parametrize("nearest", [False, True])
def test_rollouts_add_up(table: npl.PolicyTable, nearest: bool) -> None:
    start = table.best_entry().pose
    found = table.rollout(start, runs=2000, seed=3, nearest=nearest)
    assert sum(found.outcomes.values()) == found.runs == 2000
    assert found.success == found.outcomes[Outcome.TARGET] / 2000
    low, high = found.interval
    assert 0 <= low < found.success < high <= 1
    decision = table.lookup(*start, nearest=nearest)
    assert (found.predicted_success, found.predicted_value) == (decision.success, decision.value)
    assert found.mean_length_mm > 45
    assert found.mean_cost == pytest.approx(
        found.mean_length_mm + 4 * found.mean_turns + 10_000 * (1 - found.success), rel=0.01
    )


def test_prediction_is_near_what_happens(table: npl.PolicyTable) -> None:
    found = table.rollout(table.best_entry().pose, runs=5000)
    assert found.success == pytest.approx(found.predicted_success, abs=0.15)


def test_expected_length_and_turns_are_near_what_happens(small: Scenario) -> None:
    table = npl.plan(replace(small, grid=Grid((0.5, 0.5), Transition.INTERPOLATED)))
    expected = table.expectations()
    assert expected.length_mm.shape == expected.turns.shape == table.scenario.shape
    for start in (table.best_entry().pose, table.best_entry("bottom").pose):
        found = table.rollout(start, runs=5000)
        index = (
            round(start.x_mm / 0.5),
            round(start.y_mm / 0.5),
            round(start.heading_rad / (2 * np.pi / 36)) % 36,
            (start.bevel + 1) // 2,
        )
        assert expected.length_mm[index] == pytest.approx(found.mean_length_mm, rel=0.1)
        assert expected.turns[index] == pytest.approx(found.mean_turns, rel=0.25)
    assert expected.length_mm[100, 50].max() == 0  # in the target


def test_a_seed_gives_the_same_runs(table: npl.PolicyTable) -> None:
    start = (0, 25, 0)
    assert table.rollout(start, 500, 1) == table.rollout(start, 500, 1)
    assert table.rollout(start, 500, 1) != table.rollout(start, 500, 2)


@pytest.mark.parametrize(("runs", "seed"), [(0, 0), (-1, 0), (10**12, 0), (1, -1), (1, 2**64)])
def test_impossible_numbers_are_refused(table: npl.PolicyTable, runs: int, seed: int) -> None:
    with pytest.raises(PoseError, match="must be a whole number"):
        table.rollout((0, 20, 0), runs, seed)


def test_wilson_interval() -> None:
    # Newcombe, Two-sided confidence intervals for the single proportion, Stat. Med. 17 (1998) 857-872, Table I.
    assert np.round(wilson(81, 263), 4).tolist() == [0.2553, 0.3662]
    assert np.round(wilson(15, 148), 4).tolist() == [0.0624, 0.1605]
    assert np.round(wilson(0, 20), 4).tolist() == [0.0, 0.1611]
    assert np.round(wilson(29, 29), 4).tolist() == [0.883, 1.0]
