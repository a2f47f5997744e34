"""Reachability against the enumeration of all policies."""

import itertools

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import MdpError


def random_process(seed: int) -> tuple[npl.mdp.TabularMdp, np.ndarray]:
    """Five states and two actions, many of them deterministic, so that policies can circle for ever."""
    random = np.random.default_rng(seed)
    chances = np.zeros((2, 5, 5))
    for action, state in itertools.product(range(2), range(5)):
        successors = random.choice(5, size=random.integers(1, 3), replace=False)
        chances[action, state, successors] = random.dirichlet(np.ones(len(successors)))
    return npl.mdp.TabularMdp(chances, costs=np.ones((5, 2)), discount=0.9), chances


def reached_under(chances: np.ndarray, policy: tuple[int, ...], goal: int, avoid: int) -> np.ndarray:
    """The twin: the goal and the avoided state absorb; a high power of the chain."""
    chain = chances[list(policy), range(5)]
    chain[[goal, avoid]] = np.eye(5)[[goal, avoid]]
    return np.linalg.matrix_power(chain, 2**20)[:, goal]


@pytest.mark.parametrize("least", [False, True])
def test_probabilities_and_policy_are_those_of_the_best_of_all_policies(least: bool) -> None:
    """Values, bound and policy on 30 random processes."""
    for seed in range(30):
        mdp, chances = random_process(seed)
        every = [reached_under(chances, policy, 0, 1) for policy in itertools.product(range(2), repeat=5)]
        best = np.min(every, axis=0) if least else np.max(every, axis=0)
        found = npl.mdp.reachability(mdp, [0], avoid=[1], least=least, tolerance=1e-9)
        assert found.status == "converged"
        assert np.abs(found.values - best).max() <= found.error_bound + 1e-12 <= 1.1e-9
        assert np.abs(reached_under(chances, tuple(found.policy.tolist()), 0, 1) - best).max() < 1e-6


def test_a_stopped_iteration_still_encloses_and_wrong_states_are_named() -> None:
    """The bound of few sweeps holds; names, masks and mistakes."""

    def step(place: int, move: int) -> list[tuple[float, int, float]] | None:
        return [(0.5, place + move, 1.0), (0.5, place - move, 1.0)] if 0 < place < 30 else None

    walk = npl.mdp.TabularMdp.from_function(range(31), [-1, 1], step)
    stopped = npl.mdp.reachability(walk, [30], max_sweeps=50)
    exact = np.arange(31) / 30
    assert stopped.status == "iteration_limit"
    assert np.abs(stopped.values - exact).max() <= stopped.error_bound < 1
    done = npl.mdp.reachability(walk, np.arange(31) == 30)
    assert np.abs(done.values - exact).max() <= done.error_bound <= 1e-6
    with pytest.raises(MdpError, match="must be one of the states"):
        npl.mdp.reachability(walk, [31])
    with pytest.raises(MdpError, match="goal"):
        npl.mdp.reachability(walk, np.array([True]))
