"""The states: every transition of the table, and long histories beside a slow model of the rules."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from needleplan.control.safety import (
    Cause,
    GuardAction,
    InputReport,
    OperatingState,
    Order,
    SafetyState,
    Severity,
    advance,
)
from needleplan.control.safety._states import begin_retraction
from tests.control.safety.rules_model import PAUSING, SlowRobot

CONDITIONS = [each for each in Cause if each.severity is not Severity.REFUSAL and each is not Cause.STOP_ORDERED]
D, E, P, F = OperatingState.DISABLED, OperatingState.ENABLED, OperatingState.PAUSED, OperatingState.FAULT

# The whole table: state, what happens, and where it ends; a stop is sent where there is an exclamation mark.
# The state is homed, nothing is latched, and in FAULT the force is stale.
TABLE = """
DISABLED  healthy   DISABLED
DISABLED  pausing   DISABLED
DISABLED  faulting  DISABLED
DISABLED  moving    FAULT !
DISABLED  enable    ENABLED
DISABLED  disable   DISABLED !
DISABLED  pause     refused
DISABLED  resume    refused
DISABLED  continue  refused
DISABLED  reset     DISABLED
DISABLED  stop      DISABLED !
DISABLED  home      DISABLED
DISABLED  unhome    DISABLED
ENABLED   healthy   ENABLED
ENABLED   pausing   PAUSED !
ENABLED   faulting  FAULT !
ENABLED   moving    FAULT !
ENABLED   enable    ENABLED
ENABLED   disable   DISABLED !
ENABLED   pause     PAUSED !
ENABLED   resume    refused
ENABLED   continue  refused
ENABLED   reset     ENABLED
ENABLED   stop      DISABLED !
ENABLED   home      refused
ENABLED   unhome    refused
PAUSED    healthy   PAUSED
PAUSED    pausing   PAUSED
PAUSED    faulting  FAULT !
PAUSED    moving    FAULT !
PAUSED    enable    refused
PAUSED    disable   DISABLED !
PAUSED    pause     PAUSED !
PAUSED    resume    ENABLED
PAUSED    continue  ENABLED
PAUSED    reset     PAUSED
PAUSED    stop      DISABLED !
PAUSED    home      refused
PAUSED    unhome    refused
FAULT     healthy   DISABLED
FAULT     pausing   DISABLED
FAULT     faulting  FAULT
FAULT     moving    FAULT !
FAULT     enable    refused
FAULT     disable   FAULT !
FAULT     pause     refused
FAULT     resume    refused
FAULT     continue  refused
FAULT     reset     refused
FAULT     stop      FAULT !
FAULT     home      refused
FAULT     unhome    refused
"""
ROWS = [tuple(line.split()) for line in TABLE.strip().splitlines()]
SEEN = {
    "healthy": frozenset(),
    "pausing": frozenset({Cause.POSE_UNSEEN}),
    "faulting": frozenset({Cause.FORCE_STALE}),
    "moving": frozenset({Cause.STILL_MOVING}),
}


def test_the_table_is_whole() -> None:
    assert {row[:2] for row in ROWS} == set(product(OperatingState, (*SEEN, *Order)))
    assert len(ROWS) == 4 * (len(SEEN) + len(Order))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: "-".join(row[:2]))
def test_every_transition(row: tuple[str, ...]) -> None:
    before = SafetyState(OperatingState(row[0]), is_homed=True, since_ns=3)
    if before.operating is F:
        before = SafetyState(F, True, present=SEEN["faulting"], latched=SEEN["faulting"], since_ns=3)
    step = advance(before, InputReport(SEEN[row[1]]) if row[1] in SEEN else Order(row[1]), 7)
    assert step.refused == (row[2] == "refused")
    assert (GuardAction.STOP in step.actions) == (row[-1] == "!")
    if step.refused:
        assert step.state == before
        assert step.causes
    else:
        assert step.state.operating == row[2]
        assert step.state.since_ns == (7 if step.state.operating is not before.operating else 3)


@pytest.mark.parametrize("cause", CONDITIONS)
def test_every_cause_stops_and_latches_by_its_severity(cause: Cause) -> None:
    step = advance(SafetyState(E, is_homed=True), InputReport(frozenset({cause})), 1)
    assert step.actions == (GuardAction.STOP,)
    assert step.causes == {cause}
    assert step.state.operating is (P if cause.severity is Severity.PAUSE else F)
    assert step.state.latched == (frozenset() if cause.severity is Severity.PAUSE else {cause})
    healthy = advance(step.state, InputReport(), 2).state
    assert healthy.operating is (P if cause.severity is Severity.PAUSE else D)
    assert advance(healthy, Order.ENABLE, 3).refused


@pytest.mark.parametrize("operating", OperatingState)
@pytest.mark.parametrize("cause", CONDITIONS)
def test_only_two_causes_stop_a_retraction_and_every_cause_stops_the_loop(
    operating: OperatingState, cause: Cause
) -> None:
    before = SafetyState(operating, True, present=SEEN["faulting"] if operating is F else frozenset())
    step = advance(before, InputReport(frozenset({cause}), busy=True, retracting=True), 1)
    ends = cause in (Cause.WRONG_WAY, Cause.STAGE_JUMPED)
    assert (GuardAction.STOP in step.actions) == (ends or operating is E)
    if ends:
        assert step.state.operating is F
        assert cause in step.state.latched


@pytest.mark.parametrize("before", [P, E])
@pytest.mark.parametrize("how", ["pause", "retraction"])
def test_the_loop_does_not_end_the_pause_of_a_person(before: OperatingState, how: str) -> None:
    state = SafetyState(before, is_homed=True)
    paused = (advance(state, Order.PAUSE, 1) if how == "pause" else begin_retraction(state, 1)).state
    assert paused.operating is P
    assert paused.person_paused
    seen = advance(advance(paused, InputReport(SEEN["pausing"]), 2).state, InputReport(), 3).state
    assert advance(seen, Order.CONTINUE, 4).causes == {Cause.NOT_POSSIBLE}
    assert advance(seen, Order.CONTINUE, 4).refused
    resumed = advance(seen, Order.RESUME, 5).state
    assert resumed.operating is E
    later = advance(advance(resumed, InputReport(SEEN["pausing"]), 6).state, InputReport(), 7).state
    assert not later.person_paused
    assert advance(later, Order.CONTINUE, 8).state.operating is E


def test_a_latched_stop_needs_a_reset_and_says_so() -> None:
    state = advance(SafetyState(E, is_homed=True), Order.STOP, 1).state
    refused = advance(state, Order.ENABLE, 2)
    assert refused.causes == {Cause.NOT_RESET, Cause.STOP_ORDERED}
    assert advance(advance(state, Order.RESET, 3).state, Order.ENABLE, 4).state.operating is E


def test_a_lost_zero_needs_homing() -> None:
    state = advance(SafetyState(E, is_homed=True), InputReport(frozenset({Cause.STAGE_JUMPED})), 1).state
    state = advance(advance(state, InputReport(), 2).state, Order.RESET, 3).state
    assert advance(state, Order.ENABLE, 4).causes == {Cause.NOT_HOMED}
    assert advance(advance(state, Order.HOME, 5).state, Order.ENABLE, 6).state.operating is E


def test_a_refusal_is_no_condition() -> None:
    assert advance(SafetyState(E), InputReport(frozenset({Cause.DEPTH_BEYOND})), 1).state.operating is E


def test_the_severities_are_those_of_the_slow_model() -> None:
    assert {str(each) for each in CONDITIONS if each.severity is Severity.PAUSE} == PAUSING


class BesideTheSlowModel(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.state, self.slow = SafetyState(), SlowRobot()
        self.stops = self.refusals = self.now_ns = 0

    @rule(causes=st.frozensets(st.sampled_from(CONDITIONS), max_size=3), busy=st.booleans())
    def see(self, causes: frozenset[Cause], busy: bool) -> None:
        self.apply(InputReport(causes, busy))
        self.slow.look({str(each) for each in causes})
        assert self.state.is_busy == busy

    @rule()
    def see_nothing_wrong(self) -> None:
        self.see(frozenset(), False)

    @rule(order=st.sampled_from(Order))
    def order(self, order: Order) -> None:
        before = self.state.operating
        self.apply(order)
        self.slow.ask(str(order))
        assert (self.state.operating is F) == (before is F)

    @rule()
    def sign_home_and_enable(self) -> None:
        for order in (Order.RESET, Order.HOME, Order.ENABLE):
            self.order(order)

    def apply(self, event: InputReport | Order) -> None:
        before = self.state
        self.now_ns += 1
        step = advance(before, event, self.now_ns)
        assert step == advance(before, event, self.now_ns)
        self.state = step.state
        self.stops += len(step.actions)
        self.refusals += step.refused
        if before.operating is E and self.state.operating is not E:
            assert GuardAction.STOP in step.actions
        if before.operating is F:
            assert self.state.operating in (F, D)

    @invariant()
    def agrees(self) -> None:
        slow = self.slow
        assert (self.state.operating, self.state.is_homed) == (slow.state, slow.homed)
        assert self.state.person_paused == slow.held
        assert {str(each) for each in self.state.present} == slow.there
        assert {str(each) for each in self.state.latched} == slow.unsigned
        assert (self.stops, self.refusals) == (slow.stops, slow.refusals)

    @invariant()
    def what_is_enabled_is_well(self) -> None:
        if self.state.operating is E:
            assert not self.state.present
            assert self.state.is_homed


TestBesideTheSlowModel = BesideTheSlowModel.TestCase
