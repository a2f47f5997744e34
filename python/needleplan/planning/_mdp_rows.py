"""The rows of an MDP: their states and actions, their sums, and rows made of functions and transition tables."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.errors import MdpError, Mistake
from needleplan.planning._mdp_input import SparseRows, whole_numbers

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["RowLayout", "gymnasium_steps", "normalised", "rows_of_function"]

# Largest difference of the sum of a row from one that is taken for rounding, and removed.
_ROUNDED_SUM = 1e-6

# Largest difference of the sum of a row from one that the solver accepts.
_EXACT_SUM = 1e-9

_Step = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class RowLayout:
    """Which state and action every row belongs to; without `action_of_row`, actions are positions of rows."""

    action_offsets: NDArray[np.int64]
    action_of_row: NDArray[np.uint32] | None
    actions: int
    longest_row: int

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.action_offsets) - 1

    def actions_of(self, choices: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Convert positions among the actions of each state to numbers of actions; 0 in a terminal state."""
        if self.action_of_row is None:
            return choices
        first, actions = self.action_offsets[:-1], np.zeros_like(choices)
        acting = self.action_offsets[1:] > first
        actions[acting] = self.action_of_row[first[acting] + choices[acting]]
        return actions

    def choices_of(self, policy: ArrayLike) -> NDArray[np.uint32]:
        """Convert numbers of actions to positions among the actions of each state. Raises MdpError."""
        chosen = whole_numbers("policy", policy, np.uint32)
        if chosen.shape != (self.states,):
            raise MdpError(Mistake("policy", f"shape {chosen.shape}", f"must have the shape ({self.states},)"))
        states, places, actions = self._rows()
        choices = np.zeros(self.states, dtype=np.uint32)
        taken = actions == chosen[states]
        choices[states[taken]] = places[taken]
        missing = np.diff(self.action_offsets) > 0
        missing[states[taken]] = False
        if missing.any():
            state = int(np.argmax(missing))
            raise MdpError(Mistake(f"policy[{state}]", str(chosen[state]), "must be an action that is available there"))
        return choices

    def by_action(self, rows: NDArray[np.float64], absent: float) -> NDArray[np.float64]:
        """Arrange a number for every row by state and action, (S, A), with `absent` where there is no row."""
        states, _, actions = self._rows()
        table = np.full((self.states, self.actions), absent)
        table[states, actions] = rows
        return table

    def least(self, rows: NDArray[np.float64], terminal: NDArray[np.float64]) -> tuple[Any, NDArray[np.uint32]]:
        """Return the least of the numbers of the rows of every state, and its position; `terminal` without rows."""
        values, choices = terminal.copy(), np.zeros(self.states, dtype=np.uint32)
        first, acting = self.action_offsets[:-1], np.diff(self.action_offsets) > 0
        if acting.any():
            values[acting] = np.minimum.reduceat(rows, first[acting])
            states, places, _ = self._rows()
            best = np.flatnonzero(rows == values[states])[::-1]  # of equal numbers the first is written last
            choices[states[best]] = places[best]
        return values, choices

    def _rows(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the state, the position among the rows of the state, and the action of every row."""
        states = np.repeat(np.arange(self.states), np.diff(self.action_offsets))
        places = np.arange(len(states)) - self.action_offsets[states]
        return states, places, places if self.action_of_row is None else self.action_of_row.astype(np.int64)


def normalised(rows: SparseRows) -> tuple[SparseRows, tuple[str, ...]]:
    """Divide the rows whose sums differ from one by up to `_ROUNDED_SUM` by their sums; return a remark on them."""
    slight = (rows.probabilities > 1) & (rows.probabilities <= 1 + _EXACT_SUM)
    if slight.any():  # a sum of duplicate entries of a sparse matrix
        rows = replace(rows, probabilities=np.where(slight, 1.0, rows.probabilities))
    offsets, count = rows.row_offsets, len(rows.row_offsets) - 1
    regular = count > 0 and offsets[0] == 0 and offsets[-1] == len(rows.probabilities) and (np.diff(offsets) > 0).all()
    if not regular:  # the compiled constructor names the rule
        return rows, ()
    sums = np.add.reduceat(rows.probabilities, offsets[:-1])
    deviations = np.abs(sums - 1)
    rounded = (deviations > _EXACT_SUM) & (deviations <= _ROUNDED_SUM)
    if not rounded.any():
        return rows, ()
    divisors = np.repeat(np.where(rounded, sums, 1.0), np.diff(offsets))
    remark = (
        f"{int(rounded.sum()):,} of {count:,} rows do not sum to one, by at most {deviations[rounded].max():.1e}: "
        "their probabilities are divided by their sums"
    )
    return replace(rows, probabilities=rows.probabilities / divisors), (remark,)


def rows_of_function(
    states: Sequence[Hashable], actions: Sequence[Hashable], step: _Step, sign: float
) -> tuple[SparseRows, NDArray[np.uint32], dict[Hashable, int]]:
    """Call `step` for all states and actions; return rows, action of every row, index of every state."""
    index = {state: number for number, state in enumerate(states)}
    if len(index) != len(states):
        raise MdpError(Mistake("states", repr(states), "must not hold a state twice"))
    action_offsets, row_offsets, action_of_row = [0], [0], []
    successors: list[int] = []
    probabilities: list[float] = []
    stage_costs: list[float] = []
    for state in states:
        for number, action in enumerate(actions):
            place = f"step({state!r}, {action!r})"
            outcomes = list(step(state, action) or ())
            if not outcomes:
                continue
            cost = 0.0
            for outcome in outcomes:
                try:
                    probability, following, amount = outcome
                    cost += float(probability) * float(amount)
                    successors.append(index[following])
                    probabilities.append(float(probability))
                except (TypeError, ValueError):
                    rule = "must return (probability, next state, cost) for every outcome"
                    raise MdpError(Mistake(place, repr(outcome), rule)) from None
                except KeyError:
                    raise MdpError(Mistake(place, repr(following), "must be one of the states")) from None
            action_of_row.append(number)
            stage_costs.append(sign * cost)
            row_offsets.append(len(successors))
        action_offsets.append(len(stage_costs))
    rows = SparseRows(
        np.array(action_offsets),
        np.array(row_offsets),
        np.array(successors, dtype=np.uint32),
        np.array(probabilities, dtype=np.float64),
        np.array(stage_costs, dtype=np.float64),
    )
    return rows, np.array(action_of_row, dtype=np.uint32), index


def gymnasium_steps(table: Any) -> tuple[int, int, _Step]:
    """Return the numbers of states and actions and the step function of a gymnasium table or environment.

    If a transition terminates, there is one more state, to which terminated transitions lead. Raises MdpError.
    """
    table = getattr(getattr(table, "unwrapped", table), "P", table)
    try:
        count = len(table)
        actions = max(len(table[state]) for state in range(count))
        rows = [[table[state].get(action, []) for action in range(actions)] for state in range(count)]
        steps = [
            [[(p, next, reward, bool(over)) for p, next, reward, over in row] for row in state_rows]
            for state_rows in rows
        ]
    except (AttributeError, TypeError, KeyError, IndexError, ValueError):
        rule = "must hold lists of (probability, next state, reward, terminated) at [state][action]"
        raise MdpError(Mistake("table", type(table).__name__, rule)) from None
    ended = any(over for step in steps for row in step for *_, over in row)

    def step(state: int, action: int) -> list[tuple[float, int, float]]:
        if state == count:
            return []
        return [(p, count if over else following, reward) for p, following, reward, over in steps[state][action]]

    return count + ended, actions, step
