"""Many executions with noise, and their statistics."""

from __future__ import annotations

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import PoseError
from needleplan.planning import Outcome
from needleplan.planning.execution import wilson


@pytest.mark.parametrize("greedy", [False, True])
def test_rollouts_add_up(table: npl.PolicyTable, greedy: bool) -> None:
    start = table.best_entry().pose
    found = table.rollout(start, runs=2000, seed=3, greedy=greedy)
    assert sum(found.outcomes.values()) == found.runs == 2000
    assert found.success == found.outcomes[Outcome.TARGET] / 2000
    low, high = found.interval
    assert 0 <= low < found.success < high <= 1
    decision = table.lookup(*start)
    assert (found.predicted_success, found.predicted_value) == (decision.success, decision.value)
    assert found.mean_length_mm > 45
    assert found.mean_cost == pytest.approx(
        found.mean_length_mm + 4 * found.mean_turns + 10_000 * (1 - found.success), rel=0.01
    )


def test_prediction_is_near_what_happens(table: npl.PolicyTable) -> None:
    found = table.rollout(table.best_entry().pose, runs=5000)
    assert found.success == pytest.approx(found.predicted_success, abs=0.15)


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
