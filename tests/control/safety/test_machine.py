"""The states: every transition of the table, and long histories beside a slow model of the rules."""

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

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
    advance,
)
from tests.control.safety.rules_model import PAUSING, SlowRobot

CONDITIONS = [each for each in Cause if each.severity is not Severity.REFUSAL and each is not Cause.STOP_ORDERED]
D, E, P, F = OperatingState.DISABLED, OperatingState.ENABLED, OperatingState.PAUSED, OperatingState.FAULT
PERSON, LOOP = Owner.PERSON, Owner.LOOP


def ordered(state: SafetyState, order: Order | MotionOrder, owner: Owner = PERSON, now_ns: int = 9) -> SafetyTransition:
    """Return the transition that an order causes."""
    return advance(state, order.by(owner), now_ns)


def rested(state: SafetyState) -> SafetyState:
    """Return the state after the needle was measured at rest, with no cause present."""
    return advance(state, InputReport(resting=True), 9).state


# The whole table: state, what happens or a person orders, and where it ends; a stop is sent where there is an
# exclamation mark. The state is homed, nothing is latched, nobody holds the needle but in PAUSED a sensor, and in FAULT
# the force is stale. For the loop, the rows of LOOP_TABLE differ.
TABLE = """
DISABLED  healthy   DISABLED
DISABLED  pausing   DISABLED
DISABLED  faulting  DISABLED
DISABLED  moving    FAULT !
DISABLED  enable    ENABLED
DISABLED  disable   DISABLED !
DISABLED  pause     refused
DISABLED  resume    refused
DISABLED  reset     DISABLED
DISABLED  stop      DISABLED !
DISABLED  home      DISABLED
DISABLED  unhome    DISABLED
DISABLED  move      refused
DISABLED  retract   DISABLED
ENABLED   healthy   ENABLED
ENABLED   pausing   PAUSED !
ENABLED   faulting  FAULT !
ENABLED   moving    FAULT !
ENABLED   enable    ENABLED
ENABLED   disable   DISABLED !
ENABLED   pause     PAUSED !
ENABLED   resume    refused
ENABLED   reset     ENABLED
ENABLED   stop      DISABLED !
ENABLED   home      refused
ENABLED   unhome    refused
ENABLED   move      refused
ENABLED   retract   PAUSED !
PAUSED    healthy   PAUSED
PAUSED    pausing   PAUSED
PAUSED    faulting  FAULT !
PAUSED    moving    FAULT !
PAUSED    enable    refused
PAUSED    disable   DISABLED !
PAUSED    pause     PAUSED !
PAUSED    resume    ENABLED
PAUSED    reset     PAUSED
PAUSED    stop      DISABLED !
PAUSED    home      refused
PAUSED    unhome    refused
PAUSED    move      refused
PAUSED    retract   PAUSED
FAULT     healthy   DISABLED
FAULT     pausing   DISABLED
FAULT     faulting  FAULT
FAULT     moving    FAULT !
FAULT     enable    refused
FAULT     disable   FAULT !
FAULT     pause     refused
FAULT     resume    refused
FAULT     reset     refused
FAULT     stop      FAULT !
FAULT     home      refused
FAULT     unhome    refused
FAULT     move      refused
FAULT     retract   FAULT
"""
LOOP_TABLE = """
DISABLED  reset     refused
ENABLED   reset     refused
PAUSED    reset     refused
ENABLED   move      ENABLED
DISABLED  retract   refused
ENABLED   retract   refused
PAUSED    retract   refused
FAULT     retract   refused
"""
ROWS = [tuple(line.split()) for line in TABLE.strip().splitlines()]
LOOP_ROWS = {tuple(line.split()[:2]): tuple(line.split()) for line in LOOP_TABLE.strip().splitlines()}
SEEN = {
    "healthy": frozenset(),
    "pausing": frozenset({Cause.POSE_UNSEEN}),
    "faulting": frozenset({Cause.FORCE_STALE}),
    "moving": frozenset({Cause.STILL_MOVING}),
}
ORDERS: dict[str, Order | MotionOrder] = {str(each): each for each in (*Order, *MotionOrder)}
CASES = [(PERSON, row) for row in ROWS] + [(LOOP, LOOP_ROWS.get(row[:2], row)) for row in ROWS if row[1] in ORDERS]


