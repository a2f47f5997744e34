"""The solver for anybody's finite Markov decision process.

Minimise the expected discounted cost, V(s) = min_a [c(s, a) + discount * sum_s' P(s' | s, a) V(s')].

::

    problem = TabularMdp([stay, go], costs, discount=0.95)      # S x S matrices per action, costs [S, A]
    solution = solve(problem, tolerance=1e-6)
    solution.values, solution.policy, solution.stats.error_bound
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan import _ppvi
from needleplan.errors import MdpError, Mistake
from needleplan.planning._lattice import Progress, Stats
from needleplan.scenario import Method, Priority

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Dependencies", "Solution", "TabularMdp", "dependencies", "solve", "value_iteration"]


@dataclass(frozen=True)
class _Rows:
    """An MDP in compressed sparse rows: rows `action_offsets[s]` to `action_offsets[s + 1]` are the actions of s."""

    action_offsets: NDArray[np.int64]
    row_offsets: NDArray[np.int64]
    successors: NDArray[np.uint32]
    probabilities: NDArray[np.float64]
    stage_costs: NDArray[np.float64]


class TabularMdp:
    """A finite MDP of S states and A actions, made of sparse or dense matrices.

    `transitions` holds one S x S matrix per action (scipy.sparse, or an array), `costs` [S, A] expected stage costs,
    `discount` lies in (0, 1]. An empty row means that the action is not to be had in that state; a state without any
    action is terminal, with value 0. Raises MdpError naming the first state and action that break a rule.
    """

    def __init__(self, transitions: Sequence[Any] | NDArray[np.float64], costs: ArrayLike, discount: float) -> None:
        try:
            matrices = [_compressed(matrix) for matrix in transitions]
            stage_costs = np.asarray(costs, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise MdpError(f"transitions and costs must be matrices of numbers: {error}") from None
        self.states, self.actions = len(matrices[0][0]) - 1 if matrices else 0, len(matrices)
        if stage_costs.shape != (self.states, self.actions):
            rule = f"must have the shape (states, actions) = {(self.states, self.actions)}"
            raise MdpError(Mistake("costs", f"shape {stage_costs.shape}", rule))
        rows, self._action_of_row = _interleaved(matrices, stage_costs)
        self._open(rows, discount)

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
        """Make an MDP of compressed sparse rows, which need not have the same number of actions in every state.

        Row r belongs to the state s with `action_offsets[s]` <= r < `action_offsets[s + 1]`, costs `stage_costs[r]` and
        leads to `successors[i]` with `probabilities[i]`, `row_offsets[r]` <= i < `row_offsets[r + 1]`.
        Raises MdpError.
        """
        try:
            rows = _Rows(
                np.ascontiguousarray(action_offsets, dtype=np.int64),
                np.ascontiguousarray(row_offsets, dtype=np.int64),
                np.ascontiguousarray(successors, dtype=np.uint32),
                np.ascontiguousarray(probabilities, dtype=np.float64),
                np.ascontiguousarray(stage_costs, dtype=np.float64),
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise MdpError(f"rows must be arrays of numbers: {error}") from None
        mdp = cls.__new__(cls)
        mdp.states = len(rows.action_offsets) - 1
        mdp.actions = int(np.diff(rows.action_offsets).max(initial=0))
        mdp._action_of_row = None
        mdp._open(rows, discount)
        return mdp

    states: int
    actions: int
    _action_of_row: NDArray[np.uint32] | None

    def _open(self, rows: _Rows, discount: float) -> None:
        self._action_offsets = rows.action_offsets
        try:
            self.compiled = _ppvi.Tabular(**vars(rows), discount=discount)
        except (ValueError, TypeError, MemoryError) as error:
            raise MdpError(str(error)) from None

    def actions_of(self, choices: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Return the actions [S] that are the `choices`-th to be had in each state; 0 in a terminal state."""
        if self._action_of_row is None:
            return choices
        first, end = self._action_offsets[:-1], self._action_offsets[1:]
        actions = np.zeros_like(choices)
        alive = end > first
        actions[alive] = self._action_of_row[first[alive] + choices[alive]]
        return actions


@dataclass(frozen=True, eq=False)
class Solution:
    """Optimal values [S], a greedy policy [S] of action numbers, and how the solve went."""

    values: NDArray[np.float64]
    policy: NDArray[np.uint32]
    stats: Stats


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
    """Solve an MDP. `labels` [S] assigns states to partitions; the other arguments are those of `Solver` in a scenario.

    With a discount below one the solve ends at a Bellman residual below (1 - discount) * tolerance.
    Raises MdpError. `progress` as for `plan`.
    """
    began = perf_counter()
    try:
        solved = mdp.compiled.solve(
            method=Method(method).value,
            labels=None if labels is None else _one_a_state(labels, mdp.states),
            priority=Priority(priority).value,
            tolerance=tolerance,
            max_sweeps=max_sweeps,
            time_limit_s=time_limit_s,
            threads=threads,
            progress=progress,
        )
    except (ValueError, TypeError, OverflowError, MemoryError) as error:
        raise MdpError(str(error)) from error
    stats = Stats.of(solved, mdp.states, perf_counter() - began)
    return Solution(solved["values"], mdp.actions_of(solved["policy"]), stats)


