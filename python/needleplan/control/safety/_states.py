"""Operating states of the robot, the pure function `advance` from one state to the next, and the guard's events.

The names are those of CRTK (Collaborative Robotics Toolkit). In ENABLED the robot follows the loop; in all other states
only a person can move it, by a retraction. In PAUSED the robot waits for the order RESUME. In FAULT a fault is present.

1. Orders neither cause nor end FAULT. When no cause of the severity FAULT is present, FAULT becomes DISABLED.
2. ENABLED is entered only by ENABLE from DISABLED and by RESUME or CONTINUE from PAUSED, and only while no cause is
   present. CONTINUE is the order of the loop; it does not end a pause that a person ordered.
3. Faults and ordered stops are latched: ENABLE is refused until RESET, and RESET is refused in FAULT.
4. In DISABLED a cause only prevents enabling. The exceptions are STILL_MOVING and the causes that stop a retraction,
   which lead to FAULT.
5. While a retraction by a person is in force, only WRONG_WAY and STAGE_JUMPED stop the stage, in every state. In
   ENABLED no retraction is in force.
6. Every transition out of ENABLED stops the stage. The interrupted command is not continued later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from needleplan.control.safety._causes import Cause, Severity

__all__ = [
    "GuardAction",
    "InputReport",
    "OperatingState",
    "Order",
    "SafetyEvent",
    "SafetyEventName",
    "SafetyListener",
    "SafetyState",
    "SafetyTransition",
    "advance",
    "begin_retraction",
]

_NONE: frozenset[Cause] = frozenset()
# Causes that lead to FAULT even from DISABLED.
_FAULTS_WHEN_DISABLED = frozenset({Cause.STILL_MOVING})
# Causes that stop the stage again in FAULT, because they show that the stage moves in spite of the first stop.
_OF_MOTION = frozenset({Cause.STILL_MOVING, Cause.WRONG_WAY, Cause.OVERSPEED, Cause.DEPTH_EXCEEDED, Cause.STAGE_JUMPED})
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


_FAULT = OperatingState.FAULT


class Order(StrEnum):
    """Order to the guard by a person, or by a program on behalf of a person."""

    ENABLE = "enable"
    DISABLE = "disable"
    PAUSE = "pause"
    RESUME = "resume"
    CONTINUE = "continue"
    """End a pause that no person ordered. The loop gives this order; all other pauses end by RESUME of a person."""
    RESET = "reset"
    """Confirm that the latched causes have been examined; allows ENABLE again."""
    STOP = "stop"
    HOME = "home"
    """Declare that the zero of the stage is known."""
    UNHOME = "unhome"
    """Declare that the zero of the stage is not known."""


class GuardAction(StrEnum):
    """Action that a transition requires."""

    STOP = "stop"


@dataclass(frozen=True)
class InputReport:
    """Validation result of all inputs: the present causes, and whether the stage moves (`busy`).

    `retracting` tells whether a retraction by a person is the command in force.
    """

    causes: frozenset[Cause] = _NONE
    busy: bool = False
    retracting: bool = False


@dataclass(frozen=True)
class SafetyState:
    """State of the guard: operating state, `present` causes, causes `latched` until RESET, and two flags of the stage.

    `is_homed` tells whether the zero of the stage is known, `is_busy` whether the stage moves.
    """

    operating: OperatingState = OperatingState.DISABLED
    is_homed: bool = False
    is_busy: bool = False
    present: frozenset[Cause] = _NONE
    latched: frozenset[Cause] = _NONE
    since_ns: int = 0
    """Time (ns) at which the guard entered the state `operating`."""

    person_paused: bool = False
    """Whether a person ordered the present pause, or a retraction during the pause."""


@dataclass(frozen=True)
class SafetyTransition:
    """Next state, the actions to perform, and the causes. A `refused` order leaves the state unchanged."""

    state: SafetyState
    actions: tuple[GuardAction, ...] = ()
    causes: frozenset[Cause] = _NONE
    refused: bool = False


class SafetyEventName(StrEnum):
    """Kind of an event of the guard."""

    TRANSITION = "transition"
    """The operating state has changed from `before` to `state`."""

    RAISED = "raised"
    """New causes are present; `causes` lists them."""

    CLEARED = "cleared"
    """Causes are no longer present; `causes` lists them."""

    ORDER = "order"
    REFUSAL = "refusal"
    COMMAND = "command"
    """A motion command with the event's `values` was sent to the stage."""

    RETRACTION = "retraction"
    """A retraction by a person was sent to the stage."""

    STOP = "stop"
    """A stop was sent to the stage at `sent_ns`."""


