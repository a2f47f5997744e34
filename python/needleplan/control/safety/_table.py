"""The transition table of docs/reference/transitions.csv, computed from the function `advance`.

`python -m needleplan.control.safety._table` prints the table.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from needleplan.control.safety._causes import Cause
from needleplan.control.safety._states import (
    InputReport,
    MotionOrder,
    OperatingState,
    Order,
    Ordered,
    Owner,
    SafetyState,
    advance,
)

__all__ = ["transition_table"]

_STALE = frozenset({Cause.FORCE_STALE})
_DISABLED, _ENABLED, _PAUSED, _FAULT = OperatingState
_STATES = {
    "DISABLED": SafetyState(is_homed=True),
    "DISABLED, latched": SafetyState(is_homed=True, latched=_STALE, held_by=Owner.SENSOR),
    "ENABLED": SafetyState(_ENABLED, is_homed=True, motion=Owner.LOOP),
    "PAUSED by a cause": SafetyState(_PAUSED, is_homed=True, held_by=Owner.SENSOR),
    "PAUSED by a person": SafetyState(_PAUSED, is_homed=True, held_by=Owner.PERSON),
    "PAUSED, not at rest": SafetyState(_PAUSED, is_homed=True, held_by=Owner.PERSON, is_stopping=True),
    "the same, a resume waits": SafetyState(
        _PAUSED, is_homed=True, held_by=Owner.PERSON, is_stopping=True, waits=Owner.PERSON
    ),
    "PAUSED, retraction": SafetyState(_PAUSED, is_homed=True, held_by=Owner.PERSON, motion=Owner.PERSON),
    "FAULT": SafetyState(_FAULT, is_homed=True, present=_STALE, latched=_STALE, held_by=Owner.SENSOR),
    "FAULT, retraction": SafetyState(
        _FAULT, is_homed=True, present=_STALE, latched=_STALE, held_by=Owner.PERSON, motion=Owner.PERSON
    ),
}
_REPORTS = {
    "no cause": InputReport(retracting=True),
    "rest is measured": InputReport(retracting=True, resting=True),
    "the retraction has ended": InputReport(),
    "a cause that pauses": InputReport(frozenset({Cause.POSE_UNSEEN}), retracting=True),
    "a cause that is a fault": InputReport(frozenset({Cause.FORCE_EXCEEDED}), retracting=True),
    "wrong_way, stage_jumped": InputReport(frozenset({Cause.WRONG_WAY}), retracting=True),
    "still_moving": InputReport(frozenset({Cause.STILL_MOVING}), retracting=True),
}


def transition_table() -> str:
    """Return the table as CSV: a row for each event, a column for each state, and the transitions in the cells."""
    rows = [["event", *_STATES]]
    for name, report in _REPORTS.items():
        rows.append([name, *(_cell(state, report) for state in _STATES.values())])
    for order in (*Order, *MotionOrder):
        rows += _rows(order)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _rows(order: Order | MotionOrder) -> Iterator[list[str]]:
    by = {owner: [_cell(state, order.by(owner)) for state in _STATES.values()] for owner in (Owner.PERSON, Owner.LOOP)}
    if by[Owner.PERSON] == by[Owner.LOOP]:
        yield [f"{order}", *by[Owner.PERSON]]
        return
    for owner, cells in by.items():
        if any(cells):
            yield [f"{order} by {'a person' if owner is Owner.PERSON else 'the loop'}", *cells]


def _cell(state: SafetyState, event: Ordered | InputReport) -> str:
    """Return the table cell of an event in a state: the actions and the next state.

    The text is "" if the order is refused, and "=" if the state stays.
    """
    transition = advance(state, event, 0)
    if transition.refused:
        return ""
    after = transition.state
    words = [action.value for action in transition.actions]
    if after.operating is not state.operating:
        words.append(f"{after.operating}")
    if after.waits and not state.waits:
        words.append("wait")
    if state.waits and not after.waits and after.operating is not _ENABLED:
        words.append("forget the resume")
    if after.latched - state.latched:
        words.append("latch")
    if state.latched and not after.latched:
        words.append("unlatch")
    return ", ".join(words) or "="


if __name__ == "__main__":
    print(transition_table(), end="")
