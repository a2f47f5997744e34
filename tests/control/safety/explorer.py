"""An explorer of all interleavings of person, loop, sensors and robot, over a transition function.

The world is the state of the guard, the axis of the needle, the stop that is on its way to the robot, the causes that
are present in truth, and two notes on what a person has ordered. The robot may miss a stop, or obey it late: until a
stop has arrived, the axis goes on, and the guard may repeat it. A command moves the axis at once. Everything else may
happen at any time, in any order: every order by every owner, also those that no honest loop would give, and every
change of the causes, with or without a validation, with or without a measured rest, before the next order. Worlds that
are equal are explored once.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum

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
    advance,
)

FAULT, ENABLED = OperatingState.FAULT, OperatingState.ENABLED
ENDS_A_RETRACTION = {Cause.WRONG_WAY, Cause.STAGE_JUMPED}
CAUSES = (Cause.POSE_UNSEEN, Cause.FORCE_EXCEEDED, Cause.STILL_MOVING, Cause.STAGE_JUMPED)
"""A cause for each way in which the transition function treats causes."""


class Axis(Enum):
    """What the needle does in truth."""

    STILL = "still"
    INWARD = "inward"
    OUTWARD = "outward"


@dataclass(frozen=True)
class World:
    """Everything that decides over the future."""

    state: SafetyState = SafetyState()
    axis: Axis = Axis.STILL
    is_stop_coming: bool = False
    """Whether a stop is on its way; a later command overtakes no stop, so a stop that is late would hit it."""

    causes: frozenset[Cause] = frozenset()
    """Causes that are present in truth; the guard learns of them at the next validation."""

    unexamined: bool = False
    """Whether there was a fault or a stop after the last RESET by a person."""

    wanted_still: bool = False
    """Whether a person has ordered the needle to stop, and has not given ENABLE or RESUME since."""


class Tick(Enum):
    """What is no order.

    The guard validates, or learns that the needle rests; a stop is sent again, is obeyed, or is missed; the retraction
    reaches its goal.
    """

    VALIDATE = "validate"
    REST = "rest"
    REPEAT = "repeat"
    OBEY = "obey"
    MISS = "miss"
    ARRIVE = "arrive"


Happening = Ordered | Cause | Tick


def happenings() -> Iterator[Happening]:
    """Everything that may happen."""
    yield from Tick
    yield from CAUSES  # the cause begins or ends
    for what in (*Order, *MotionOrder):
        for owner in (Owner.PERSON, Owner.LOOP, Owner.SENSOR):  # the robot has the rights of a sensor
            yield what.by(owner)


Advance = Callable[[SafetyState, Ordered | InputReport, int], SafetyTransition]


def after(world: World, what: Happening, advance: Advance = advance) -> tuple[World, SafetyTransition | None]:
    """Return the world after something has happened, and the transition of the guard."""
    if isinstance(what, Cause):
        return replace(world, causes=world.causes ^ {what}), None
    if what is Tick.ARRIVE:
        return replace(world, axis=Axis.STILL if world.axis is Axis.OUTWARD else world.axis), None
    if what is Tick.REPEAT:
        return replace(world, is_stop_coming=world.is_stop_coming or world.state.is_stopping), None
    if what in (Tick.OBEY, Tick.MISS):
        obeys = world.is_stop_coming and what is Tick.OBEY
        return replace(world, axis=Axis.STILL if obeys else world.axis, is_stop_coming=False), None
    is_still = world.axis is Axis.STILL and not world.is_stop_coming
    event = what if isinstance(what, Ordered) else InputReport(
        world.causes, retracting=world.axis is Axis.OUTWARD, resting=what is Tick.REST and is_still
    )  # fmt: skip
    step = advance(world.state, event, 0)
    axis, is_stop_coming = world.axis, world.is_stop_coming
    for action in step.actions:
        # A retraction has a higher number than an earlier stop, so the robot does not execute a stop that comes later.
        is_stop_coming = action is GuardAction.STOP or (is_stop_coming and action is not GuardAction.RETRACT)
        axis = {GuardAction.STOP: axis, GuardAction.MOVE: Axis.INWARD, GuardAction.RETRACT: Axis.OUTWARD}[action]
    unexamined, wanted_still = world.unexamined, world.wanted_still
    if step.state.operating is FAULT or (isinstance(what, Ordered) and what.what is Order.STOP):
        unexamined = True
    if isinstance(what, Ordered) and what.owner is Owner.PERSON and not step.refused:
        if what.what is Order.RESET:
            unexamined = False
        if what.what in (Order.PAUSE, Order.DISABLE, Order.STOP, MotionOrder.RETRACT):
            wanted_still = True
        if what.what in (Order.ENABLE, Order.RESUME):
            wanted_still = False
    return World(merged(step.state), axis, is_stop_coming, world.causes, unexamined, wanted_still), step


def merged(state: SafetyState) -> SafetyState:
    """Return the state without what decides over nothing: times, the first causes, and which causes are latched."""
    latched = frozenset({Cause.FORCE_EXCEEDED}) if state.latched else frozenset[Cause]()
    return replace(state, since_ns=0, first=frozenset(), latched=latched, is_busy=False)


def mistake(before: World, what: Happening, now: World, step: SafetyTransition | None) -> str:
    """Return which invariant is broken by what has happened; empty if none is."""
    state, is_stopped = now.state, now.is_stop_coming or now.state.is_stopping
    inward = now.axis is Axis.INWARD and not is_stopped  # and nobody is about to stop it
    orders, validates = isinstance(what, Ordered), what in (Tick.VALIDATE, Tick.REST)
    person = orders and what.owner is Owner.PERSON
    outward = now.axis is Axis.OUTWARD and not is_stopped
    wrong = {
        "after a fault or a stop it moves inward without a reset by a person": inward and now.unexamined,
        "it moves inward although a person wants it to stand": inward and now.wanted_still,
        "it moves inward and is not enabled": inward and state.operating is not ENABLED,
        "it moves inward and its zero is not known": inward and not state.is_homed,
        "a validation with a cause does not stop it": inward and validates and bool(now.causes),
        "it is enabled although a retraction is in force": state.operating is ENABLED and now.axis is Axis.OUTWARD,
        "it is enabled before the needle rests": state.operating is ENABLED is not before.state.operating
        and (before.axis is not Axis.STILL or before.is_stop_coming),
        "an old stop hits a new command": now.is_stop_coming and state.operating is ENABLED,
        "an order to go on is carried out against a cause": state.operating is ENABLED is not before.state.operating
        and validates and bool(now.causes),
        "it waits to go on although something is in its way": state.waits is not None
        and bool(state.latched or state.present or state.retracting or not state.is_stopping),
        "the loop waits to end what a person began": state.waits is Owner.LOOP and state.held_by is Owner.PERSON,
        "a stop by a person does not stop it": person and what.what is Order.STOP
        and not (is_stopped or now.axis is Axis.STILL),
        "a retraction is refused to a person": person and what.what is MotionOrder.RETRACT and step is not None
        and step.refused,
        "FAULT leads to where it may not": before.state.operating is FAULT
        and state.operating not in (FAULT, OperatingState.DISABLED),
        "an order causes a fault": orders and state.operating is FAULT is not before.state.operating,
        "ENABLED is left without a stop": before.state.operating is ENABLED and state.operating is not ENABLED
        and step is not None and GuardAction.STOP not in step.actions,
        "a retraction ends without a stop": before.state.retracting and not state.retracting
        and step is not None and GuardAction.STOP not in step.actions,
        "a refused order changes something": step is not None and step.refused
        and now != replace(before, unexamined=now.unexamined),
        "a retraction is stopped by neither a person nor what may": before.axis is Axis.OUTWARD
        and not before.state.is_stopping and is_stopped and not person
        and not (validates and now.causes & ENDS_A_RETRACTION)
        and not (orders and what.owner in (Owner.SENSOR, Owner.ROBOT)),
        "it goes the wrong way out and is not stopped": outward and validates
        and bool(now.causes & ENDS_A_RETRACTION - before.state.present),
    }  # fmt: skip
    return next((name for name, is_wrong in wrong.items() if is_wrong), "")


@dataclass(frozen=True)
class Exploration:
    """Number of worlds, number of transitions between them, number of events to the farthest one, and the mistakes."""

    worlds: int
    transitions: int
    depth: int
    mistakes: dict[str, tuple[str, ...]]
    """For every broken invariant the shortest history that breaks it."""


def explore(
    deepest: int = 100, together: int = 1, *, to_the_end: bool = True, advance: Advance = advance
) -> Exploration:
    """Explore all worlds that at most `deepest` events can lead to, with at most so many causes `together`.

    `advance` is the transition function: that of the product, or its twin.

    Unless `to_the_end`, the search ends with the first mistake.
    """
    found: dict[World, tuple[World, Happening] | None] = {World(): None}
    edge, depth, transitions, mistakes = [World()], 0, 0, dict[str, tuple[str, ...]]()
    everything = list(happenings())
    while edge and depth < deepest and (to_the_end or not mistakes):
        begun, edge = edge, []
        for world in begun:
            for what in everything:
                now, step = after(world, what, advance)
                if len(now.causes) > together:
                    continue
                transitions += 1
                wrong = mistake(world, what, now, step)
                if wrong and wrong not in mistakes:
                    mistakes[wrong] = (*history(found, world), name_of(what))
                if now not in found:
                    found[now] = (world, what)
                    edge.append(now)
        depth += bool(edge)
    return Exploration(len(found), transitions, depth, mistakes)


def history(found: dict[World, tuple[World, Happening] | None], world: World) -> list[str]:
    """Return what has led to a world."""
    names: list[str] = []
    while (before := found[world]) is not None:
        world, what = before
        names.insert(0, name_of(what))
    return names


def name_of(what: Happening) -> str:
    return f"{what.what} by the {what.owner.value}" if isinstance(what, Ordered) else str(what.value)
