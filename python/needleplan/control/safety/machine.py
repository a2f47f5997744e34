"""The states of the robot, and what leads from one to another: a pure function.

The names are those of CRTK. DISABLED moves nothing, ENABLED follows the loop, PAUSED has stopped and waits for a
person to resume, FAULT has stopped because something is wrong.

1. No order causes FAULT, and none ends it: it ends when its causes are gone, in DISABLED.
2. ENABLED is entered only by ENABLE from DISABLED and by RESUME from PAUSED, and never while a cause is present.
3. A fault, and a stop that was ordered, latch: ENABLE is refused until RESET, which is refused while in FAULT.
4. In DISABLED causes only keep it from being enabled, but for one: a stage that moves there is a fault.
5. Every way out of ENABLED stops the stage. What was commanded before is not taken up again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from needleplan.control.safety.causes import Cause, Severity

__all__ = ["Action", "OperatingState", "Order", "Report", "SafetyState", "Step", "advance"]

_NONE: frozenset[Cause] = frozenset()
_EVEN_WHEN_DISABLED = frozenset({Cause.STILL_MOVING})
_OF_MOTION = frozenset({Cause.STILL_MOVING, Cause.WRONG_WAY, Cause.OVERSPEED, Cause.DEPTH_EXCEEDED, Cause.STAGE_JUMPED})
"""In a fault the stop is on its way already; these say that it has not helped."""

_ZERO_LOST = frozenset({Cause.STAGE_JUMPED})


class OperatingState(StrEnum):
    """The four states of CRTK."""

    DISABLED = "DISABLED"
    ENABLED = "ENABLED"
    PAUSED = "PAUSED"
    FAULT = "FAULT"


_FAULT = OperatingState.FAULT


class Order(StrEnum):
    """What a person, or a program for one, may ask for."""

    ENABLE = "enable"
    DISABLE = "disable"
    PAUSE = "pause"
    RESUME = "resume"
    RESET = "reset"
    """Say that the causes of latched stops have been looked at."""
    STOP = "stop"
    HOME = "home"
    """Say that the stage knows where zero is."""
    UNHOME = "unhome"


class Action(StrEnum):
    """What has to be done on a transition."""

    STOP = "stop"


@dataclass(frozen=True)
class Report:
    """What is seen of the robot: all causes that are there now (none is health), and whether it moves."""

    causes: frozenset[Cause] = _NONE
    busy: bool = False


@dataclass(frozen=True)
class SafetyState:
    """The state with what it depends on. `present` are the causes there now, `latched` those no person has reset."""

    operating: OperatingState = OperatingState.DISABLED
    is_homed: bool = False
    is_busy: bool = False
    present: frozenset[Cause] = _NONE
    latched: frozenset[Cause] = _NONE
    since_ns: int = 0
    """When `operating` was entered."""


@dataclass(frozen=True)
class Step:
    """The next state, what to do, and why: the causes of a transition or of a refusal."""

    state: SafetyState
    actions: tuple[Action, ...] = ()
    causes: frozenset[Cause] = _NONE
    refused: bool = False


def advance(state: SafetyState, event: Order | Report, now_ns: int) -> Step:
    """Return what follows from an event at a moment on the monotonic clock."""
    if isinstance(event, Report):
        return _seen(state, event, now_ns)
    return _ORDERS[event](state, now_ns)


def _seen(state: SafetyState, report: Report, now_ns: int) -> Step:
    if not report.causes and not state.present and report.busy == state.is_busy and state.operating is not _FAULT:
        return Step(state)  # nothing has changed: so it is a thousand times a second
    present = frozenset(each for each in report.causes if each.severity is not Severity.REFUSAL)
    faults = frozenset(each for each in present if each.severity is Severity.FAULT)
    homed = state.is_homed and not present & _ZERO_LOST
    seen = replace(state, present=present, is_busy=report.busy, is_homed=homed)
    operating = state.operating
    if operating is OperatingState.FAULT:
        if not faults:
            return Step(_to(seen, OperatingState.DISABLED, now_ns))
        new = faults - state.present
        return Step(_latched(seen, faults), (Action.STOP,) if new & _OF_MOTION else (), new)
    if operating is OperatingState.DISABLED:
        faults &= _EVEN_WHEN_DISABLED
    if faults:
        return Step(_latched(_to(seen, OperatingState.FAULT, now_ns), faults), (Action.STOP,), faults)
    if operating is OperatingState.ENABLED and present:
        return Step(_to(seen, OperatingState.PAUSED, now_ns), (Action.STOP,), present)
    return Step(seen)


def _enable(state: SafetyState, now_ns: int) -> Step:
    if state.operating is OperatingState.ENABLED:
        return Step(state)
    if state.operating is not OperatingState.DISABLED:
        return _refused(state, Cause.NOT_POSSIBLE, *state.present)
    against = set(state.present)
    if state.latched:
        against |= {Cause.NOT_RESET, *state.latched}
    if not state.is_homed:
        against.add(Cause.NOT_HOMED)
    return _refused(state, *against) if against else Step(_to(state, OperatingState.ENABLED, now_ns))


def _disable(state: SafetyState, now_ns: int) -> Step:
    # A fault is not left by an order, but the stop is worth sending again.
    kept = state.operating is OperatingState.FAULT
    return Step(state if kept else _to(state, OperatingState.DISABLED, now_ns), (Action.STOP,))


def _pause(state: SafetyState, now_ns: int) -> Step:
    if state.operating is OperatingState.ENABLED:
        return Step(_to(state, OperatingState.PAUSED, now_ns), (Action.STOP,))
    if state.operating is OperatingState.PAUSED:
        return Step(state, (Action.STOP,))
    return _refused(state, Cause.NOT_POSSIBLE)


def _resume(state: SafetyState, now_ns: int) -> Step:
    if state.operating is not OperatingState.PAUSED:
        return _refused(state, Cause.NOT_POSSIBLE)
    if state.present:
        return _refused(state, *state.present)
    return Step(_to(state, OperatingState.ENABLED, now_ns))


def _reset(state: SafetyState, _: int) -> Step:
    if state.operating is OperatingState.FAULT:
        return _refused(state, Cause.NOT_POSSIBLE, *state.present)
    return Step(replace(state, latched=_NONE))


def _stop(state: SafetyState, now_ns: int) -> Step:
    cause = frozenset({Cause.STOP_ORDERED})
    moved = _disable(state, now_ns).state
    return Step(_latched(moved, cause), (Action.STOP,), cause)


def _home(state: SafetyState, _: int) -> Step:
    if state.operating is not OperatingState.DISABLED or state.present & _ZERO_LOST:
        return _refused(state, Cause.NOT_POSSIBLE, *(state.present & _ZERO_LOST))
    return Step(replace(state, is_homed=True))


def _unhome(state: SafetyState, _: int) -> Step:
    if state.operating is not OperatingState.DISABLED:
        return _refused(state, Cause.NOT_POSSIBLE)
    return Step(replace(state, is_homed=False))


def _to(state: SafetyState, operating: OperatingState, now_ns: int) -> SafetyState:
    return state if state.operating is operating else replace(state, operating=operating, since_ns=now_ns)


def _latched(state: SafetyState, causes: frozenset[Cause]) -> SafetyState:
    return replace(state, latched=state.latched | causes)


def _refused(state: SafetyState, *causes: Cause) -> Step:
    return Step(state, causes=frozenset(causes), refused=True)


_ORDERS: dict[Order, Callable[[SafetyState, int], Step]] = {
    Order.ENABLE: _enable,
    Order.DISABLE: _disable,
    Order.PAUSE: _pause,
    Order.RESUME: _resume,
    Order.RESET: _reset,
    Order.STOP: _stop,
    Order.HOME: _home,
    Order.UNHOME: _unhome,
}
