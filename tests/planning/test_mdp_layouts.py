"""The layouts of arrays, tables and functions that an MDP is made of: all against the same dense problem."""

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from needleplan import mdp
from needleplan.errors import MdpError

STATES, ACTIONS = 5, 3
RANDOM = np.random.default_rng(4)
TRANSITIONS = RANDOM.dirichlet(np.full(STATES, 0.4), size=(ACTIONS, STATES))
AMOUNTS = RANDOM.uniform(0.5, 4, (ACTIONS, STATES, STATES))
EXPECTED = np.einsum("ast,ast->sa", TRANSITIONS, AMOUNTS)
DISCOUNT = 0.9


def iterated(costs: np.ndarray, transitions: np.ndarray = TRANSITIONS) -> np.ndarray:
    """Value iteration on dense arrays."""
    values = np.zeros(STATES)
    for _ in range(600):
        values = (costs + DISCOUNT * np.einsum("ast,t->sa", transitions, values)).min(axis=1)
    return values


def solved(process: mdp.TabularMdp) -> np.ndarray:
    return mdp.solve(process, tolerance=1e-9).values


@pytest.mark.parametrize(
    "costs", [EXPECTED, AMOUNTS, list(AMOUNTS), [sparse.csr_array(amounts) for amounts in AMOUNTS]], ids=type
)
def test_costs_of_pairs_and_of_transitions(costs: Any) -> None:
    assert solved(mdp.TabularMdp(TRANSITIONS, costs, DISCOUNT)) == pytest.approx(iterated(EXPECTED), abs=1e-8)


def test_costs_of_states() -> None:
    costs = EXPECTED[:, 0]
    expected = iterated(np.repeat(costs[:, None], ACTIONS, axis=1))
    assert solved(mdp.TabularMdp(TRANSITIONS, costs, DISCOUNT)) == pytest.approx(expected, abs=1e-8)


def test_rewards_are_maximised_and_stay_rewards() -> None:
    process = mdp.TabularMdp(TRANSITIONS, rewards=AMOUNTS, discount=DISCOUNT)
    best = -iterated(-EXPECTED)
    solution = mdp.solve(process, tolerance=1e-9)
    assert solution.values == pytest.approx(best, abs=1e-8)
    q = mdp.q_values(process, solution.values)
    assert q.max(axis=1) == pytest.approx(best, abs=1e-8)
    assert q.argmax(axis=1).tolist() == solution.policy.tolist()
    again = mdp.solve(process, tolerance=1e-9, start=solution.values)
    assert again.stats.backups < solution.stats.backups / 2


@pytest.mark.parametrize("key", ["costs", "rewards"])
def test_an_infinite_amount_forbids_an_action(key: str) -> None:
    amounts = EXPECTED.copy()
    amounts[1, 0] = amounts[4, 2] = np.inf if key == "costs" else -np.inf
    process = mdp.TabularMdp(TRANSITIONS, discount=DISCOUNT, **{key: amounts})
    sign = 1 if key == "costs" else -1
    solution = mdp.solve(process, tolerance=1e-9)
    assert solution.values == pytest.approx(sign * iterated(np.where(np.isinf(amounts), 1e9, sign * amounts)), abs=1e-8)
    q = mdp.q_values(process, solution.values)
    assert q[1, 0] == q[4, 2] == sign * np.inf
    with pytest.raises(MdpError, match=r"policy\[1\].*available"):
        mdp.evaluate(process, [1, 0, 1, 1, 1])
    amounts[1] = amounts[1, 0]
    with pytest.raises(MdpError, match=r"state 1.*must leave an action"):
        mdp.TabularMdp(TRANSITIONS, discount=DISCOUNT, **{key: amounts})