@dataclass(frozen=True)
class SafetyEvent:
    """One event of the guard. Times (ns) are those of the monotonic clock."""

    name: SafetyEventName
    time_ns: int
    state: OperatingState
    """Operating state after the event."""

    causes: frozenset[Cause] = frozenset()
    text: str = ""
    before: OperatingState | None = None
    """Operating state before a TRANSITION; None for all other events."""

    sent_ns: int | None = None
    """Time at which a command or a stop was sent to the stage; None for all other events."""

    values: tuple[tuple[str, float], ...] = field(default=())
    """Names and values of the arguments of a motion command."""

    def entry(self) -> dict[str, Any]:
        """Return the event as a message for a recording channel of the kind `recording.EVENT`."""
        entry: dict[str, Any] = {
            "name": self.name, "cause": ", ".join(sorted(self.causes)), "text": self.text, "state": self.state,
        }  # fmt: skip
        if self.before is not None:
            entry["before"] = self.before
        if self.sent_ns is not None:
            entry["sent_ns"] = str(self.sent_ns)  # as text: JSON readers round integers of this size
        return entry | dict(self.values)


SafetyListener = Callable[[SafetyEvent], None]


def advance(state: SafetyState, event: Order | InputReport, now_ns: int) -> SafetyTransition:
    """Return the transition from `state` that an order or a validation result causes at a time (ns)."""
    if isinstance(event, InputReport):
        return _validated(state, event, now_ns)
    return _ORDERS[event](state, now_ns)


def _validated(state: SafetyState, report: InputReport, now_ns: int) -> SafetyTransition:
    if not report.causes and not state.present and report.busy == state.is_busy and state.operating is not _FAULT:
        return SafetyTransition(state)  # fast path if nothing has changed; this function runs a thousand times a second
    present = frozenset(each for each in report.causes if each.severity is not Severity.REFUSAL)
    faults = frozenset(each for each in present if each.severity is Severity.FAULT)
    homed = state.is_homed and not present & _ZERO_LOST
    updated = replace(state, present=present, is_busy=report.busy, is_homed=homed)
    operating = state.operating
    stopping = _ENDS_RETRACTION if report.retracting and operating is not OperatingState.ENABLED else None
    if operating is OperatingState.FAULT:
        if not faults:
            return SafetyTransition(_to(updated, OperatingState.DISABLED, now_ns))
        new = faults - state.present
        return SafetyTransition(_latched(updated, faults), _stop_if(new & (stopping or _OF_MOTION)), new)
    if operating is OperatingState.DISABLED:
        faults &= _FAULTS_WHEN_DISABLED | (stopping or _NONE)
    if faults:
        latched = _latched(_to(updated, OperatingState.FAULT, now_ns), faults)
        return SafetyTransition(latched, _stop_if(faults if stopping is None else faults & stopping), faults)
    if operating is OperatingState.ENABLED and present:
        return SafetyTransition(_to(updated, OperatingState.PAUSED, now_ns), (GuardAction.STOP,), present)
    return SafetyTransition(updated)


def begin_retraction(state: SafetyState, now_ns: int) -> SafetyTransition:
    """Return the transition that the beginning of a retraction by a person causes: ENABLED becomes PAUSED.

    Only a person can end this pause.
    """
    if state.operating is OperatingState.PAUSED:
        return SafetyTransition(replace(state, person_paused=True))
    return _pause(state, now_ns) if state.operating is OperatingState.ENABLED else SafetyTransition(state)


