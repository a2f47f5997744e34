"""Checks of the arguments of the MDP solver, and conversion of matrices and costs to compressed sparse rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from needleplan.config import Rule, Violation, shown
from needleplan.errors import MdpError, Mistake

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "SparseRows",
    "argument",
    "compressed",
    "interleaved",
    "labels_of",
    "numbers",
    "stage_costs_of",
    "whole_numbers",
]


_Integer = TypeVar("_Integer", bound=np.integer)
_Matrix = tuple["NDArray[np.int64]", "NDArray[np.uint32]", "NDArray[np.float64]"]


@dataclass(frozen=True)
class SparseRows:
    """An MDP in compressed sparse rows: rows `action_offsets[s]` to `action_offsets[s + 1]` are the actions of s."""

    action_offsets: NDArray[np.int64]
    row_offsets: NDArray[np.int64]
    successors: NDArray[np.uint32]
    probabilities: NDArray[np.float64]
    stage_costs: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, array in vars(self).items():
            if array.ndim != 1:
                raise MdpError(Mistake(name, f"shape {array.shape}", "must have one dimension"))


def numbers(key: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return `value` as a float64 array. Raises MdpError if it is not an array of numbers."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "cMm":
            return np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    raise MdpError(Mistake(key, repr(value), "must be an array of numbers"))


def whole_numbers(key: str, value: ArrayLike, kind: type[_Integer]) -> NDArray[_Integer]:
    """Return `value` as an array of the integer type `kind`. Raises MdpError unless all are whole numbers from 0."""
    array = value if isinstance(value, np.ndarray) and value.dtype.kind in "iu" else numbers(key, value)
    most = np.iinfo(kind).max
    whole = np.issubdtype(array.dtype, np.integer) or np.all(array == np.rint(array))
    if array.size and not (whole and array.min() >= 0 and array.max() <= most):
        raise MdpError(Mistake(key, repr(value), f"must be an array of whole numbers from 0 to {most:,}"))
    return np.ascontiguousarray(array, dtype=kind)


def compressed(matrix: Any, key: str) -> _Matrix:
    """Return row offsets, column numbers and values of the entries of a square matrix. Raises MdpError."""
    sparse = hasattr(matrix, "tocsr")
    dense = None if sparse else numbers(key, matrix)
    shape = matrix.shape if dense is None else dense.shape
    if len(shape) != 2 or shape[0] != shape[1]:
        raise MdpError(Mistake(key, f"shape {shape}", "must be a square matrix"))
    if dense is None:
        rows = matrix.tocsr()
        return rows.indptr.astype(np.int64), rows.indices.astype(np.uint32), rows.data.astype(np.float64)
    row, column = np.nonzero(dense)
    offsets = np.concatenate(([0], np.cumsum(np.bincount(row, minlength=len(dense)))))
    return offsets.astype(np.int64), column.astype(np.uint32), dense[row, column]


def stage_costs_of(key: str, given: Any, matrices: Sequence[_Matrix]) -> NDArray[np.float64]:
    """Return expected stage costs (or rewards), (S, A), of any layout that `TabularMdp` takes. Raises MdpError."""
    states, actions = len(matrices[0][0]) - 1, len(matrices)
    rule = f"must have the shape (states, actions) = {(states, actions)}, (states,), or (actions, states, states)"
    if isinstance(given, (list, tuple)) and any(hasattr(part, "tocsr") for part in given):
        if len(given) != actions or any(getattr(part, "shape", None) != (states, states) for part in given):
            raise MdpError(Mistake(key, f"{len(given)} matrices", rule))
        expected = np.empty((states, actions))
        for action, (part, (offsets, columns, entries)) in enumerate(zip(given, matrices, strict=True)):
            rows = np.repeat(np.arange(states), np.diff(offsets))
            amounts = np.asarray(part.tocsr()[rows, columns]).ravel() if len(rows) else np.empty(0)
            expected[:, action] = np.bincount(rows, entries * amounts, minlength=states)
        return expected
    array = numbers(key, given)
    if array.shape == (states, actions):
        return array
    if array.shape == (states,):
        return np.repeat(array[:, None], actions, axis=1)
    if array.shape != (actions, states, states):
        raise MdpError(Mistake(key, f"shape {array.shape}", rule))
    expected = np.empty((states, actions))
    for action, (offsets, columns, entries) in enumerate(matrices):
        rows = np.repeat(np.arange(states), np.diff(offsets))
        possible = entries > 0
        amounts = entries[possible] * array[action, rows[possible], columns[possible]]
        expected[:, action] = np.bincount(rows[possible], amounts, minlength=states)
    return expected


def interleaved(matrices: Sequence[_Matrix], costs: NDArray[np.float64]) -> tuple[SparseRows, NDArray[np.uint32]]:
    """Return the rows of all actions, ordered by state and without empty rows, and the action of every row.

    A row of infinite cost is left out. Raises MdpError if a state loses all its rows by that.
    """
    states, actions = costs.shape
    if any(len(offsets) != states + 1 for offsets, _, _ in matrices):
        raise MdpError(Mistake("transitions", "", "all matrices must have the same shape"))
    lengths = np.stack([np.diff(offsets) for offsets, _, _ in matrices], axis=1)
    forbidden = costs == np.inf
    lost = (lengths > 0).any(axis=1) & ((lengths == 0) | forbidden).all(axis=1)
    if lost.any():
        rule = "must leave an action; a terminal state has empty rows in all matrices"
        raise MdpError(Mistake(f"the infinite costs of state {int(np.argmax(lost))}", "", rule))
    if forbidden.any():
        kept = [np.repeat(~forbidden[:, action], lengths[:, action]) for action in range(actions)]
        lengths = np.where(forbidden, 0, lengths)
        matrices = [
            (np.concatenate(([0], np.cumsum(lengths[:, action]))), columns[kept[action]], entries[kept[action]])
            for action, (_, columns, entries) in enumerate(matrices)
        ]
    starts = np.concatenate(([0], np.cumsum(lengths.ravel())))
    successors = np.empty(starts[-1], dtype=np.uint32)
    probabilities = np.empty(starts[-1], dtype=np.float64)
    for action, (offsets, columns, entries) in enumerate(matrices):
        places = np.repeat(starts[action:-1:actions] - offsets[:-1], lengths[:, action]) + np.arange(len(columns))
        successors[places] = columns
        probabilities[places] = entries
    available = lengths > 0
    rows = SparseRows(
        action_offsets=np.concatenate(([0], np.cumsum(available.sum(axis=1)))).astype(np.int64),
        row_offsets=np.concatenate(([0], np.cumsum(lengths[available]))).astype(np.int64),
        successors=successors,
        probabilities=probabilities,
        stage_costs=costs[available],
    )
    return rows, np.broadcast_to(np.arange(actions, dtype=np.uint32), costs.shape)[available]


def argument(key: str, rule: Rule, value: object) -> Any:
    """Return the value of an argument after reading it by its rule. Raises MdpError."""
    try:
        return rule.read(value)
    except Violation as violation:
        raise MdpError(Mistake(key, shown(value), str(violation))) from None


def labels_of(labels: ArrayLike, states: int) -> NDArray[np.uint32]:
    """Return the partition number of each state as an array. Raises MdpError."""
    array = whole_numbers("labels", labels, np.uint32)
    if array.shape != (states,):
        raise MdpError(Mistake("labels", f"shape {array.shape}", f"must have the shape ({states},), one a state"))
    return array