def test_a_function_with_names() -> None:
    names, moves = ["a", "b", "c", "d", "e"], ["x", "y", "z"]

    def step(state: str, action: str) -> list[tuple[float, str, float]]:
        s, a = names.index(state), moves.index(action)
        return [(TRANSITIONS[a, s, t], names[t], AMOUNTS[a, s, t]) for t in range(STATES)]

    process = mdp.TabularMdp.from_function(names, moves, step, DISCOUNT)
    assert solved(process)[process.index("d")] == pytest.approx(iterated(EXPECTED)[3], abs=1e-8)
    with pytest.raises(MdpError, match="'f'"):
        process.index("f")


def test_a_table_of_gymnasium() -> None:
    """Ended transitions have no future, even if their next state has one."""
    table = {
        s: {a: [(TRANSITIONS[a, s, t], t, AMOUNTS[a, s, t], t == 2) for t in range(STATES)] for a in range(ACTIONS)}
        for s in range(STATES)
    }
    values = solved(mdp.TabularMdp.from_gymnasium(table, DISCOUNT))
    alive = TRANSITIONS.copy()
    alive[:, :, 2] = 0
    assert values == pytest.approx([*-iterated(-EXPECTED, alive), 0], abs=1e-8)
    for wrong in ({0: {0: [(1.0, 0, 0.0)]}}, {1: {}}, 3, {}):
        with pytest.raises(MdpError, match="table"):
            mdp.TabularMdp.from_gymnasium(wrong)


def test_rounded_sums_are_divided_with_a_remark_and_wrong_ones_refused() -> None:
    rounded = TRANSITIONS.round(7)
    process = mdp.TabularMdp(rounded, EXPECTED, DISCOUNT)
    assert "do not sum to one" in process.remarks[0]
    divided = rounded / rounded.sum(axis=2, keepdims=True)
    assert solved(process) == pytest.approx(iterated(EXPECTED, divided), abs=1e-8)
    assert mdp.TabularMdp(TRANSITIONS, EXPECTED, DISCOUNT).remarks == ()
    with pytest.raises(MdpError, match=r"state 0, action 0.*sum to one"):
        mdp.TabularMdp(TRANSITIONS * (1 + 1e-5), EXPECTED, DISCOUNT)


def test_a_probability_that_rounds_above_one_is_one() -> None:
    process = mdp.TabularMdp([np.eye(2) * (1 + 2e-16 * 2)], [[1.0], [3.0]], 0.5)
    assert solved(process) == pytest.approx([2.0, 6.0])
    with pytest.raises(MdpError, match=r"state 0, action 0.*in \[0, 1\]"):
        mdp.TabularMdp([np.eye(2) * 1.01], [[1.0], [3.0]], 0.5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "costs"),
        ({"costs": EXPECTED, "rewards": EXPECTED}, "not both"),
        ({"costs": EXPECTED.T}, "shape"),
        ({"rewards": AMOUNTS[:2]}, "rewards"),
        ({"costs": [sparse.csr_array(AMOUNTS[0])]}, "1 matrices"),
        ({"rewards": "many"}, "numbers"),
        ({"rewards": np.where(np.isclose(EXPECTED, EXPECTED.max()), np.inf, EXPECTED)}, "finite"),
    ],
)
def test_wrong_amounts_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(MdpError, match=message):
        mdp.TabularMdp(TRANSITIONS, discount=DISCOUNT, **arguments)


@pytest.mark.parametrize(
    ("states", "step", "message"),
    [
        ([0, 0], lambda _s, _a: None, "twice"),
        ([0, 1], lambda _s, _a: [(1.0, 7, 0.0)], "one of the states"),
        ([0, 1], lambda _s, _a: [(1.0, 1)], "probability, next state, cost"),
        ([0, 1], lambda _s, _a: [(0.5, 1, 0.0)], "sum to one"),
        ([[0]], lambda _s, _a: None, "hashable"),
        ([0], 3, "function"),
    ],
)
def test_wrong_functions_are_refused(states: list[Any], step: Any, message: str) -> None:
    with pytest.raises(MdpError, match=message):
        mdp.TabularMdp.from_function(states, [0], step, 0.5)
