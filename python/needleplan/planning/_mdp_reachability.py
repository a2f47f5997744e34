"""The largest or least probability of reaching some states of a Markov decision process.

The probability of the best policy is a fixed point of x(s) = max over a of sum over s' of P(s' | s, a) x(s'), with 1 in
the goal, and 0 where the goal cannot be reached. It is the only one once no set of other states can be held forever.
Such sets (maximal end components) are made one state each; for the least probability, they have the probability 0. Then
the iterations from 0 and from 1 enclose the probability and converge to it (interval iteration; Haddad and Monmege
2018).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.config import Flag, Integer, Number
from needleplan.errors import MdpError, Mistake
from needleplan.planning._lattice import Status
from needleplan.planning._mdp import require_mdp
from needleplan.planning._mdp_input import argument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning._mdp_problem import TabularMdp

__all__ = ["Reachability", "reachability"]

# Sweeps without a narrower enclosure after which rounding is taken as the reason.
_PATIENCE = 1000


@dataclass(frozen=True, eq=False)
class Reachability(ShortRepr):
    """The probability of reaching a goal.

    Attributes
    ----------
    values : ndarray of float64, shape (S,)
        Probability of reaching the goal, under a policy for which it is largest (or least).
    policy : ndarray of uint32, shape (S,)
        Number of the action of that policy in every state; in states of the goal, and where the choice does not matter,
        that of the first action.
    error_bound : float
        Upper bound of the error of every value, rounding included.
    status : Status
        "converged" if the bound is at most the tolerance, otherwise "iteration_limit" or "precision_limit".

    Examples
    --------
    >>> import needleplan as npl
    >>> coin = npl.mdp.TabularMdp([[[0.5, 0.25, 0.25], [0, 1, 0], [0, 0, 1]]], costs=[[1.0]] * 3, discount=0.9)
    >>> npl.mdp.reachability(coin, [1]).values.round(5)
    array([0.5, 1. , 0. ])
    """

    values: NDArray[np.float64]
    policy: NDArray[np.uint32]
    error_bound: float
    status: Status


def reachability(
    mdp: TabularMdp,
    goal: Iterable[Hashable] | NDArray[Any],
    *,
    avoid: Iterable[Hashable] | NDArray[Any] = (),
    least: bool = False,
    tolerance: float = 1e-6,
    max_sweeps: int = 100_000,
) -> Reachability:
    """Compute the largest or least probability of reaching some states.

    Parameters
    ----------
    mdp : TabularMdp
        The process; its costs and its discount are not used.
    goal : iterable of states, or ndarray of bool, shape (S,)
        States to be reached: numbers, or names for a process made by `from_function`.
    avoid : as `goal`, optional
        States in which the goal counts as missed. A state of both is a goal.
    least : bool, default False
        Whether to compute the least probability over all policies instead of the largest.
    tolerance : float, default 1e-6
        Largest error of a probability.
    max_sweeps : int, default 100,000
        Number of sweeps after which the iteration ends in any case.

    Returns
    -------
    Reachability
        Probabilities, policy and bound.

    Raises
    ------
    MdpError
        If an argument is wrong; for a state that does not exist, the message names it.

    Examples
    --------
    >>> import needleplan as npl
    >>> def step(place, move):
    ...     return [(0.8, place + move, 0), (0.2, place - move, 0)] if 0 < place < 4 else None
    >>> walk = npl.mdp.TabularMdp.from_function(range(5), [-1, 1], step, discount=0.5)
    >>> best, worst = npl.mdp.reachability(walk, [4]), npl.mdp.reachability(walk, [4], least=True)
    >>> best.values.round(4), worst.values.round(4), best.policy[2]
    (array([0.    , 0.7529, 0.9412, 0.9882, 1.    ]), array([0.    , 0.0118, 0.0588, 0.2471, 1.    ]), np.uint32(1))
    """
    require_mdp(mdp)
    wanted = argument("tolerance", Number(above=0), tolerance)
    most_sweeps = argument("max_sweeps", Integer(1, 2**31 - 1), max_sweeps)
    smallest = bool(argument("least", Flag(), least))
    graph = _RowGraph.of(mdp)
    reached = _states(mdp, "goal", goal)
    ended = reached | _states(mdp, "avoid", avoid)
    inner = graph.acting & ~ended
    chosen = np.full(mdp.states, -1)
    if smallest:
        open_states = inner & ~graph.held(inner | (ended & ~reached) | ~(graph.acting | ended), inner, chosen)
        group, leaving = np.arange(mdp.states), open_states[graph.state]
    else:
        open_states = inner & graph.reaching(reached, inner)
        group, leaving = graph.end_components(open_states)
    lower, upper, status = graph.enclose(reached, open_states, group, leaving, smallest, wanted, most_sweeps, chosen)
    if not smallest:
        graph.lead(open_states, leaving, chosen)
    values = (lower + upper) / 2
    error = float((upper - lower).max(initial=0.0)) / 2 + np.finfo(float).eps
    first = mdp.layout.action_offsets[:-1]
    return Reachability(values, mdp.actions_of(np.maximum(chosen - first, 0).astype(np.uint32)), error, status)


def _states(mdp: TabularMdp, key: str, states: Iterable[Hashable] | NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mark for every state of a list of states or of a mask. Raises MdpError."""
    if isinstance(states, np.ndarray) and states.dtype == bool:
        if states.shape != (mdp.states,):
            raise MdpError(Mistake(key, f"shape {states.shape}", f"must have the shape ({mdp.states},), one a state"))
        return states
    marks = np.zeros(mdp.states, dtype=bool)
    try:
        marks[[mdp.index(state) for state in states]] = True
    except TypeError:
        raise MdpError(Mistake(key, repr(states), "must be a list of states, or one truth value per state")) from None
    return marks


