"""What else is asked of a Markov decision process: Q-values, a given policy, a finite horizon, the average per step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.config import Integer, Maybe, Number
from needleplan.errors import MdpError, Mistake
from needleplan.planning._lattice import Status, compiled_call
from needleplan.planning._mdp import Solution, require_mdp, solved_by
from needleplan.planning._mdp_input import argument, numbers

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from needleplan.planning._mdp_problem import TabularMdp

__all__ = ["AverageCost", "FiniteHorizon", "average_cost", "evaluate", "finite_horizon", "q_values"]

# 1 - discount of the discounted processes that approach the average cost, one after another.
_VANISHING = (1e-3, 1e-5, 1e-7)

# Steps of damped relative value iteration after each of them, which remove the rest of the discount and rounding.
_DAMPED_STEPS = 20

# Operations of a backup apart from the products of a row, for the bound of its rounding.
_MORE_OPERATIONS = 6

_TOLERANCE = Number(above=0)


def q_values(mdp: TabularMdp, values: ArrayLike) -> NDArray[np.float64]:
    """Return the Q-values of all actions for given values of the states.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    values : array_like of float, shape (S,)
        Values of the states, such as those of a solution. If they are wrong by at most e, the Q-values are wrong by at
        most discount * e.

    Returns
    -------
    ndarray of float64, shape (S, A)
        Expected costs (or rewards) of an action followed by the given values; infinite (for rewards minus infinite) for
        an action that is not available. For a process made by `from_rows`, A counts positions among the rows.

    Raises
    ------
    MdpError
        If an argument is wrong.

    Examples
    --------
    >>> import needleplan as npl
    >>> choice = npl.mdp.TabularMdp([[[1.0]], [[1.0]]], costs=[[1.0, 3.0]], discount=0.5)
    >>> npl.mdp.q_values(choice, npl.mdp.solve(choice, tolerance=1e-9).values).round(6)
    array([[2., 4.]])
    """
    require_mdp(mdp)
    costs = _of_states(mdp, "values", values) * mdp.sign
    rows = compiled_call(MdpError, mdp.compiled.q_values, costs, mdp.discount)
    return mdp.layout.by_action(mdp.sign * rows, mdp.sign * np.inf)


def evaluate(mdp: TabularMdp, policy: ArrayLike, *, tolerance: float = 0.01, max_sweeps: int | None = None) -> Solution:
    """Compute the values of a policy.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    policy : array_like of int, shape (S,)
        Number of an available action in every state; any number in a terminal state.
    tolerance : float, default 0.01
        Largest error of a value.
    max_sweeps : int, optional
        Number of sweeps after which the solve ends in any case.

    Returns
    -------
    Solution
        The values of the policy, the policy, and statistics, as `solve` returns them. With discount 1, the value of a
        state from which the policy may never end is infinite.

    Raises
    ------
    MdpError
        If an argument is wrong; for an action that is not available, the message names the state.

    Examples
    --------
    >>> import needleplan as npl
    >>> choice = npl.mdp.TabularMdp([[[1.0]], [[1.0]]], costs=[[1.0, 3.0]], discount=0.5)
    >>> npl.mdp.evaluate(choice, [1], tolerance=1e-9).values.round(6)
    array([6.])
    """
    require_mdp(mdp)
    choices = mdp.layout.choices_of(policy)
    solution = solved_by(
        mdp,
        compiled_call(MdpError, mdp.compiled.under_policy, choices),
        tolerance=argument("tolerance", _TOLERANCE, tolerance),
        max_sweeps=argument("max_sweeps", Maybe(Integer(0, 2**31 - 1)), max_sweeps),
    )
    return Solution(solution.values, mdp.layout.actions_of(choices), solution.stats, solution.method)


@dataclass(frozen=True, eq=False)
class FiniteHorizon(ShortRepr):
    """The solution of a Markov decision process that ends after a number of steps.

    Attributes
    ----------
    values : ndarray of float64, shape (H + 1, S)
        Optimal expected costs (or rewards) with H, H - 1, ..., 0 steps to go: row t belongs to the time t.
    policy : ndarray of uint32, shape (H, S)
        Number of the best action at every time in every state.
    error_bound : float
        Upper bound of the error of every value. Backward induction is exact, so this is rounding.

    Examples
    --------
    >>> import needleplan as npl
    >>> forever = npl.mdp.TabularMdp([[[1.0]]], costs=[[1.0]], discount=0.5)
    >>> npl.mdp.finite_horizon(forever, 2).values.ravel()
    array([1.5, 1. , 0. ])
    """

    values: NDArray[np.float64]
    policy: NDArray[np.uint32]
    error_bound: float


def finite_horizon(
    mdp: TabularMdp, horizon: int, *, final: ArrayLike | None = None, discount: float | None = None
) -> FiniteHorizon:
    """Solve a Markov decision process that ends after a number of steps, by backward induction.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    horizon : int
        Number of steps H, from 1.
    final : array_like of float, shape (S,), optional
        Cost (or reward) of the state after the last step; without it, 0.
    discount : float, optional
        Discount factor in (0, 1] in place of that of the process. With 1, costs may be negative here.

    Returns
    -------
    FiniteHorizon
        Values and policy for every time.

    Raises
    ------
    MdpError
        If an argument is wrong.

    Examples
    --------
    >>> import needleplan as npl
    >>> wait, repair = [[0.9, 0.1], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    >>> machine = npl.mdp.TabularMdp([wait, repair], costs=[[0.0, 5.0], [2.0, 5.0]], discount=0.9)
    >>> npl.mdp.finite_horizon(machine, 10).policy[[0, 9], 1]
    array([1, 0], dtype=uint32)
    """
    require_mdp(mdp)
    steps = argument("horizon", Integer(1, 2**31 - 1), horizon)
    factor = mdp.discount if discount is None else argument("discount", Number(above=0, at_most=1), discount)
    values = np.zeros((steps + 1, mdp.states))
    policy = np.zeros((steps, mdp.states), dtype=np.uint32)
    if final is not None:
        values[-1] = mdp.sign * _of_states(mdp, "final", final)
    terminal, rounding = values[-1].copy(), 0.0
    for time in reversed(range(steps)):
        rows = compiled_call(MdpError, mdp.compiled.q_values, values[time + 1], factor)
        values[time], choices = mdp.layout.least(rows, terminal)
        policy[time] = mdp.actions_of(choices)
        rounding = factor * rounding + _rounding(mdp, max(np.abs(values[time]).max(), np.abs(rows).max(initial=0.0)))
    return FiniteHorizon(mdp.sign * values + 0.0, policy, rounding)


@dataclass(frozen=True, eq=False)
class AverageCost(ShortRepr):
    """The optimal average cost (or reward) per step of a Markov decision process.

    Attributes
    ----------
    average : float
        Average cost (or reward) per step, the same from all states.
    error_bound : float
        Upper bound of the error of `average` for every state, rounding included.
    bias : ndarray of float64, shape (S,)
        Differences of the expected total costs (or rewards) between the states; 0 in state 0.
    policy : ndarray of uint32, shape (S,)
        Number of the best action in every state.
    status : Status
        "converged" if the bound is at most the tolerance. Otherwise "iteration_limit"; the average then probably
        depends on the state in which the process begins.

    Examples
    --------
    >>> import needleplan as npl
    >>> wait, repair = [[0.9, 0.1], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    >>> machine = npl.mdp.TabularMdp([wait, repair], costs=[[0.0, 5.0], [2.0, 5.0]], discount=0.9)
    >>> best = npl.mdp.average_cost(machine, tolerance=1e-6)
    >>> round(best.average, 4), best.status
    (0.4545, <Status.CONVERGED: 'converged'>)
    """

    average: float
    error_bound: float
    bias: NDArray[np.float64]
    policy: NDArray[np.uint32]
    status: Status


def average_cost(mdp: TabularMdp, *, tolerance: float = 0.01) -> AverageCost:
    """Compute the optimal average cost (or reward) per step, for a process that never ends.

    For any h, the optimal average of every state lies between the least and the largest element of T h - h, where T is
    the Bellman operator without discount (Odoni 1969). h is the solution of the process with a discount that approaches
    1, until the two are near.

    Parameters
    ----------
    mdp : TabularMdp
        The process; its discount is not used. Every state must have an action.
    tolerance : float, default 0.01
        Largest error of the average.

    Returns
    -------
    AverageCost
        Average, bound, bias and policy.

    Raises
    ------
    MdpError
        If an argument is wrong, or a state is terminal.

    Examples
    --------
    >>> import needleplan as npl
    >>> coin = npl.mdp.TabularMdp([[[0.5, 0.5], [0.5, 0.5]]], rewards=[[1.0], [0.0]], discount=0.9)
    >>> round(npl.mdp.average_cost(coin, tolerance=1e-6).average, 5)
    0.5
    """
    require_mdp(mdp)
    wanted = argument("tolerance", _TOLERANCE, tolerance)
    terminal = np.diff(mdp.layout.action_offsets) == 0
    if terminal.any():
        rule = "must have an action: a process that ends has no average per step"
        raise MdpError(Mistake(f"state {int(np.argmax(terminal))}", "", rule))
    none, start = np.zeros(mdp.states), None
    for rate in _VANISHING:
        discounted = compiled_call(MdpError, mdp.compiled.with_discount, 1 - rate)
        solved = compiled_call(MdpError, discounted.solve, method="auto", start=start, tolerance=wanted / (4 * rate))
        bias = solved["values"] - solved["values"][0]
        for _ in range(_DAMPED_STEPS):
            after, choices = mdp.layout.least(compiled_call(MdpError, mdp.compiled.q_values, bias, 1.0), none)
            least, most = float((after - bias).min()), float((after - bias).max())
            error = (most - least) / 2 + _rounding(mdp, float(np.abs(after).max() + np.abs(bias).max()))
            average = (least + most) / 2
            if error <= wanted:
                return AverageCost(
                    mdp.sign * average, error, mdp.sign * bias + 0.0, mdp.actions_of(choices), Status.CONVERGED
                )
            bias = (bias + after) / 2
            bias -= bias[0]
        # The values of the next process, whose rate is a hundredth, are about average / rate + bias.
        start = average / (rate / 100) + bias
    return AverageCost(
        mdp.sign * average, error, mdp.sign * bias + 0.0, mdp.actions_of(choices), Status.ITERATION_LIMIT
    )


def _rounding(mdp: TabularMdp, size: float) -> float:
    """Return a bound of the rounding of a backup whose terms are at most of this size."""
    return float(4 * (mdp.layout.longest_row + _MORE_OPERATIONS) * np.finfo(float).eps * size)


def _of_states(mdp: TabularMdp, key: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return one number per state. Raises MdpError."""
    array = numbers(key, values)
    if array.shape != (mdp.states,):
        raise MdpError(Mistake(key, f"shape {array.shape}", f"must have the shape ({mdp.states},), one a state"))
    return array
