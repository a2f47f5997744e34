"""The solver for any finite Markov decision process.

It minimises the expected discounted cost V(s) = min_a [c(s, a) + discount * sum_s' P(s' | s, a) V(s')].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan import _ppvi
from needleplan.artifacts import short_html, short_repr
from needleplan.config import Choice, Integer, Maybe, Number
from needleplan.errors import MdpError, Mistake
from needleplan.planning._lattice import Progress, Stats, compiled_call, require_callable, stats_of
from needleplan.planning._mdp_input import (
    SparseRows,
    argument,
    compressed,
    interleaved,
    labels_of,
    numbers,
    whole_numbers,
)  # fmt: skip
from needleplan.scenario import Method, Priority

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Dependencies", "Solution", "TabularMdp", "dependencies", "solve", "value_iteration"]

_DISCOUNT = Number(above=0, at_most=1)


class TabularMdp:
    """A finite Markov decision process of S states and A actions.

    Parameters
    ----------
    transitions : sequence of (S, S) matrices
        One matrix of transition probabilities per action: scipy.sparse or an array. An empty row means that the action
        is not available in that state. A state without any action is terminal and has the value 0.
    costs : array_like of float, shape (S, A)
        Expected stage costs.
    discount : float
        Discount factor in (0, 1]. With 1, no cost may be negative, and no loop may consist of actions of cost 0.

    Attributes
    ----------
    states : int
        Number of states S.
    actions : int
        Number of actions A.

    Raises
    ------
    MdpError
        If a rule is broken; the message names the first state and action that break it.

    Examples
    --------
    >>> import needleplan as npl
    >>> wait, repair = [[0.9, 0.1], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    >>> machine = npl.mdp.TabularMdp([wait, repair], costs=[[0.0, 5.0], [2.0, 5.0]], discount=0.9)
    >>> machine.states, machine.actions
    (2, 2)
    """

    states: int
    actions: int
    _action_of_row: NDArray[np.uint32] | None

    def __init__(self, transitions: Sequence[Any] | NDArray[np.float64], costs: ArrayLike, discount: float) -> None:
        try:
            parts = [] if isinstance(transitions, str) else list(transitions)
        except TypeError:
            parts = []
        if not parts:
            rule = "must be a sequence of square matrices of numbers, one per action"
            raise MdpError(Mistake("transitions", repr(transitions), rule))
        matrices = [compressed(matrix, f"transitions[{action}]") for action, matrix in enumerate(parts)]
        stage_costs = numbers("costs", costs)
        self.states, self.actions = len(matrices[0][0]) - 1, len(matrices)
        if stage_costs.shape != (self.states, self.actions):
            rule = f"must have the shape (states, actions) = {(self.states, self.actions)}"
            raise MdpError(Mistake("costs", f"shape {stage_costs.shape}", rule))
        rows, self._action_of_row = interleaved(matrices, stage_costs)
        self._compile(rows, discount)

    @classmethod
    def from_rows(
        cls,
        *,
        action_offsets: ArrayLike,
        row_offsets: ArrayLike,
        successors: ArrayLike,
        probabilities: ArrayLike,
        stage_costs: ArrayLike,
        discount: float,
    ) -> TabularMdp:
        """Make an MDP of compressed sparse rows, with any number of actions in every state.

        Parameters
        ----------
        action_offsets : array_like of int, shape (S + 1,)
            Row r is an action of the state s with `action_offsets[s]` <= r < `action_offsets[s + 1]`.
        row_offsets : array_like of int, shape (R + 1,)
            Entry i belongs to the row r with `row_offsets[r]` <= i < `row_offsets[r + 1]`.
        successors : array_like of int
            The successor state of every entry.
        probabilities : array_like of float
            The probability of every entry.
        stage_costs : array_like of float, shape (R,)
            The expected stage cost of every row.
        discount : float
            Discount factor in (0, 1]. With 1, no cost may be negative, and no loop may consist of rows of cost 0.

        Returns
        -------
        TabularMdp
            The process. The policy of its solution holds the position of the chosen row among the rows of the state.

        Raises
        ------
        MdpError
            If a rule is broken; the message names the first state and action that break it.

        Examples
        --------
        >>> import needleplan as npl
        >>> chain = npl.mdp.TabularMdp.from_rows(
        ...     action_offsets=[0, 1, 1], row_offsets=[0, 1], successors=[1], probabilities=[1.0],
        ...     stage_costs=[3.0], discount=1.0,
        ... )
        >>> npl.mdp.solve(chain).values
        array([3., 0.])
        """
        rows = SparseRows(
            whole_numbers("action_offsets", action_offsets, np.int64),
            whole_numbers("row_offsets", row_offsets, np.int64),
            whole_numbers("successors", successors, np.uint32),
            numbers("probabilities", probabilities),
            numbers("stage_costs", stage_costs),
        )
        mdp = cls.__new__(cls)
        mdp.states = len(rows.action_offsets) - 1
        mdp.actions = int(np.diff(rows.action_offsets).max(initial=0))
        mdp._action_of_row = None
        mdp._compile(rows, discount)
        return mdp

    def _compile(self, rows: SparseRows, discount: float) -> None:
        self._action_offsets = rows.action_offsets
        self.compiled = compiled_call(
            MdpError, _ppvi.Tabular, **vars(rows), discount=argument("discount", _DISCOUNT, discount)
        )

    def actions_of(self, choices: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Convert positions among the available actions of each state to numbers of actions.

        Parameters
        ----------
        choices : ndarray of uint32, shape (S,)
            Position among the available actions of every state.

        Returns
        -------
        ndarray of uint32, shape (S,)
            Numbers of the actions; 0 in a terminal state.

        Examples
        --------
        >>> import numpy as np
        >>> import needleplan as npl
        >>> only_second = npl.mdp.TabularMdp([[[0.0]], [[1.0]]], costs=[[1.0, 1.0]], discount=0.5)
        >>> only_second.actions_of(np.array([0], dtype=np.uint32))
        array([1], dtype=uint32)
        """
        if self._action_of_row is None:
            return choices
        first, actions = self._action_offsets[:-1], np.zeros_like(choices)
        acting = self._action_offsets[1:] > first
        actions[acting] = self._action_of_row[first[acting] + choices[acting]]
        return actions

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return f"<TabularMdp: {self.states:,} states, {self.actions} actions>"


@dataclass(frozen=True, eq=False)
class Solution:
    """The solution of a Markov decision process.

    Attributes
    ----------
    values : ndarray of float64, shape (S,)
        Optimal expected costs.
    policy : ndarray of uint32, shape (S,)
        Number of the best action in every state.
    stats : Stats
        How the solve went.

    Examples
    --------
    >>> import needleplan as npl
    >>> forever = npl.mdp.TabularMdp([[[1.0]]], costs=[[1.0]], discount=0.5)
    >>> npl.mdp.solve(forever, tolerance=1e-9).values.round(6)
    array([2.])
    """

    values: NDArray[np.float64]
    policy: NDArray[np.uint32]
    stats: Stats
    __repr__ = short_repr
    _repr_html_ = short_html


def solve(
    mdp: TabularMdp,
    *,
    method: str = Method.SWEEP,
    labels: ArrayLike | None = None,
    priority: str = Priority.H2,
    tolerance: float = 0.01,
    max_sweeps: int | None = None,
    time_limit_s: float | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Solve a Markov decision process.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    method : {"sweep", "ppvi", "vi"}, default "sweep"
        Sweeps in a fixed order, prioritized-partitioned value iteration, or plain value iteration.
    labels : array_like of int, shape (S,), optional
        Number of the partition of every state.
    priority : {"H1", "H2", "bound"}, default "H2"
        Priority of a partition, for the method "ppvi".
    tolerance : float, default 0.01
        Largest error of a value. The solve ends with the status "converged" once `stats.error_bound` is at most this,
        or with "precision_limit" if rounding does not allow it.
    max_sweeps : int, optional
        Number of sweeps after which the solve ends in any case.
    time_limit_s : float, optional
        Time in s by which the solve ends: no sweep but the first begins after which it would probably end later.
    threads : int, optional
        Number of threads, from 1 to 1024. Without it, one per processor core.
    progress : callable, optional
        As for `plan`: called with sweeps, residual and threshold at most every 0.05 s, and at the end. An exception
        that it raises abandons the solve; StopIteration ends it with the values so far and the status "interrupted".

    Returns
    -------
    Solution
        Values, policy and statistics.

    Raises
    ------
    MdpError
        If an argument is wrong.

    Examples
    --------
    >>> import needleplan as npl
    >>> wait, repair = [[0.9, 0.1], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    >>> machine = npl.mdp.TabularMdp([wait, repair], costs=[[0.0, 5.0], [2.0, 5.0]], discount=0.9)
    >>> solution = npl.mdp.solve(machine, tolerance=1e-9)
    >>> solution.policy, solution.values.round(3)
    (array([0, 1], dtype=uint32), array([4.128, 8.716]))
    """
    _require_mdp(mdp)
    require_callable(progress, MdpError)
    began = perf_counter()
    solved = compiled_call(
        MdpError,
        mdp.compiled.solve,
        method=argument("method", Choice(Method), method).value,
        labels=None if labels is None else labels_of(labels, mdp.states),
        priority=argument("priority", Choice(Priority), priority).value,
        tolerance=argument("tolerance", Number(above=0), tolerance),
        max_sweeps=argument("max_sweeps", Maybe(Integer(0, 2**31 - 1)), max_sweeps),
        time_limit_s=argument("time_limit_s", Maybe(Number("s", at_least=0)), time_limit_s),
        threads=argument("threads", Maybe(Integer(1, 1024)), threads),
        progress=progress,
    )
    stats = stats_of(solved, mdp.states, perf_counter() - began)
    return Solution(solved["values"], mdp.actions_of(solved["policy"]), stats)


def value_iteration(
    mdp: TabularMdp, *, tolerance: float = 0.01, max_sweeps: int | None = None, progress: Progress | None = None
) -> Solution:
    """Solve a Markov decision process by plain value iteration, the reference for the other methods.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    tolerance : float, default 0.01
        Largest error of a value.
    max_sweeps : int, optional
        Number of sweeps after which the solve ends in any case.
    progress : callable, optional
        Called during the solve, as for `solve`.

    Returns
    -------
    Solution
        Values, policy and statistics.

    Raises
    ------
    MdpError
        If an argument is wrong.

    Examples
    --------
    >>> import needleplan as npl
    >>> forever = npl.mdp.TabularMdp([[[1.0]]], costs=[[1.0]], discount=0.5)
    >>> npl.mdp.value_iteration(forever, tolerance=1e-9).values.round(6)
    array([2.])
    """
    return solve(mdp, method=Method.VALUE_ITERATION, tolerance=tolerance, max_sweeps=max_sweeps, progress=progress)


@dataclass(frozen=True, eq=False)
class Dependencies:
    """Dependency maps of states and partitions (Table 6.1 of the thesis).

    Attributes
    ----------
    states : tuple of ndarray of uint32
        For every state, the states that have an action leading to it (SDS).
    partitions : tuple of dict
        For every partition, the partitions that depend on it (PDP), each with its states that depend on it (SDP). A
        partition depends on itself if a step can stay inside.

    Examples
    --------
    >>> import needleplan as npl
    >>> forth = npl.mdp.TabularMdp([[[0.0, 1.0], [0.0, 1.0]]], costs=[[1.0], [1.0]], discount=0.5)
    >>> npl.mdp.dependencies(forth, labels=[0, 1]).states[1]
    array([0, 1], dtype=uint32)
    """

    states: tuple[NDArray[np.uint32], ...]
    partitions: tuple[dict[int, NDArray[np.uint32]], ...]


def dependencies(mdp: TabularMdp, labels: ArrayLike) -> Dependencies:
    """Return the dependency maps of a Markov decision process whose states are divided into partitions.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    labels : array_like of int, shape (S,)
        Number of the partition of every state.

    Returns
    -------
    Dependencies
        The maps of states and of partitions.

    Raises
    ------
    MdpError
        If `labels` does not hold one whole number per state.

    Examples
    --------
    >>> import needleplan as npl
    >>> forth = npl.mdp.TabularMdp([[[0.0, 1.0], [0.0, 1.0]]], costs=[[1.0], [1.0]], discount=0.5)
    >>> sorted(npl.mdp.dependencies(forth, labels=[0, 1]).partitions[1])
    [0, 1]
    """
    _require_mdp(mdp)
    maps = compiled_call(MdpError, mdp.compiled.dependencies, labels_of(labels, mdp.states))
    pairs = np.split(maps["sdp"], maps["sdp_offsets"][1:-1])
    spans = zip(maps["pdp_offsets"][:-1].tolist(), maps["pdp_offsets"][1:].tolist(), strict=True)
    return Dependencies(
        states=tuple(np.split(maps["sds"], maps["sds_offsets"][1:-1])),
        partitions=tuple({int(maps["pdp"][pair]): pairs[pair] for pair in range(*span)} for span in spans),
    )


def _require_mdp(mdp: object) -> None:
    if not isinstance(mdp, TabularMdp):
        raise MdpError(Mistake("mdp", repr(mdp), "must be a TabularMdp"))