def value_iteration(
    mdp: TabularMdp, *, tolerance: float = 0.01, max_sweeps: int | None = None, progress: Progress | None = None
) -> Solution:
    """Solve an MDP by plain value iteration, the readable reference. Arguments and errors as for `solve`."""
    return solve(mdp, method=Method.VALUE_ITERATION, tolerance=tolerance, max_sweeps=max_sweeps, progress=progress)


@dataclass(frozen=True, eq=False)
class Dependencies:
    """Who depends on whom: Table 6.1 of the thesis.

    `states` holds, for every state, the states with an action that can lead to it (SDS). `partitions` holds, for every
    partition, the partitions that depend on it (PDP, itself among them where a step can stay inside), each with those
    of its states that do (SDP of the one within the other).
    """

    states: tuple[NDArray[np.uint32], ...]
    partitions: tuple[dict[int, NDArray[np.uint32]], ...]


def dependencies(mdp: TabularMdp, labels: ArrayLike) -> Dependencies:
    """Return the dependency maps of an MDP whose states `labels` [S] assigns to partitions. Raises MdpError."""
    try:
        maps = mdp.compiled.dependencies(_one_a_state(labels, mdp.states))
    except (ValueError, TypeError, OverflowError) as error:
        raise MdpError(str(error)) from error
    pairs = np.split(maps["sdp"], maps["sdp_offsets"][1:-1])
    spans = zip(maps["pdp_offsets"][:-1].tolist(), maps["pdp_offsets"][1:].tolist(), strict=True)
    return Dependencies(
        states=tuple(np.split(maps["sds"], maps["sds_offsets"][1:-1])),
        partitions=tuple({int(maps["pdp"][pair]): pairs[pair] for pair in range(*span)} for span in spans),
    )


def _one_a_state(labels: ArrayLike, states: int) -> NDArray[np.uint32]:
    """Return the labels as an array. Raises ValueError."""
    array = np.ascontiguousarray(labels, dtype=np.uint32)
    if array.shape != (states,):
        raise ValueError(f"labels must have the shape ({states},), one a state, not {array.shape}")
    return array


def _compressed(matrix: Any) -> tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.float64]]:
    """Return offsets, columns and entries of a square matrix. Raises ValueError."""
    shape = np.shape(matrix) if not hasattr(matrix, "tocsr") else matrix.shape
    if len(shape) != 2 or shape[0] != shape[1]:
        raise ValueError(f"a matrix has the shape {shape}, which is not square")
    if hasattr(matrix, "tocsr"):
        rows = matrix.tocsr()
        return rows.indptr.astype(np.int64), rows.indices.astype(np.uint32), rows.data.astype(np.float64)
    dense = np.asarray(matrix, dtype=np.float64)
    row, column = np.nonzero(dense)
    offsets = np.concatenate(([0], np.cumsum(np.bincount(row, minlength=len(dense)))))
    return offsets.astype(np.int64), column.astype(np.uint32), dense[row, column]


def _interleaved(
    matrices: Sequence[tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.float64]]], costs: NDArray[np.float64]
) -> tuple[_Rows, NDArray[np.uint32]]:
    """Merge the rows of the actions state by state, empty rows left out; also return the action of every row."""
    states, actions = costs.shape
    if any(len(offsets) != states + 1 for offsets, _, _ in matrices):
        raise MdpError("all transition matrices must have the same shape")
    lengths = np.stack([np.diff(offsets) for offsets, _, _ in matrices], axis=1)
    starts = np.concatenate(([0], np.cumsum(lengths.ravel())))
    successors = np.empty(starts[-1], dtype=np.uint32)
    probabilities = np.empty(starts[-1], dtype=np.float64)
    for action, (offsets, columns, entries) in enumerate(matrices):
        places = np.repeat(starts[action:-1:actions] - offsets[:-1], lengths[:, action]) + np.arange(len(columns))
        successors[places] = columns
        probabilities[places] = entries
    there = lengths > 0
    rows = _Rows(
        action_offsets=np.concatenate(([0], np.cumsum(there.sum(axis=1)))).astype(np.int64),
        row_offsets=np.concatenate(([0], np.cumsum(lengths[there]))).astype(np.int64),
        successors=successors,
        probabilities=probabilities,
        stage_costs=costs[there],
    )
    return rows, np.broadcast_to(np.arange(actions, dtype=np.uint32), costs.shape)[there]