def test_the_table_is_whole() -> None:
    assert {row[:2] for row in ROWS} == set(product(OperatingState, (*SEEN, *ORDERS)))
    assert len(ROWS) == 4 * (len(SEEN) + len(ORDERS))


@pytest.mark.parametrize(("owner", "row"), CASES, ids=lambda each: getattr(each, "value", None) or "-".join(each[:2]))
def test_every_transition(owner: Owner, row: tuple[str, ...]) -> None:
    before = SafetyState(OperatingState(row[0]), is_homed=True, since_ns=3)
    if before.operating is P:
        before = SafetyState(P, is_homed=True, since_ns=3, held_by=Owner.SENSOR)
    if before.operating is F:
        before = SafetyState(F, True, present=SEEN["faulting"], latched=SEEN["faulting"], since_ns=3)
    step = advance(before, InputReport(SEEN[row[1]]) if row[1] in SEEN else ORDERS[row[1]].by(owner), 7)
    assert step.refused == (row[2] == "refused")
    assert (GuardAction.STOP in step.actions) == (row[-1] == "!")
    if step.refused:
        assert step.state == before
        assert step.causes
    else:
        assert step.state.operating == row[2]
        assert step.state.since_ns == (7 if step.state.operating is not before.operating else 3)
        assert (GuardAction.RETRACT in step.actions) == (row[1] == "retract")
        assert (GuardAction.MOVE in step.actions) == (row[1] == "move")


@pytest.mark.parametrize("owner", [Owner.SENSOR, Owner.ROBOT])
@pytest.mark.parametrize("operating", OperatingState)
def test_sensors_and_robot_may_only_stop(operating: OperatingState, owner: Owner) -> None:
    before = SafetyState(operating, is_homed=True, present=SEEN["faulting"] if operating is F else frozenset())
    for order in ORDERS.values():
        step = ordered(before, order, owner)
        assert step.refused or GuardAction.STOP in step.actions or step.state.operating is operating
        assert step.state.motion is None
        assert step.state.operating is not E or operating is E


@pytest.mark.parametrize("cause", CONDITIONS)
def test_every_cause_stops_and_latches_by_its_severity(cause: Cause) -> None:
    step = advance(SafetyState(E, is_homed=True), InputReport(frozenset({cause})), 1)
    assert step.actions == (GuardAction.STOP,)
    assert step.causes == {cause}
    assert step.state.operating is (P if cause.severity is Severity.PAUSE else F)
    assert step.state.latched == (frozenset() if cause.severity is Severity.PAUSE else {cause})
    healthy = advance(step.state, InputReport(), 2).state
    assert healthy.operating is (P if cause.severity is Severity.PAUSE else D)
    assert ordered(healthy, Order.ENABLE).refused


@pytest.mark.parametrize("operating", OperatingState)
@pytest.mark.parametrize("cause", CONDITIONS)
def test_only_two_causes_stop_a_retraction_and_every_cause_stops_the_loop(
    operating: OperatingState, cause: Cause
) -> None:
    present = SEEN["faulting"] if operating is F else frozenset()
    motion = LOOP if operating is E else PERSON
    before = SafetyState(operating, True, present=present, motion=motion)
    step = advance(before, InputReport(frozenset({cause}), busy=True, retracting=True), 1)
    ends = cause in (Cause.WRONG_WAY, Cause.STAGE_JUMPED)
    assert (GuardAction.STOP in step.actions) == (ends or operating is E)
    assert step.state.motion is (None if ends or operating is E else PERSON)
    if ends:
        assert step.state.operating is F
        assert cause in step.state.latched


