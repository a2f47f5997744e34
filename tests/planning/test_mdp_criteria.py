"""Methods by structure, a given policy, a finite horizon and the average per step, against dense twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from needleplan import mdp
from needleplan.errors import MdpError
from needleplan.planning import Status


def problem(seed: int, states: int, actions: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.dirichlet(np.full(states, 0.3), size=(actions, states)), random.uniform(-2, 5, (states, actions))


def of_policy(transitions: np.ndarray, costs: np.ndarray, policy: np.ndarray, discount: float) -> np.ndarray:
    states = np.arange(len(costs))
    return np.linalg.solve(np.eye(len(costs)) - discount * transitions[policy, states], costs[states, policy])


@given(st.integers(0, 2**32), st.integers(1, 12), st.integers(1, 4), st.floats(0.05, 0.999))
def test_a_given_policy(seed: int, states: int, actions: int, discount: float) -> None:
    transitions, costs = problem(seed, states, actions)
    policy = np.random.default_rng(seed).integers(0, actions, states)
    solution = mdp.evaluate(mdp.TabularMdp(transitions, costs, discount), policy, tolerance=1e-7)
    expected = of_policy(transitions, costs, policy, discount)
    assert np.abs(solution.values - expected).max() <= solution.stats.error_bound + 1e-9
    assert solution.stats.error_bound <= 1e-7
    assert solution.policy.tolist() == policy.tolist()


@given(st.integers(0, 2**32), st.integers(1, 9), st.integers(1, 4), st.integers(1, 12), st.floats(0.1, 1.0))
def test_a_finite_horizon(seed: int, states: int, actions: int, horizon: int, discount: float) -> None:
    transitions, costs = problem(seed, states, actions)
    final = np.random.default_rng(seed).normal(size=states)
    process = mdp.TabularMdp(transitions, rewards=costs, discount=0.5)
    solution = mdp.finite_horizon(process, horizon, final=final, discount=discount)
    values = final
    for time in reversed(range(horizon)):
        q = costs + discount * np.einsum("ast,t->sa", transitions, values)
        values = q.max(axis=1)
        assert np.abs(solution.values[time] - values).max() <= solution.error_bound
        assert q[np.arange(states), solution.policy[time]] == pytest.approx(values, abs=1e-9)
    assert solution.error_bound < 1e-10


@settings(max_examples=25)
@given(st.integers(0, 2**32), st.integers(1, 7), st.integers(1, 3))
def test_the_average_per_step(seed: int, states: int, actions: int) -> None:
    """Against relative value iteration on dense arrays; all rows are positive, so the process is unichain."""
    transitions, costs = problem(seed, states, actions)
    transitions = 0.9 * transitions + 0.1 / states
    best = mdp.average_cost(mdp.TabularMdp(transitions, costs, 0.5), tolerance=1e-6)
    bias = np.zeros(states)
    for _ in range(200):
        after = (costs + np.einsum("ast,t->sa", transitions, bias)).min(axis=1)
        average, bias = (after - bias).mean(), after - after[0]
    assert best.status is Status.CONVERGED
    assert abs(best.average - average) <= best.error_bound + 1e-9
    assert best.bias == pytest.approx(bias, abs=1e-3)


def test_an_average_that_depends_on_the_start_is_told() -> None:
    two_worlds = mdp.TabularMdp([np.eye(2)], [[1.0], [3.0]], 0.5)
    best = mdp.average_cost(two_worlds, tolerance=1e-3)
    assert best.status is Status.ITERATION_LIMIT
    assert best.error_bound >= 1
    with pytest.raises(MdpError, match=r"state 1.*must have an action"):
        mdp.average_cost(mdp.TabularMdp([[[0.0, 1.0], [0.0, 0.0]]], [[1.0], [0.0]], 0.5))


def test_a_long_chain_in_any_order_is_solved_by_its_equations() -> None:
    """A walk of 2,000 places with discount 0.9999, where sweeps stop far from the values."""
    states, discount = 2000, 0.9999
    place = np.arange(states)
    order = np.random.default_rng(0).permutation(states)
    transitions, costs = [], np.empty((states, 2))
    for action, up in enumerate((0.3, 0.6)):
        ends = np.concatenate([np.minimum(place + 1, states - 1), np.maximum(place - 1, 0)])
        rows = (np.tile(order, 2), order[ends])
        transitions.append(sparse.coo_array((np.repeat([up, 1 - up], states), rows), shape=(states, states)).tocsr())
        costs[order, action] = np.abs(place - states / 2) / states + action * np.sin(place) ** 2
    solution = mdp.solve(mdp.TabularMdp(transitions, costs, discount), tolerance=1e-6)
    assert (solution.stats.status, solution.method) == (Status.CONVERGED, "pi")
    chosen = sparse.vstack(transitions).tocsr()[solution.policy.astype(int) * states + place]
    matrix = sparse.eye_array(states) - discount * chosen
    values = sparse.linalg.spsolve(matrix.tocsc(), costs[place, solution.policy])
    assert np.abs(solution.values - values).max() <= 1e-6
    assert (costs + discount * np.stack([p @ values for p in transitions], 1)).min(axis=1) == pytest.approx(values)


def test_methods_agree() -> None:
    transitions, costs = problem(3, 40, 3)
    process = mdp.TabularMdp(transitions, costs, 0.98)
    first = mdp.solve(process, tolerance=1e-7)
    for method in ("pi", "mpi", "sweep", "ppvi", "vi"):
        other = mdp.solve(process, method=method, tolerance=1e-7)
        assert other.method == method
        assert other.policy.tolist() == first.policy.tolist()
        assert np.abs(other.values - first.values).max() <= 2e-7


@pytest.mark.parametrize(
    "wrong",
    [
        lambda process: mdp.q_values(process, [1.0]),
        lambda _: mdp.q_values(3, [1.0]),
        lambda process: mdp.evaluate(process, [0, 9]),
        lambda process: mdp.evaluate(process, [0]),
        lambda process: mdp.evaluate(process, [0, 0], tolerance=0),
        lambda process: mdp.finite_horizon(process, 0),
        lambda process: mdp.finite_horizon(process, 2, final=[1.0]),
        lambda process: mdp.finite_horizon(process, 2, discount=2),
        lambda process: mdp.average_cost(process, tolerance="x"),
        lambda process: mdp.solve(process, start=[0.0]),
        lambda process: mdp.solve(process, start=[0.0, np.nan]),
        lambda process: mdp.solve(process, start=[0.0, 0.0], method="vi"),
    ],
)
def test_wrong_arguments_are_refused(wrong: object) -> None:
    process = mdp.TabularMdp([np.eye(2)], [[1.0], [3.0]], 0.5)
    with pytest.raises(MdpError):
        wrong(process)  # type: ignore[operator]
