"""The twin of the Rust guard: the transitions of the guard in Python, rule by rule, as plain as they can be written.

`rust/guard/src/advance.rs` has the rules. Mutants of the twin show that the explorer finds mistakes.
"""

from collections.abc import Callable
from dataclasses import replace

from needleplan.control.safety import (
    Cause,
    GuardAction,
    InputReport,
    MotionOrder,
    OperatingState,
    Order,
    Ordered,
    Owner,
    SafetyState,
    SafetyTransition,
    Severity,
)

_NONE: frozenset[Cause] = frozenset()
# Causes that stop the stage again in FAULT, because they show that the stage moves in spite of the first stop.
_OF_MOTION = frozenset({
    Cause.STILL_MOVING, Cause.WRONG_WAY, Cause.OVERSPEED, Cause.DEPTH_EXCEEDED, Cause.ROLL_EXCEEDED, Cause.STAGE_JUMPED,
})  # fmt: skip
# Causes that lead to FAULT even from DISABLED.
_FAULTS_WHEN_DISABLED = frozenset({Cause.STILL_MOVING})
# Causes that stop a retraction by a person.
_ENDS_RETRACTION = frozenset({Cause.WRONG_WAY, Cause.STAGE_JUMPED})
# Causes after which the stage must be homed again.
_ZERO_LOST = frozenset({Cause.STAGE_JUMPED})
_DISABLED, _ENABLED, _PAUSED, _FAULT = OperatingState


def advance(state: SafetyState, event: Ordered | InputReport, now_ns: int) -> SafetyTransition:
    """Return the transition from `state` that an order or a validation result causes at a time (ns)."""
    if isinstance(event, InputReport):
        return _validated(state, event, now_ns)
    return _ORDERS[event.what](state, event.owner, now_ns)


def _validated(state: SafetyState, report: InputReport, now_ns: int) -> SafetyTransition:
    operating, retracting = state.operating, state.retracting and report.retracting
    rested, has_ended = state.is_stopping and report.resting, state.retracting and not retracting
    if (
        not report.causes and not state.present and report.busy == state.is_busy and operating is not _FAULT
        and not rested and not has_ended
    ):  # fmt: skip
        return SafetyTransition(state)  # fast path if nothing has changed; this function runs a thousand times a second
    present = frozenset(each for each in report.causes if each.severity is not Severity.REFUSAL)
    faults = frozenset(each for each in present if each.severity is Severity.FAULT)
    before, waits = state, None if present else state.waits
    state = replace(
        state, present=present, is_busy=report.busy, waits=waits, is_stopping=state.is_stopping and not rested
    )
    if present & _ZERO_LOST:
        state = replace(state, is_homed=False, is_zero_lost=True)
    if operating is _FAULT:
        if not faults:
            return _stopped_if(has_ended, _to(state, _DISABLED, now_ns))
        new = faults - before.present
        is_new = bool(new & (_ENDS_RETRACTION if retracting else _OF_MOTION))
        return _stopped_if(is_new or has_ended, _latched(state, faults), new)
    if operating is _DISABLED:
        faults &= _FAULTS_WHEN_DISABLED | (_ENDS_RETRACTION if retracting else _NONE)
    if faults:
        state = _latched(replace(state, first=faults), faults)
        is_stopped = bool(faults & _ENDS_RETRACTION) if retracting else True
        return _stopped_if(is_stopped, _to(_held(state, *(each.owner for each in faults)), _FAULT, now_ns), faults)
    if operating is _ENABLED and present:
        paused = _held(_to(replace(state, first=present), _PAUSED, now_ns), *(each.owner for each in present))
        return _stopped(paused, present)
    if waits is not None and not state.is_stopping:
        return SafetyTransition(_enabled(state, now_ns))
    return _stopped_if(has_ended, state)


