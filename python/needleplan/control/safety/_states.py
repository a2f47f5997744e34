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

from dataclasses import dataclass
from enum import StrEnum

from needleplan import _ppvi
from needleplan.artifacts import CallRepr
from needleplan.control.safety._causes import Cause, Owner, bits_of, causes_of
from needleplan.devices.supervision import GuardNumbers

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
    "numbers_of",
]

_NONE: frozenset[Cause] = frozenset()


class OperatingState(StrEnum):
    """Operating state of the guard, with the names of CRTK."""

    DISABLED = "DISABLED"
    ENABLED = "ENABLED"
    PAUSED = "PAUSED"
    FAULT = "FAULT"


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
class InputReport(CallRepr):
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
class SafetyState(CallRepr):
    """State of the guard: operating state, `present` causes, causes `latched` until RESET, and the owners.

    `is_homed` tells whether the zero of the stage is known, `is_busy` whether the stage moves.
    """

    operating: OperatingState = OperatingState.DISABLED
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
        """Whether a person has ordered the present pause, or a retraction during this pause."""
        return self.operating is OperatingState.PAUSED and self.held_by is Owner.PERSON

    @property
    def retracting(self) -> bool:
        """Whether a retraction by a person is in force."""
        return self.motion is Owner.PERSON


@dataclass(frozen=True)
class SafetyTransition(CallRepr):
    """Next state, the actions to perform, and the causes. A `refused` order leaves the state unchanged."""

    state: SafetyState
    actions: tuple[GuardAction, ...] = ()
    causes: frozenset[Cause] = _NONE
    refused: bool = False


# Each value by its number in the guard of Rust
_OPERATING, _OWNERS = tuple(OperatingState), tuple(Owner)
_MOTIONS = (GuardAction.MOVE, GuardAction.RETRACT)
_ORDERS: dict[Order | MotionOrder, int] = {order: number for number, order in enumerate((*Order, *MotionOrder))}
_OPERATING_NUMBERS = {operating: number for number, operating in enumerate(_OPERATING)}
_OWNER_NUMBERS: dict[Owner | None, int | None] = {owner: number for number, owner in enumerate(Owner)} | {None: None}


def numbers_of(state: SafetyState) -> GuardNumbers:
    """Return the fields of a state as the guard of Rust takes them."""
    return (
        _OPERATING_NUMBERS[state.operating], state.is_homed, state.is_busy, bits_of(state.present),
        bits_of(state.latched), state.since_ns, _OWNER_NUMBERS[state.held_by], _OWNER_NUMBERS[state.motion],
        state.is_zero_lost, bits_of(state.first), state.is_stopping, _OWNER_NUMBERS[state.waits],
    )  # fmt: skip


def advance(state: SafetyState, event: Ordered | InputReport, now_ns: int) -> SafetyTransition:
    """Return the transition from `state` that an order or a validation result causes at a time (ns).

    Parameters
    ----------
    state
        State of the guard before the event.
    event
        An order with its owner, or the result of a validation.
    now_ns
        Time of the event in ns.

    Returns
    -------
    SafetyTransition
        The next state and the actions to send to the stage; or the causes for which the order is refused.

    Examples
    --------
    A sensor that falls silent is a fault. When it is back and the needle rests, a person must reset:

    >>> from needleplan.control.safety import Cause, InputReport, Order, Owner, SafetyState, advance
    >>> state = advance(SafetyState(), Order.HOME.by(Owner.LOOP), 0).state
    >>> state = advance(state, Order.ENABLE.by(Owner.LOOP), 1).state
    >>> transition = advance(state, InputReport({Cause.FORCE_STALE}), 2)
    >>> print(transition.state.operating, *transition.actions)
    FAULT stop
    >>> state = advance(transition.state, InputReport(resting=True), 3).state
    >>> print(state.operating, *sorted(advance(state, Order.ENABLE.by(Owner.PERSON), 4).causes))
    DISABLED force_stale not_reset
    >>> state = advance(state, Order.RESET.by(Owner.PERSON), 5).state
    >>> print(advance(state, Order.ENABLE.by(Owner.LOOP), 6).state.operating)
    ENABLED
    """
    before = numbers_of(state)
    if isinstance(event, InputReport):
        causes = bits_of(event.causes)
        step = _ppvi.guard_validated(before, causes, event.busy, event.retracting, event.resting, now_ns)
    else:
        step = _ppvi.guard_ordered(before, _ORDERS[event.what], _OWNERS.index(event.owner), now_ns)
    if step is None:
        return SafetyTransition(state)
    after, stops, motion, against, is_refused = step
    if is_refused:
        return SafetyTransition(state, (), causes_of(against), refused=True)
    actions = ((GuardAction.STOP,) if stops else ()) + (() if motion is None else (_MOTIONS[motion],))
    return SafetyTransition(_state_of(*after), actions, causes_of(against))


def _state_of(
    operating: int, is_homed: bool, is_busy: bool, present: int, latched: int, since_ns: int, holder: int | None,
    mover: int | None, is_zero_lost: bool, first: int, is_stopping: bool, waits: int | None,
) -> SafetyState:  # fmt: skip
    held_by, motion, waiting = (None if number is None else _OWNERS[number] for number in (holder, mover, waits))
    return SafetyState(
        _OPERATING[operating], is_homed, is_busy, causes_of(present), causes_of(latched), since_ns, held_by, motion,
        is_zero_lost, causes_of(first), is_stopping, waiting,
    )  # fmt: skip