def _enable(state: SafetyState, now_ns: int) -> SafetyTransition:
    if state.operating is OperatingState.ENABLED:
        return SafetyTransition(state)
    if state.operating is not OperatingState.DISABLED:
        return _refused(state, Cause.NOT_POSSIBLE, *state.present)
    against = set(state.present)
    if state.latched:
        against |= {Cause.NOT_RESET, *state.latched}
    if not state.is_homed:
        against.add(Cause.NOT_HOMED)
    return _refused(state, *against) if against else SafetyTransition(_to(state, OperatingState.ENABLED, now_ns))


def _disable(state: SafetyState, now_ns: int) -> SafetyTransition:
    # The order does not end FAULT, but the stop is sent again.
    kept = state.operating is OperatingState.FAULT
    return SafetyTransition(state if kept else _to(state, OperatingState.DISABLED, now_ns), (GuardAction.STOP,))


def _pause(state: SafetyState, now_ns: int) -> SafetyTransition:
    if state.operating not in (OperatingState.ENABLED, OperatingState.PAUSED):
        return _refused(state, Cause.NOT_POSSIBLE)
    paused = replace(_to(state, OperatingState.PAUSED, now_ns), person_paused=True)
    return SafetyTransition(paused, (GuardAction.STOP,))


def _resume(state: SafetyState, now_ns: int) -> SafetyTransition:
    if state.operating is not OperatingState.PAUSED:
        return _refused(state, Cause.NOT_POSSIBLE)
    if state.present:
        return _refused(state, *state.present)
    return SafetyTransition(_to(state, OperatingState.ENABLED, now_ns))


def _continue(state: SafetyState, now_ns: int) -> SafetyTransition:
    return _refused(state, Cause.NOT_POSSIBLE) if state.person_paused else _resume(state, now_ns)


def _reset(state: SafetyState, _: int) -> SafetyTransition:
    if state.operating is OperatingState.FAULT:
        return _refused(state, Cause.NOT_POSSIBLE, *state.present)
    return SafetyTransition(replace(state, latched=_NONE))


def _stop(state: SafetyState, now_ns: int) -> SafetyTransition:
    cause = frozenset({Cause.STOP_ORDERED})
    moved = _disable(state, now_ns).state
    return SafetyTransition(_latched(moved, cause), (GuardAction.STOP,), cause)


def _home(state: SafetyState, _: int) -> SafetyTransition:
    if state.operating is not OperatingState.DISABLED or state.present & _ZERO_LOST:
        return _refused(state, Cause.NOT_POSSIBLE, *(state.present & _ZERO_LOST))
    return SafetyTransition(replace(state, is_homed=True))


def _unhome(state: SafetyState, _: int) -> SafetyTransition:
    if state.operating is not OperatingState.DISABLED:
        return _refused(state, Cause.NOT_POSSIBLE)
    return SafetyTransition(replace(state, is_homed=False))


def _to(state: SafetyState, operating: OperatingState, now_ns: int) -> SafetyState:
    if state.operating is operating:
        return state
    return replace(state, operating=operating, since_ns=now_ns, person_paused=False)


def _stop_if(causes: frozenset[Cause]) -> tuple[GuardAction, ...]:
    return (GuardAction.STOP,) if causes else ()


def _latched(state: SafetyState, causes: frozenset[Cause]) -> SafetyState:
    return replace(state, latched=state.latched | causes)


def _refused(state: SafetyState, *causes: Cause) -> SafetyTransition:
    return SafetyTransition(state, causes=frozenset(causes), refused=True)


_ORDERS: dict[Order, Callable[[SafetyState, int], SafetyTransition]] = {
    Order.ENABLE: _enable,
    Order.DISABLE: _disable,
    Order.PAUSE: _pause,
    Order.RESUME: _resume,
    Order.CONTINUE: _continue,
    Order.RESET: _reset,
    Order.STOP: _stop,
    Order.HOME: _home,
    Order.UNHOME: _unhome,
}