@pytest.mark.parametrize("operating", [D, P, F])
@pytest.mark.parametrize("order", [Order.STOP, Order.DISABLE, Order.PAUSE])
@pytest.mark.parametrize("owner", Owner)
def test_the_loop_does_not_stop_the_retraction_of_a_person(
    operating: OperatingState, order: Order, owner: Owner
) -> None:
    before = SafetyState(operating, True, present=SEEN["faulting"] if operating is F else frozenset())
    before = ordered(before, MotionOrder.RETRACT).state
    step = ordered(before, order, owner)
    if step.refused:
        assert order is Order.PAUSE
        return
    assert (step.actions == ()) == (owner is LOOP)
    assert step.state.retracting == (owner is LOOP)
    again = ordered(step.state, MotionOrder.RETRACT)
    assert again.actions == (GuardAction.RETRACT,)
    assert again.state.retracting


@pytest.mark.parametrize("before", [P, E])
@pytest.mark.parametrize("order", [Order.PAUSE, MotionOrder.RETRACT])
def test_the_loop_does_not_end_the_pause_of_a_person(before: OperatingState, order: Order | MotionOrder) -> None:
    state = SafetyState(before, is_homed=True, held_by=None if before is E else Owner.SENSOR)
    paused = ordered(state, order).state
    assert paused.operating is P
    assert paused.person_paused
    paused = rested(paused if order is Order.PAUSE else rested(paused))  # the end of a retraction is a stop
    seen = advance(advance(paused, InputReport(SEEN["pausing"]), 2).state, InputReport(), 3).state
    assert ordered(seen, Order.RESUME, LOOP).causes == {Cause.NOT_AUTHORIZED}
    assert ordered(seen, Order.RESUME, LOOP).refused
    resumed = ordered(seen, Order.RESUME).state
    assert resumed.operating is E
    later = rested(advance(resumed, InputReport(SEEN["pausing"]), 6).state)
    assert not later.person_paused
    assert ordered(later, Order.RESUME, LOOP).state.operating is E


def test_a_latched_stop_needs_a_reset_by_a_person_and_says_so() -> None:
    state = rested(ordered(SafetyState(E, is_homed=True), Order.STOP).state)
    assert state.first == {Cause.STOP_ORDERED}
    refused = ordered(state, Order.ENABLE)
    assert refused.causes == {Cause.NOT_RESET, Cause.STOP_ORDERED}
    assert ordered(state, Order.RESET, LOOP).causes == {Cause.NOT_AUTHORIZED}
    reset = ordered(state, Order.RESET).state
    assert ordered(reset, Order.ENABLE, LOOP).causes == {Cause.NOT_AUTHORIZED}  # a person stopped it
    assert ordered(reset, Order.ENABLE).state.operating is E


def test_after_a_fault_and_a_reset_by_a_person_the_loop_may_begin() -> None:
    fault = advance(SafetyState(E, is_homed=True), InputReport(SEEN["faulting"]), 1).state
    assert fault.first == SEEN["faulting"]
    more = advance(fault, InputReport(SEEN["faulting"] | {Cause.LOOP_LATE}), 2).state
    assert more.first == SEEN["faulting"]
    state = rested(advance(more, InputReport(), 3).state)
    assert ordered(state, Order.ENABLE, LOOP).causes == {
        Cause.NOT_RESET, Cause.NOT_AUTHORIZED, Cause.FORCE_STALE, Cause.LOOP_LATE,
    }  # fmt: skip
    assert ordered(ordered(state, Order.RESET).state, Order.ENABLE, LOOP).state.operating is E


def test_only_a_person_homes_again_after_the_zero_is_lost() -> None:
    state = advance(SafetyState(E, is_homed=True), InputReport(frozenset({Cause.STAGE_JUMPED})), 1).state
    state = ordered(rested(state), Order.RESET).state
    assert ordered(state, Order.ENABLE).causes == {Cause.NOT_HOMED}
    assert ordered(state, Order.HOME, LOOP).causes == {Cause.NOT_AUTHORIZED}
    homed = ordered(state, Order.HOME).state
    assert ordered(homed, Order.ENABLE, LOOP).state.operating is E
    # Where a person declares it unknown, too.
    unhomed = ordered(SafetyState(is_homed=True), Order.UNHOME).state
    assert ordered(unhomed, Order.HOME, LOOP).refused
    assert ordered(SafetyState(), Order.HOME, LOOP).state.is_homed


