"""The solver for anybody's MDP."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from needleplan import mdp
from needleplan.errors import MdpError
from needleplan.planning import Status

STAY = np.array([[0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
GO = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, 0.8], [0.0, 0.0, 1.0]])
COSTS = np.array([[1.0, 3.0], [1.0, 2.0], [0.0, 0.0]])


def exact(transitions: list[np.ndarray], costs: np.ndarray, discount: float) -> np.ndarray:
    """Policy iteration with linear solves."""
    states = len(costs)
    policy = np.zeros(states, dtype=int)
    while True:
        chosen = np.stack([transitions[a][s] for s, a in enumerate(policy)])
        values = np.linalg.solve(np.eye(states) - discount * chosen, costs[np.arange(states), policy])
        q = np.stack([costs[:, a] + discount * transitions[a] @ values for a in range(len(transitions))], axis=1)
        better = np.where(q.min(axis=1) < q[np.arange(states), policy] - 1e-12, q.argmin(axis=1), policy)
        if (better == policy).all():
            return values
        policy = better


@pytest.mark.parametrize("form", [np.asarray, sparse.csr_array, sparse.csc_matrix, sparse.coo_array])
@pytest.mark.parametrize("method", ["sweep", "ppvi", "vi"])
def test_three_states(form: object, method: str) -> None:
    problem = mdp.TabularMdp([form(STAY), form(GO)], COSTS, discount=0.9)  # type: ignore[operator]
    solution = mdp.solve(problem, method=method, tolerance=1e-9)
    assert solution.values == pytest.approx(exact([STAY, GO], COSTS, 0.9), abs=1e-8)
    assert solution.policy[:2].tolist() == [1, 1]
    assert solution.stats.status is Status.CONVERGED
    assert solution.stats.error_bound <= 1e-9


@given(st.integers(0, 2**32), st.integers(1, 12), st.integers(1, 4), st.floats(0.05, 0.98))
def test_random_problems(seed: int, states: int, actions: int, discount: float) -> None:
    random = np.random.default_rng(seed)
    transitions = [random.dirichlet(np.full(states, 0.3), size=states) for _ in range(actions)]
    costs = random.uniform(0.1, 10, (states, actions))
    for solution in (
        mdp.solve(mdp.TabularMdp([sparse.csr_array(p) for p in transitions], costs, discount), tolerance=1e-8),
        mdp.value_iteration(mdp.TabularMdp(transitions, costs, discount), tolerance=1e-8),
    ):
        assert solution.values == pytest.approx(exact(transitions, costs, discount), abs=1e-6)


def test_an_action_that_is_not_to_be_had() -> None:
    stay = STAY.copy()
    stay[0] = 0
    go = GO.copy()
    go[2] = 0
    stay[2] = 0
    problem = mdp.TabularMdp([sparse.csr_array(stay), sparse.csr_array(go)], COSTS, discount=1.0)
    solution = mdp.solve(problem, tolerance=1e-9)
    assert solution.values == pytest.approx([3.0, 2.0 + 0.2 * 3.0, 0.0])
    assert solution.policy.tolist() == [1, 1, 0]


def test_rows_as_they_are() -> None:
    problem = mdp.TabularMdp.from_rows(
        action_offsets=[0, 2, 3, 3],
        row_offsets=[0, 2, 3, 4],
        successors=[0, 1, 2, 2],
        probabilities=[0.5, 0.5, 1.0, 1.0],
        stage_costs=[1.0, 3.0, 2.0],
        discount=1.0,
    )
    solution = mdp.solve(problem, tolerance=1e-9)
    assert solution.values == pytest.approx([3.0, 2.0, 0.0])
    assert solution.policy[0] == 1
    assert (problem.states, problem.actions) == (3, 2)


def test_partitions_of_ones_own() -> None:
    problem = mdp.TabularMdp([STAY, GO], COSTS, discount=0.9)
    solution = mdp.solve(problem, method="ppvi", labels=[0, 1, 1], tolerance=1e-9)
    assert solution.stats.partitions == 2
    assert solution.values == pytest.approx(exact([STAY, GO], COSTS, 0.9), abs=1e-8)


def test_the_maps_of_table_6_1() -> None:
    maps = mdp.dependencies(mdp.TabularMdp([STAY, GO], COSTS, discount=0.9), labels=[0, 1, 1])
    assert [sorted(states.tolist()) for states in maps.states] == [[0, 1], [0, 1], [0, 1, 2]]
    assert [{other: states.tolist() for other, states in each.items()} for each in maps.partitions] == [
        {0: [0], 1: [1]},
        {0: [0], 1: [1, 2]},
    ]
    with pytest.raises(MdpError):
        mdp.dependencies(mdp.TabularMdp([STAY, GO], COSTS, discount=0.9), labels=[0])


@pytest.mark.parametrize(
    ("transitions", "costs", "discount"),
    [
        ([STAY * 0.9, GO], COSTS, 0.9),
        ([STAY, GO], COSTS[:2], 0.9),
        ([STAY, GO[:2]], COSTS, 0.9),
        ([STAY, GO[:2, :2]], COSTS, 0.9),
        ([STAY, GO], np.where(COSTS == 2, np.nan, COSTS), 0.9),
        ([STAY, np.where(GO == 0.8, np.nan, GO)], COSTS, 0.9),
        ([STAY, np.where(GO == 0.8, -0.8, GO)], COSTS, 0.9),
        ([STAY, GO], COSTS, 1.5),
        ([STAY, GO], COSTS, 0.0),
        ([STAY, GO], COSTS, np.nan),
        ([], COSTS, 0.9),
        ([3], COSTS, 0.9),
    ],
)
def test_what_is_no_mdp_is_refused(transitions: list[np.ndarray], costs: np.ndarray, discount: float) -> None:
    with pytest.raises(MdpError):
        mdp.TabularMdp(transitions, costs, discount)


def test_the_offending_row_is_named() -> None:
    with pytest.raises(MdpError, match=r"state 1.*action 1"):
        mdp.TabularMdp([STAY, np.where(GO == 0.8, 0.7, GO)], COSTS, 0.9)


@pytest.mark.parametrize("method", ["sweep", "ppvi", "vi"])
@pytest.mark.parametrize("discount", [0.9, 1.0])
def test_a_tolerance_below_rounding_is_told(method: str, discount: float) -> None:
    leave = [np.array([[0.9, 0.1 - 1e-3, 1e-3], [0.5, 0.5, 0.0], [0.0, 0.0, 0.0]])]
    costs = np.array([[1.0], [3.0], [0.0]])
    solution = mdp.solve(mdp.TabularMdp(leave, costs, discount), method=method, tolerance=1e-15)
    expected = np.linalg.solve(np.eye(2) - discount * leave[0][:2, :2], costs[:2, 0])
    assert solution.stats.status is Status.PRECISION_LIMIT
    assert 1e-15 < solution.stats.error_bound < 1e-6
    assert np.abs(solution.values[:2] - expected).max() <= solution.stats.error_bound + 1e-9


@pytest.mark.parametrize("method", ["sweep", "ppvi", "vi"])
def test_free_steps_have_a_bound_unless_they_form_a_loop(method: str) -> None:
    costs = np.zeros((3, 1))
    chain = [np.array([[0.0, 1.0, 0.0], [0.0, 0.5, 0.5], [0.0, 0.0, 0.0]])]
    with pytest.raises(MdpError, match=r"state 1, action 0: steps of cost zero must not form a loop"):
        mdp.TabularMdp(chain, costs, discount=1.0)
    costs[1] = 2.0
    solution = mdp.solve(mdp.TabularMdp(chain, costs, discount=1.0), method=method, tolerance=1e-6)
    assert solution.stats.status is Status.CONVERGED
    assert solution.stats.error_bound <= 1e-6
    assert np.abs(solution.values - [4, 4, 0]).max() <= solution.stats.error_bound


@pytest.mark.parametrize("arguments", [{"method": "magic"}, {"priority": "H3"}, {"tolerance": -1}, {"labels": [0]}])
def test_wrong_arguments_are_refused(arguments: dict[str, object]) -> None:
    with pytest.raises(MdpError):
        mdp.solve(mdp.TabularMdp([STAY, GO], COSTS, 0.9), **arguments)  # type: ignore[arg-type]
