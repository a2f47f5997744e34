"""The guard of Rust beside its twin in Python: the same transitions from any state, on random steps and histories."""

import random

import pytest

from needleplan import _ppvi
from needleplan.control.safety import (
    Cause,
    InputReport,
    MotionOrder,
    OperatingState,
    Order,
    Ordered,
    Owner,
    SafetyState,
    Severity,
    advance,
)
from needleplan.control.safety._causes import bits_of
from needleplan.control.safety._states import numbers_of
from tests import pages
from tests.control.safety import twin
from tests.control.safety.rules_model import PAUSING, whose

CAUSES = list(Cause)
OWNERS = [None, *Owner]
ORDERS = [*Order, *MotionOrder]
TRANSITIONS = pages.ROOT / "rust/guard/tests/transitions.csv"
"""Transitions of the twin, beside which the tests of the crate compare its own; see `transitions`."""

REFUSALS = CAUSES[CAUSES.index(Cause.NOT_POSSIBLE) :]


def some_causes(draw: random.Random) -> frozenset[Cause]:
    """Mostly few causes, often none, sometimes any number."""
    count = draw.choice([0, 0, 0, 1, 1, 2, len(CAUSES) // 2])
    return frozenset(draw.sample(CAUSES, count))


def some_event(draw: random.Random) -> Ordered | InputReport:
    if draw.random() < 0.5:
        return draw.choice(ORDERS).by(draw.choice(list(Owner)))
    return InputReport(some_causes(draw), *(draw.random() < 0.5 for _ in range(3)))


def some_state(draw: random.Random) -> SafetyState:
    """Any state, also one that no history leads to."""
    return SafetyState(
        draw.choice(list(OperatingState)), draw.random() < 0.5, draw.random() < 0.5, some_causes(draw),
        some_causes(draw), draw.randrange(10**12), draw.choice(OWNERS), draw.choice(OWNERS), draw.random() < 0.5,
        some_causes(draw), draw.random() < 0.5, draw.choice(OWNERS),
    )  # fmt: skip


def compare(steps: int, seed: int) -> int:
    """Compare the transitions from random states and along histories; return how many changed the state."""
    draw, changes = random.Random(seed), 0
    state = SafetyState()
    for number in range(steps):
        if number % 8 == 0:
            state = some_state(draw)
        event, now_ns = some_event(draw), draw.randrange(10**15)
        step = advance(state, event, now_ns)
        assert step == twin.advance(state, event, now_ns), (state, event)
        changes += step.state is not state
        state = step.state
    return changes


def transitions(count: int, seed: int) -> list[str]:
    """Return lines of random transitions of the twin: state, event, time; refused, stops, motion, causes, next state.

    None is -1; an order is its number and that of its owner, a validation -1, the causes, and three truth values.
    """
    draw, lines = random.Random(seed), []
    state = SafetyState()
    for number in range(count):
        if number % 4 == 0:
            state = some_state(draw)
        event, now_ns = some_event(draw), draw.randrange(10**15)
        step = twin.advance(state, event, now_ns)
        if isinstance(event, InputReport):
            told = [-1, bits_of(event.causes), event.busy, event.retracting, event.resting]
        else:
            told = [ORDERS.index(event.what), OWNERS.index(event.owner) - 1, 0, 0, 0]
        motion = next((("move", "retract").index(each) for each in step.actions if each != "stop"), -1)
        after = [step.refused, "stop" in step.actions, motion, bits_of(step.causes), *numbers_of(step.state)]
        numbers = [*numbers_of(state), *told, now_ns, *after]
        lines.append(",".join(str(-1 if each is None else int(each)) for each in numbers))
        state = step.state
    return lines


def test_the_transitions_that_the_crate_is_compared_with_are_those_of_the_twin() -> None:
    assert TRANSITIONS.read_text().splitlines() == transitions(2000, seed=4)


def test_twin_and_guard_agree_on_random_steps() -> None:
    assert compare(20_000, seed=1) > 5_000


@pytest.mark.study
def test_twin_and_guard_agree_on_a_million_random_steps() -> None:
    assert compare(1_000_000, seed=2) > 250_000


def test_every_cause_has_its_number_owner_and_severity() -> None:
    names = [name for name, _, _ in _ppvi.guard_causes()]
    assert names == [cause.value for cause in Cause]
    for cause in Cause:
        severity = "pause" if cause.value in PAUSING else "refusal" if cause in REFUSALS else "fault"
        assert cause.severity is Severity(severity)
        if cause not in REFUSALS:  # a refusal concerns its order alone
            assert cause.owner == ("person" if cause is Cause.STOP_ORDERED else whose(cause.value))


def test_a_number_that_stands_for_nothing_is_refused() -> None:
    fields = (0, False, False, 0, 0, 0, None, None, False, 0, False, None)
    for before, order, owner in (((9, *fields[1:]), 0, 0), (fields, 10, 0), (fields, 0, 4)):
        with pytest.raises(ValueError, match="no value has the number"):
            _ppvi.guard_ordered(before, order, owner, 0)


def test_a_window_of_forces_that_overflows_counts_as_rising_until_it_is_known_again() -> None:
    window = _ppvi.ForceWindow()
    for number in range(513):  # 20 kHz, rising
        window.observe(number * 50_000, number * 1e-6)
    assert window.rise_n == float("inf")
    assert window.exceeds(1e9)
    known_ns = 512 * 50_000 + 50_000_000
    window.observe(known_ns, 0.0)
    assert window.exceeds(1e9)
    window.observe(known_ns + 1, 0.0)
    assert not window.exceeds(1e-9)
