"""All interleavings of person, loop, sensors and robot, until no new state is left; mutants must be found."""

from dataclasses import replace
from typing import Any

import pytest

from needleplan.control.safety import (
    Cause,
    GuardAction,
    InputReport,
    MotionOrder,
    OperatingState,
    Order,
    Owner,
    SafetyState,
    SafetyTransition,
)
from tests.control.safety import twin as machine
from tests.control.safety.explorer import explore


def test_no_interleaving_breaks_an_invariant() -> None:
    found = explore()
    assert found.mistakes == {}
    assert found.worlds > 4_000
    assert 10 <= found.depth < 100  # the search ended because nothing new was left


@pytest.mark.study
def test_nor_do_two_causes_at_once() -> None:
    found = explore(together=2)
    assert found.mistakes == {}
    assert found.worlds > 15_000
    assert found.depth < 100


def allowed(state: SafetyState, *_: Any) -> SafetyTransition:
    return SafetyTransition(replace(state, motion=Owner.LOOP), (GuardAction.MOVE,))


def unlatched(state: SafetyState, *_: Any) -> SafetyState:
    return state


def silent(state: SafetyState, causes: frozenset[Cause] = frozenset()) -> SafetyTransition:
    return SafetyTransition(state, (), causes)


def reset_by_anybody(state: SafetyState, *_: Any) -> SafetyTransition:
    return RESET(state, Owner.PERSON, 0)


def enabled_out_of_a_fault(state: SafetyState, *_: Any) -> SafetyTransition:
    return SafetyTransition(replace(state, operating=OperatingState.ENABLED))


def retracting_in_any_state(state: SafetyState, *_: Any) -> SafetyTransition:
    return SafetyTransition(replace(state, motion=Owner.PERSON), (GuardAction.RETRACT,))


def stopped_but_for_a_retraction(state: SafetyState, owner: Owner, now_ns: int) -> SafetyTransition:
    return SafetyTransition(state) if state.retracting else machine._stop(state, owner, now_ns)


def paused_by_anybody(state: SafetyState, *_: Any) -> SafetyTransition:
    return machine._pause(state, Owner.PERSON, 0)


def begun_while_it_moves(state: SafetyState, *_: Any) -> SafetyTransition:
    return SafetyTransition(machine._enabled(state, 0))


def taken_for_rest(state: SafetyState, report: InputReport, now_ns: int) -> SafetyTransition:
    return VALIDATED(state, replace(report, resting=True), now_ns)


def patient(state: SafetyState, causes: frozenset[Cause] = frozenset()) -> SafetyTransition:
    return replace(STOPPED(state, causes), state=replace(STOPPED(state, causes).state, waits=state.waits))


def forgotten(state: SafetyState, causes: frozenset[Cause] = frozenset()) -> SafetyTransition:
    return replace(STOPPED(state, causes), state=replace(state, motion=None))


RESET, VALIDATED, STOPPED = machine._reset, machine._validated, machine._stopped
MUTANTS: dict[str, tuple[str, Any]] = {
    "the loop may end every hold": ("_may_begin", lambda *_: True),
    "causes do not latch": ("_latched", unlatched),
    "holds are forgotten": ("_held", unlatched),
    "a stop is not sent": ("_stopped", silent),
    "any stop ends a retraction": ("_stopped_by", lambda _, *others: machine._stopped(*others)),
    "every cause ends a retraction": ("_ENDS_RETRACTION", frozenset(Cause)),
    "no cause ends a retraction": ("_ENDS_RETRACTION", frozenset()),
    "RESUME does not wait for rest": ("_begun", begun_while_it_moves),
    "no sample is taken for rest": ("_validated", taken_for_rest),
    "a wait outlives a stop": ("_stopped", patient),
    "the end of a stop is not awaited": ("_stopped", forgotten),
}  # fmt: skip
ORDERS: dict[str, tuple[Order | MotionOrder, Any]] = {
    "the loop moves when it likes": (MotionOrder.MOVE, allowed),
    "the loop resets": (Order.RESET, reset_by_anybody),
    "ENABLE works in every state": (Order.ENABLE, enabled_out_of_a_fault),
    "RESUME works in every state": (Order.RESUME, enabled_out_of_a_fault),
    "a retraction does not pause": (MotionOrder.RETRACT, retracting_in_any_state),
    "STOP is suppressed during a retraction": (Order.STOP, stopped_but_for_a_retraction),
    "PAUSE by the loop stops a retraction": (Order.PAUSE, paused_by_anybody),
}  # fmt: skip


@pytest.mark.study  # of the explorer, not of the guard
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, *MUTANTS[name])
    assert explore(8, to_the_end=False, advance=machine.advance).mistakes


@pytest.mark.study
@pytest.mark.parametrize("name", ORDERS)
def test_a_mutant_of_an_order_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    order, mutant = ORDERS[name]
    monkeypatch.setitem(machine._ORDERS, order, mutant)
    assert explore(8, to_the_end=False, advance=machine.advance).mistakes
