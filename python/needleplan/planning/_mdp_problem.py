"""A finite Markov decision process, and the layouts of arrays that it is made of."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan import _ppvi
from needleplan.artifacts import short_html
from needleplan.config import Number
from needleplan.errors import MdpError, Mistake
from needleplan.planning._lattice import compiled_call
from needleplan.planning._mdp_input import (
    SparseRows,
    argument,
    compressed,
    interleaved,
    numbers,
    stage_costs_of,
    whole_numbers,
)  # fmt: skip
from needleplan.planning._mdp_rows import RowLayout, gymnasium_steps, normalised, rows_of_function

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["TabularMdp"]

_DISCOUNT = Number(above=0, at_most=1)


class TabularMdp:
    """A finite Markov decision process of S states and A actions.

    Parameters
    ----------
    transitions : sequence of (S, S) matrices
        One matrix of transition probabilities per action: scipy.sparse or an array. An empty row means that the action
        is not available in that state. A state without any action is terminal and has the value 0. Rows that differ
        from a sum of one by at most 1e-6 are divided by their sums; `remarks` says so.
    costs : array_like of float, shape (S, A), (S,) or (A, S, S), or sequence of A sparse matrices (S, S), optional
        Stage costs: expected ones, or those of each transition. An infinite expected cost means that the action is not
        available.
    discount : float, default 1
        Discount factor in (0, 1]. With 1, no cost may be negative, and no loop may consist of actions of cost 0.
    rewards : as `costs`, optional
        Rewards instead of costs; exactly one of the two is given. The values of solutions are then expected rewards,
        which are maximised. An expected reward of minus infinity means that the action is not available.

    Attributes
    ----------
    states : int
        Number of states S.
    actions : int
        Number of actions A.
    discount : float
        Discount factor.
    rewards : bool
        Whether values are rewards and maximised.
    sign : float
        Factor between the values of solutions and costs: 1, or -1 for rewards.
    remarks : tuple of str
        Changes that were made to the input.

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

    layout: RowLayout

    states: int
    actions: int
    discount: float
    rewards: bool
    sign: float
    remarks: tuple[str, ...]
    _index: dict[Hashable, int] | None = None

    def __init__(
        self,
        transitions: Sequence[Any] | NDArray[np.float64],
        costs: ArrayLike | Sequence[Any] | None = None,
        discount: float = 1.0,
        *,
        rewards: ArrayLike | Sequence[Any] | None = None,
    ) -> None:
        try:
            parts = [] if isinstance(transitions, str) else list(transitions)
        except TypeError:
            parts = []
        if not parts:
            rule = "must be a sequence of square matrices of numbers, one per action"
            raise MdpError(Mistake("transitions", repr(transitions), rule))
        matrices = [compressed(matrix, f"transitions[{action}]") for action, matrix in enumerate(parts)]
        if any(len(offsets) != len(matrices[0][0]) for offsets, _, _ in matrices):
            raise MdpError(Mistake("transitions", "", "all matrices must have the same shape"))
        if (costs is None) == (rewards is None):
            raise MdpError(Mistake("costs", repr(costs), "must be given, or rewards instead, and not both"))
        self.states, self.actions, self.rewards = len(matrices[0][0]) - 1, len(matrices), rewards is not None
        key, amounts = ("costs", costs) if rewards is None else ("rewards", rewards)
        self.sign = -1.0 if self.rewards else 1.0
        stage_costs = self.sign * stage_costs_of(key, amounts, matrices)
        self._compile(*interleaved(matrices, stage_costs), discount)

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
        mdp.rewards, mdp.sign = False, 1.0
        mdp._compile(rows, None, discount)
        return mdp

    @classmethod
    def from_function(
        cls,
        states: Iterable[Hashable],
        actions: Iterable[Hashable],
        step: Callable[[Any, Any], Iterable[tuple[float, Any, float]] | None],
        discount: float = 1.0,
        *,
        rewards: bool = False,
    ) -> TabularMdp:
        """Make an MDP of a function that tells the outcomes of a step.

        Parameters
        ----------
        states : iterable of hashable
            The states, by any names.
        actions : iterable of hashable
            The actions, by any names.
        step : callable
            `step(state, action)` returns (probability, next state, cost) for every outcome; nothing or None if the
            action is not available. A state without any action is terminal.
        discount : float, default 1
            Discount factor in (0, 1].
        rewards : bool, default False
            Whether `step` returns rewards instead of costs.

        Returns
        -------
        TabularMdp
            The process; `index` returns the number of a state. Actions are numbered in the given order.

        Raises
        ------
        MdpError
            If a rule is broken; the message names the state and the action.

        Examples
        --------
        >>> import needleplan as npl
        >>> def step(place, move):
        ...     return [(0.9, place + move, 1), (0.1, place, 1)] if 0 <= place + move <= 3 and place < 3 else None
        >>> walk = npl.mdp.TabularMdp.from_function(range(4), [-1, 1], step)
        >>> npl.mdp.solve(walk, tolerance=1e-9).values.round(3)
        array([3.333, 2.222, 1.111, 0.   ])
        """
        if not callable(step):
            raise MdpError(Mistake("step", repr(step), "must be a function of a state and an action"))
        try:
            every_state, every_action = list(states), list(actions)
            sign = -1.0 if rewards else 1.0
            rows, action_of_row, index = rows_of_function(every_state, every_action, step, sign)
        except TypeError as error:
            raise MdpError(Mistake("states, actions", str(error), "must be iterables of hashable names")) from None
        mdp = cls.__new__(cls)
        mdp.states, mdp.actions, mdp.rewards = len(every_state), len(every_action), bool(rewards)
        mdp.sign, mdp._index = sign, index
        mdp._compile(rows, action_of_row, discount)
        return mdp

    @classmethod
    def from_gymnasium(cls, table: Any, discount: float = 1.0) -> TabularMdp:
        """Make an MDP of the transition table of a gymnasium environment.

        Parameters
        ----------
        table : mapping or environment
            `table[state][action]` lists (probability, next state, reward, terminated); or an environment whose
            `unwrapped.P` is such a table. States and actions are numbered from 0.
        discount : float, default 1
            Discount factor in (0, 1].

        Returns
        -------
        TabularMdp
            The process, which maximises rewards. If a transition terminates, one state is added at the end: terminated
            transitions lead there, whatever their next state.

        Raises
        ------
        MdpError
            If the table is not of this form, or breaks a rule.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = {0: {0: [(0.5, 0, 0.0, False), (0.5, 1, 1.0, True)]}, 1: {0: [(1.0, 1, 0.0, True)]}}
        >>> npl.mdp.solve(npl.mdp.TabularMdp.from_gymnasium(table, 0.9), tolerance=1e-9).values.round(3)
        array([0.909, 0.   , 0.   ])
        """
        states, actions, step = gymnasium_steps(table)
        mdp = cls.from_function(range(states), range(actions), step, discount, rewards=True)
        mdp._index = None
        return mdp

    def index(self, state: Hashable) -> int:
        """Return the number of a state by its name.

        Parameters
        ----------
        state : hashable
            A state as given to `from_function`; otherwise its number.

        Returns
        -------
        int
            The number, from 0.

        Raises
        ------
        MdpError
            If there is no such state.

        Examples
        --------
        >>> import needleplan as npl
        >>> step = lambda state, action: [(1.0, "done", 1.0)] if state == "busy" else None
        >>> npl.mdp.TabularMdp.from_function(["busy", "done"], [0], step).index("done")
        1
        """
        names = range(self.states) if self._index is None else self._index
        if state not in names:
            raise MdpError(Mistake("state", repr(state), "must be one of the states"))
        return int(state) if self._index is None else self._index[state]  # type: ignore[call-overload]

    def _compile(self, rows: SparseRows, action_of_row: NDArray[np.uint32] | None, discount: float) -> None:
        rows, self.remarks = normalised(rows)
        longest = int(np.diff(rows.row_offsets).max(initial=0))
        self.layout = RowLayout(rows.action_offsets, action_of_row, self.actions, longest)
        self.discount = argument("discount", _DISCOUNT, discount)
        self.compiled: _ppvi.Tabular = compiled_call(MdpError, _ppvi.Tabular, **vars(rows), discount=self.discount)

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
        return self.layout.actions_of(choices)

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return f"<TabularMdp: {self.states:,} states, {self.actions} actions>"