@pytest.mark.parametrize(("order", "before"), [(Order.RESUME, P), (Order.ENABLE, D)])
def test_an_order_to_go_on_waits_for_rest_and_only_for_rest(order: Order, before: OperatingState) -> None:
    state = ordered(SafetyState(before, is_homed=True, is_stopping=True, held_by=PERSON), order).state
    assert (state.operating, state.waits) == (before, PERSON)
    seen = advance(state, InputReport(), 10).state
    assert seen == state
    assert rested(seen).operating is E
    assert rested(seen).waits is None
    for event in (
        InputReport(SEEN["pausing"]), Order.DISABLE.by(LOOP), Order.STOP.by(PERSON), MotionOrder.RETRACT.by(PERSON),
    ):  # fmt: skip
        assert advance(state, event, 10).state.waits is None
    assert ordered(replace(state, waits=None), order, LOOP).refused


def test_a_refusal_is_no_condition() -> None:
    assert advance(SafetyState(E), InputReport(frozenset({Cause.DEPTH_BEYOND})), 1).state.operating is E


def test_the_severities_are_those_of_the_slow_model() -> None:
    assert {str(each) for each in CONDITIONS if each.severity is Severity.PAUSE} == PAUSING


class BesideTheSlowModel(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.state, self.slow = SafetyState(), SlowRobot()
        self.stops = self.refusals = self.now_ns = 0

    @rule(
        causes=st.frozensets(st.sampled_from(CONDITIONS), max_size=3), busy=st.booleans(), retracting=st.booleans(),
        resting=st.booleans(),
    )  # fmt: skip
    def see(self, causes: frozenset[Cause], busy: bool, retracting: bool, resting: bool) -> None:
        self.apply(InputReport(causes, busy, retracting, resting))
        self.slow.look({str(each) for each in causes}, retracting=retracting, resting=resting)
        assert self.state.is_busy == busy

    @rule(retracting=st.booleans(), resting=st.booleans())
    def see_nothing_wrong(self, retracting: bool, resting: bool) -> None:
        self.see(frozenset(), False, retracting, resting)

    @rule(order=st.sampled_from([*Order, *MotionOrder]), owner=st.sampled_from(Owner))
    def order(self, order: Order | MotionOrder, owner: Owner) -> None:
        before = self.state.operating
        self.apply(order.by(owner))
        self.slow.ask(str(order), owner.value)
        assert (self.state.operating is F) == (before is F)

    @rule()
    def sign_home_and_enable(self) -> None:
        self.see(frozenset(), False, False, True)
        for order in (Order.RESET, Order.HOME, Order.ENABLE):
            self.order(order, PERSON)

    def apply(self, event: InputReport | Ordered) -> None:
        before = self.state
        self.now_ns += 1
        step = advance(before, event, self.now_ns)
        assert step == advance(before, event, self.now_ns)
        self.state = step.state
        self.stops += GuardAction.STOP in step.actions
        self.refusals += step.refused
        if before.operating is E and self.state.operating is not E:
            assert GuardAction.STOP in step.actions
        if before.operating is F:
            assert self.state.operating in (F, D)

    @invariant()
    def agrees(self) -> None:
        state, slow = self.state, self.slow
        assert (state.operating, state.is_homed, state.is_zero_lost) == (slow.state, slow.homed, slow.distrusted)
        assert (state.held_by.value if state.held_by else "") == slow.holder
        assert (state.motion.value if state.motion else "") == slow.mover
        assert {str(each) for each in state.present} == slow.there
        assert {str(each) for each in state.latched} == slow.unsigned
        assert state.is_stopping == slow.unsettled
        assert (state.waits.value if state.waits else "") == slow.next_in_line
        assert (self.stops, self.refusals) == (slow.stops, slow.refusals)

    @invariant()
    def what_is_enabled_is_well(self) -> None:
        if self.state.operating is E:
            assert not self.state.present
            assert self.state.is_homed
            assert not self.state.retracting
            assert not self.state.is_stopping


TestBesideTheSlowModel = BesideTheSlowModel.TestCase
