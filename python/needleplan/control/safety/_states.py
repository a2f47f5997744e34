"""Operating states of the robot, and the pure function `advance` from one state and one event to the next state.

The names of the states are those of CRTK (Collaborative Robotics Toolkit). In ENABLED the needle follows the loop; in
all other states only a person can move the needle, by a retraction. In PAUSED the needle waits for the order RESUME. In
FAULT a fault is present.

Every order has an owner: a person, the loop, a sensor or the robot. The state contains the owner who holds the needle
(`held_by`) and the owner of the motion in force (`motion`). The rules:

1. Orders neither cause nor end FAULT. When no cause of the severity FAULT is present, FAULT becomes DISABLED.
2. ENABLED is entered only by ENABLE from DISABLED and by RESUME from PAUSED, and only while no cause is present, no
   retraction is in force, and the needle was measured at rest after the last stop. An earlier ENABLE or RESUME waits
   for this rest; a cause, and every order that stops the needle, ends the wait.
3. Only a person ends what a person ordered: ENABLE and RESUME by the loop are refused while a person holds the needle.
   The loop may end a pause that a cause began, when the cause is gone.
4. Faults and ordered stops are latched: ENABLE is refused until RESET. Only a person may give RESET, and RESET is
   refused in FAULT. After STAGE_JUMPED and after UNHOME by a person, only a person may give HOME.
5. In DISABLED a cause only prevents enabling. The exceptions are STILL_MOVING and the causes that stop a retraction,
   which lead to FAULT.
6. A retraction is a motion of a person. Every STOP, DISABLE and PAUSE by a person stops it; of the causes, only
   WRONG_WAY and STAGE_JUMPED do. The loop cannot stop it: STOP and DISABLE by the loop disable the guard
   and leave the retraction in force.
7. Every transition out of ENABLED, and the end of a retraction, stops the needle. The interrupted command is not
   continued later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from needleplan.control.safety._causes import Cause, Owner, Severity

__all__ = [
    "GuardAction",
    "InputReport",
    "MotionOrder",
    "OperatingState",
    "Order",
    "Ordered",
    "Owner",
    "SafetyState",
    "SafetyTransition",
    "advance",
]

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


class OperatingState(StrEnum):
    """Operating state of the guard, with the names of CRTK."""

    DISABLED = "DISABLED"
    ENABLED = "ENABLED"
    PAUSED = "PAUSED"
    FAULT = "FAULT"


_DISABLED, _ENABLED, _PAUSED, _FAULT = OperatingState


class Order(StrEnum):
    """Order to the guard."""

    ENABLE = "enable"
    DISABLE = "disable"
    PAUSE = "pause"
    RESUME = "resume"
    RESET = "reset"
    """Confirm that the latched causes have been examined; allows ENABLE again."""
    STOP = "stop"
    HOME = "home"
    """Declare that the zero of the stage is known."""
    UNHOME = "unhome"
    """Declare that the zero of the stage is not known."""

    def by(self, owner: Owner) -> Ordered:
        """Return the event that `owner` gives this order."""
        return Ordered(self, owner)


class MotionOrder(StrEnum):
    """Order to move the needle. The guard validates depth, roll and speed separately."""

    MOVE = "move"
    """Insert, withdraw or rotate the needle, by the loop."""
    RETRACT = "retract"
    """Pull the needle out, by a person."""

    def by(self, owner: Owner) -> Ordered:
        """Return the event that `owner` gives this order."""
        return Ordered(self, owner)


@dataclass(frozen=True)
class Ordered:
    """The event that `owner` gives the order `what`."""

    what: Order | MotionOrder
    owner: Owner


class GuardAction(StrEnum):
    """Action that a transition requires; the guard carries the actions out in their order."""

    STOP = "stop"
    MOVE = "move"
    RETRACT = "retract"


@dataclass(frozen=True)
class InputReport:
    """The event of a validation of all inputs: the present causes, and whether the stage moves (`busy`).

    `retracting` tells whether the stage still carries out a retraction. The value matters only while a retraction is in
    force. `resting` tells whether the needle was measured at rest after the last stop, and no stop or command is on its
    way.
    """

    causes: frozenset[Cause] = _NONE
    busy: bool = False
    retracting: bool = False
    resting: bool = False


@dataclass(frozen=True)
class SafetyState:
    """State of the guard: operating state, `present` causes, causes `latched` until RESET, and the owners.

    `is_homed` tells whether the zero of the stage is known, `is_busy` whether the stage moves.
    """

    operating: OperatingState = _DISABLED
    is_homed: bool = False
    is_busy: bool = False
    present: frozenset[Cause] = _NONE
    latched: frozenset[Cause] = _NONE
    since_ns: int = 0
    """Time (ns) at which the guard entered the state `operating`."""

    held_by: Owner | None = None
    """Owner who stopped, paused or retracted the needle; of several owners, the one with the highest authority. None in
    ENABLED and before the first order."""

    motion: Owner | None = None
    """Owner of the motion in force: LOOP, PERSON for a retraction, None without a motion order since the last stop."""

    is_zero_lost: bool = False
    """Whether only a person may declare the zero of the stage known again."""

    first: frozenset[Cause] = _NONE
    """Causes of the last transition to FAULT or PAUSED, or of the STOP that ended a run; empty in ENABLED, after RESET,
    and in a pause that a person ordered."""

    is_stopping: bool = False
    """Whether the stage was stopped, and the needle has not been measured at rest since."""

    waits: Owner | None = None
    """Owner of an ENABLE or RESUME that waits for the needle to rest."""

    @property
    def person_paused(self) -> bool:
        """Whether a person ordered the present pause, or a retraction during the pause."""
        return self.operating is _PAUSED and self.held_by is Owner.PERSON

    @property
    def retracting(self) -> bool:
        """Whether a retraction by a person is in force."""
        return self.motion is Owner.PERSON


@dataclass(frozen=True)
class SafetyTransition:
    """Next state, the actions to perform, and the causes. A `refused` order leaves the state unchanged."""

    state: SafetyState
    actions: tuple[GuardAction, ...] = ()
    causes: frozenset[Cause] = _NONE
    refused: bool = False


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