@dataclass(frozen=True, eq=False)
class _RowGraph:
    """The rows of a process without entries of probability zero: state of every row, row of every entry."""

    state: NDArray[np.int64]
    row: NDArray[np.int64]
    successors: NDArray[np.int64]
    probabilities: NDArray[np.float64]
    acting: NDArray[np.bool_]
    longest: int

    @classmethod
    def of(cls, mdp: TabularMdp) -> _RowGraph:
        """Read the rows of a process; their probabilities are divided by their sums."""
        rows, lengths = mdp.compiled.rows(), np.diff(mdp.layout.action_offsets)
        state = np.repeat(np.arange(mdp.states), lengths)
        row = np.repeat(np.arange(len(state)), np.diff(rows["row_offsets"]))
        possible = rows["probabilities"] > 0
        row, chances = row[possible], rows["probabilities"][possible]
        chances = chances / np.bincount(row, chances, minlength=len(state))[row]
        successors = rows["successors"][possible].astype(np.int64)
        return cls(state, row, successors, chances, lengths > 0, mdp.layout.longest_row)

    def rows_within(self, states: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether all successors of a row are among the states."""
        within = np.ones(len(self.state), dtype=bool)
        within[self.row[~states[self.successors]]] = False
        return within

    def reaching(self, goal: NDArray[np.bool_], inner: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which states reach the goal with a positive probability under some policy, by steps from inner states."""
        from scipy import sparse
        from scipy.sparse.csgraph import breadth_first_order

        origin = self.state[self.row]
        used = inner[origin]
        # One more node leads to all states of the goal; edges are reversed.
        n = len(goal)
        tails = np.concatenate([self.successors[used], np.full(int(goal.sum()), n)])
        heads = np.concatenate([origin[used], np.flatnonzero(goal)])
        edges = sparse.csr_array((np.ones(len(tails), dtype=np.int8), (tails, heads)), shape=(n + 1, n + 1))
        found = np.zeros(n + 1, dtype=bool)
        found[breadth_first_order(edges, n, return_predecessors=False)] = True
        return found[:n]

    def held(self, states: NDArray[np.bool_], inner: NDArray[np.bool_], chosen: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return the largest subset in which every inner state has a row that stays; note these rows."""
        while True:
            staying = self.rows_within(states)
            able = np.zeros(len(states), dtype=bool)
            able[self.state[staying]] = True
            fewer = states & (able | ~inner)
            if (fewer == states).all():
                break
            states = fewer
        rows = np.flatnonzero(staying & inner[self.state])[::-1]  # the first row is written last
        chosen[self.state[rows]] = rows
        return states

    def end_components(self, states: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the maximal end component of every state, and the rows of the given states that leave theirs."""
        from scipy import sparse
        from scipy.sparse.csgraph import connected_components

        n, rows = len(states), states[self.state] & self.rows_within(states)
        while True:
            used = rows[self.row]
            origin = self.state[self.row][used]
            entries = np.ones(len(origin), dtype=np.int8)
            edges = sparse.csr_array((entries, (origin, self.successors[used])), shape=(n, n))
            group = connected_components(edges, connection="strong")[1].astype(np.int64)
            crossing = group[self.state[self.row]] != group[self.successors]
            fewer = rows & (np.bincount(self.row, crossing, minlength=len(rows)) == 0)
            if (fewer == rows).all():
                return group, states[self.state] & ~rows
            rows = fewer

    def enclose(
        self,
        goal: NDArray[np.bool_],
        open_states: NDArray[np.bool_],
        group: NDArray[np.int64],
        leaving: NDArray[np.bool_],
        smallest: bool,
        wanted: float,
        most_sweeps: int,
        chosen: NDArray[np.int64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], Status]:
        """Iterate bounds of the probability from 0 and 1; note the best rows of the open states."""
        from scipy import sparse

        rows = np.flatnonzero(leaving)
        rows = rows[np.argsort(group[self.state[rows]], kind="stable")]
        owners = group[self.state[rows]]
        starts = np.flatnonzero(np.diff(owners, prepend=-1))
        matrix = sparse.csr_array(
            (self.probabilities, (self.row, self.successors)), shape=(len(self.state), len(goal))
        )[rows]
        lower, upper = goal.astype(float), (goal | open_states).astype(float)
        if not len(rows):
            return lower, upper, Status.CONVERGED
        # Every sum of products is rounded outwards by the bound of its rounding.
        rounding = (self.longest + 4) * np.finfo(float).eps
        place = np.full(int(group.max()) + 1, -1)
        place[owners[starts]] = np.arange(len(starts))
        targets = np.flatnonzero(open_states)
        best = np.minimum if smallest else np.maximum
        status, gap = Status.ITERATION_LIMIT, np.inf
        for sweep in range(most_sweeps):
            ends = [best.reduceat(matrix @ bound, starts)[place[group[targets]]] for bound in (lower, upper)]
            lower[targets] = np.maximum(lower[targets], ends[0] - rounding)
            upper[targets] = np.minimum(upper[targets], ends[1] + rounding)
            width = float((upper - lower).max())
            if width <= 2 * (wanted - np.finfo(float).eps):
                status = Status.CONVERGED
                break
            if sweep % _PATIENCE == _PATIENCE - 1:
                if width >= gap:
                    status = Status.PRECISION_LIMIT
                    break
                gap = width
        values = matrix @ ((lower + upper) / 2)
        optimum = np.repeat(best.reduceat(values, starts), np.diff(np.append(starts, len(rows))))
        attained = rows[values == optimum][::-1]  # the first row is written last
        chosen[self.state[attained]] = attained
        return lower, upper, status

    def lead(
        self,
        open_states: NDArray[np.bool_],
        leaving: NDArray[np.bool_],
        chosen: NDArray[np.int64],
    ) -> None:
        """Note rows that lead the states of an end component to the state in which the best row leaves it."""
        exits = open_states & (chosen >= 0)
        inside = open_states[self.state] & ~leaving
        while True:
            towards = np.zeros(len(self.state), dtype=bool)
            towards[self.row[exits[self.successors]]] = True
            towards &= inside & ~exits[self.state]
            if not towards.any():
                return
            rows = np.flatnonzero(towards)[::-1]
            chosen[self.state[rows]] = rows
            exits[self.state[rows]] = True