def _enable(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    if state.operating is _ENABLED:
        return SafetyTransition(state)
    if state.operating is not _DISABLED:
        return _refused(state, Cause.NOT_POSSIBLE, *state.present)
    against = set(state.present)
    if state.latched:
        against |= {Cause.NOT_RESET, *state.latched}
    if not state.is_homed:
        against.add(Cause.NOT_HOMED)
    return _begun(state, owner, against, now_ns)


def _resume(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    if state.operating is not _PAUSED:
        return _refused(state, Cause.NOT_POSSIBLE)
    return _begun(state, owner, set(state.present), now_ns)


def _begun(state: SafetyState, owner: Owner, against: set[Cause], now_ns: int) -> SafetyTransition:
    if not _may_begin(state, owner):
        against.add(Cause.NOT_AUTHORIZED)
    if state.retracting:
        against.add(Cause.NOT_POSSIBLE)
    if against:
        return _refused(state, *against)
    return SafetyTransition(replace(state, waits=owner) if state.is_stopping else _enabled(state, now_ns))


def _enabled(state: SafetyState, now_ns: int) -> SafetyState:
    return replace(_to(state, _ENABLED, now_ns), held_by=None, first=_NONE, waits=None)


def _may_begin(state: SafetyState, owner: Owner) -> bool:
    """Return whether `owner` may end the present hold. A fault can be ended only by RESET, so a pause is meant here."""
    if owner is Owner.LOOP:
        allowed = {None, Owner.LOOP} if state.operating is _DISABLED else set(Owner) - {Owner.PERSON}
        return state.held_by in allowed
    return owner is Owner.PERSON


def _disable(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    # The order does not end FAULT, but the stop is sent again.
    state = _held(state if state.operating is _FAULT else _to(state, _DISABLED, now_ns), owner)
    return _stopped_by(owner, state)


def _stop(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    cause = frozenset({Cause.STOP_ORDERED})
    if state.operating in (_ENABLED, _PAUSED):
        state = replace(_to(state, _DISABLED, now_ns), first=cause)
    state = _held(state, owner)
    return _stopped_by(owner, _latched(state, cause), cause)


def _pause(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    if state.operating not in (_ENABLED, _PAUSED):
        return _refused(state, Cause.NOT_POSSIBLE)
    return _stopped_by(owner, _held(_to(state, _PAUSED, now_ns), owner))


def _reset(state: SafetyState, owner: Owner, _: int) -> SafetyTransition:
    if owner is not Owner.PERSON:
        return _refused(state, Cause.NOT_AUTHORIZED)
    if state.operating is _FAULT:
        return _refused(state, Cause.NOT_POSSIBLE, *state.present)
    state = replace(state, latched=_NONE, first=_NONE)
    if state.operating is _DISABLED and state.held_by is not Owner.PERSON:
        state = replace(state, held_by=None)
    return SafetyTransition(state)


def _home(state: SafetyState, owner: Owner, _: int) -> SafetyTransition:
    if owner is not Owner.PERSON and (owner is not Owner.LOOP or state.is_zero_lost):
        return _refused(state, Cause.NOT_AUTHORIZED)
    if state.operating is not _DISABLED or state.present & _ZERO_LOST:
        return _refused(state, Cause.NOT_POSSIBLE, *(state.present & _ZERO_LOST))
    return SafetyTransition(replace(state, is_homed=True, is_zero_lost=False))


def _unhome(state: SafetyState, owner: Owner, _: int) -> SafetyTransition:
    if state.operating is not _DISABLED:
        return _refused(state, Cause.NOT_POSSIBLE)
    is_lost = state.is_zero_lost or owner is Owner.PERSON
    return SafetyTransition(replace(state, is_homed=False, is_zero_lost=is_lost, waits=None))


def _move(state: SafetyState, owner: Owner, _: int) -> SafetyTransition:
    against = set() if owner is Owner.LOOP else {Cause.NOT_AUTHORIZED}
    if state.operating is not _ENABLED:
        against |= {Cause.NOT_ENABLED, *state.present, *state.latched}
    if against:
        return _refused(state, *against)
    return SafetyTransition(replace(state, motion=Owner.LOOP), (GuardAction.MOVE,))


def _retract(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    if owner is not Owner.PERSON:
        return _refused(state, Cause.NOT_AUTHORIZED)
    enabled = state.operating is _ENABLED
    state = _held(_to(state, _PAUSED, now_ns) if enabled else state, owner)
    stop = (GuardAction.STOP,) if enabled else ()
    state = replace(state, motion=owner, is_stopping=False, waits=None)
    return SafetyTransition(state, (*stop, GuardAction.RETRACT))


def _to(state: SafetyState, operating: OperatingState, now_ns: int) -> SafetyState:
    return state if state.operating is operating else replace(state, operating=operating, since_ns=now_ns)


def _held(state: SafetyState, *owners: Owner) -> SafetyState:
    """Return the state held by the owner with the highest authority among `owners` and the present holder."""
    holders = {state.held_by, *owners}
    return replace(state, held_by=next(each for each in Owner if each in holders))


def _latched(state: SafetyState, causes: frozenset[Cause]) -> SafetyState:
    return replace(state, latched=state.latched | causes)


def _stopped(state: SafetyState, causes: frozenset[Cause] = _NONE) -> SafetyTransition:
    return SafetyTransition(replace(state, motion=None, is_stopping=True, waits=None), (GuardAction.STOP,), causes)


def _stopped_if(is_stopped: bool, state: SafetyState, causes: frozenset[Cause] = _NONE) -> SafetyTransition:
    return _stopped(state, causes) if is_stopped else SafetyTransition(state, (), causes)


def _stopped_by(owner: Owner, state: SafetyState, causes: frozenset[Cause] = _NONE) -> SafetyTransition:
    """Return the transition with a stop; the stop of the loop leaves a retraction by a person in force."""
    if state.retracting and owner is Owner.LOOP:
        return SafetyTransition(replace(state, waits=None), (), causes)
    return _stopped(state, causes)


def _refused(state: SafetyState, *causes: Cause) -> SafetyTransition:
    return SafetyTransition(state, causes=frozenset(causes), refused=True)


_ORDERS: dict[Order | MotionOrder, Callable[[SafetyState, Owner, int], SafetyTransition]] = {
    Order.ENABLE: _enable,
    Order.DISABLE: _disable,
    Order.PAUSE: _pause,
    Order.RESUME: _resume,
    Order.RESET: _reset,
    Order.STOP: _stop,
    Order.HOME: _home,
    Order.UNHOME: _unhome,
    MotionOrder.MOVE: _move,
    MotionOrder.RETRACT: _retract,
}
