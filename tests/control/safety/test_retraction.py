"""Retraction by a person: in every state, outward only, and nothing but the person stops it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.control.safety import Cause, OperatingState, Order, SafetyEventName
from needleplan.devices import Health
from needleplan.errors import DeviceFault, MotionRefused
from tests.control.safety.bench import NAN, Bench

STATES = ["never enabled", "enabled", "paused", "fault", "latched"]
EVERYTHING = {"force", "pose", "loop"}


def in_state(name: str) -> Bench:
    bench = Bench()
    bench.stage.depth_mm = 40.0
    if name == "never enabled":
        bench.turn()
        return bench
    guard = bench.enabled()
    guard.insert(60.0, 5.0)
    if name == "paused":
        guard.order(Order.PAUSE)
    if name == "fault":
        bench.without = EVERYTHING
        bench.turns(0.2)
        assert guard.state.operating is OperatingState.FAULT
    if name == "latched":
        guard.stop()
    return bench


@pytest.mark.parametrize("name", STATES)
def test_it_is_allowed_in_every_state_and_leaves_none_for_enabled(name: str) -> None:
    bench = in_state(name)
    before = bench.guard.state.operating
    bench.guard.retract(0.0, 20.0, "anna")
    assert bench.stage.wire[-1] == ("insert", 0.0, 20.0)
    event = bench.named(SafetyEventName.RETRACTION)[-1]
    assert event.entry()["text"].endswith("by anna")
    after = bench.guard.state.operating
    assert after is (OperatingState.PAUSED if name == "enabled" else before)


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize(
    ("depth_mm", "velocity_mm_s", "cause"),
    [
        (40.1, 5.0, Cause.NOT_A_RETRACTION),
        (-101.0, 5.0, Cause.DEPTH_BEYOND),
        (0.0, 20.1, Cause.VELOCITY_BEYOND),
        (0.0, 0.0, Cause.VELOCITY_BEYOND),
        (NAN, 5.0, Cause.NOT_FINITE),
        (0.0, NAN, Cause.NOT_FINITE),
    ],
)
def test_what_is_none_is_refused(name: str, depth_mm: float, velocity_mm_s: float, cause: Cause) -> None:
    bench = in_state(name)
    count = len(bench.stage.wire)
    with pytest.raises(MotionRefused) as refusal:
        bench.guard.retract(depth_mm, velocity_mm_s)
    assert refusal.value.causes == (cause,)
    assert len(bench.stage.wire) == count


@given(depth_mm=st.floats(), velocity_mm_s=st.floats(), here_mm=st.floats(-100, 150))
def test_it_never_goes_deeper_or_faster(depth_mm: float, velocity_mm_s: float, here_mm: float) -> None:
    bench = Bench()
    bench.stage.depth_mm = here_mm
    bench.turn()
    try:
        bench.guard.retract(depth_mm, velocity_mm_s)
    except MotionRefused:
        assert bench.stage.wire == []
        assert not (-100 <= depth_mm <= here_mm and 0 < velocity_mm_s <= 20)
    else:
        assert bench.stage.wire == [("insert", depth_mm, velocity_mm_s)]
        assert depth_mm <= here_mm
        assert 0 < velocity_mm_s <= 20


@pytest.mark.parametrize("how", ["silent", "suspect", "failed"])
def test_from_where_nobody_knows_only_all_the_way_out(how: str) -> None:
    bench = in_state("enabled")
    if how == "silent":
        bench.without = {"stage"}
    read = bench.stage.read

    def suspect(timeout_s: float):  # type: ignore[no-untyped-def]
        sample = read(timeout_s)
        return type(sample)(**{**vars(sample), "health": Health.SUSPECT})

    if how == "suspect":
        bench.stage.read = suspect  # type: ignore[method-assign]
    bench.turns(0.1)
    if how == "failed":
        bench.stage.broken = True
        with pytest.raises(Exception, match="not there"):
            bench.guard.read(0)
        bench.stage.broken = False
    with pytest.raises(MotionRefused) as refusal:
        bench.guard.retract(0.0, 5.0)
    assert refusal.value.causes == (Cause.NOT_A_RETRACTION,)
    bench.guard.retract(-100.0, 5.0)
    assert bench.stage.wire[-1] == ("insert", -100.0, 5.0)


def test_no_cause_stops_it_but_a_person_does() -> None:
    bench = in_state("fault")
    bench.stage.moving = True
    bench.guard.retract(0.0, 5.0)
    bench.force = {"force_n": (0.0, 0.0, -40.0)}
    for name in (set(), EVERYTHING):
        bench.without = name
        for _ in range(40):
            bench.stage.depth_mm -= 0.025
            bench.turn()
    assert bench.stage.wire[-1] == ("insert", 0.0, 5.0)
    bench.guard.stop()
    assert bench.stage.wire[-1] == ("stop",)


@pytest.mark.parametrize("name", STATES)
def test_a_stage_that_goes_the_wrong_way_is_stopped(name: str) -> None:
    bench = in_state(name)
    bench.stage.moving = True
    bench.guard.retract(0.0, 5.0)
    for _ in range(200):
        bench.stage.depth_mm += 0.025
        bench.turn()
        if bench.stage.wire[-1] == ("stop",):
            break
    assert Cause.WRONG_WAY in bench.guard.state.latched
    assert bench.stage.depth_mm < 42.0
    assert not bench.guard._monitor.motion.retracting


@pytest.mark.parametrize("name", STATES)
def test_a_stage_that_jumps_is_stopped(name: str) -> None:
    bench = in_state(name)
    bench.stage.moving = True
    bench.guard.retract(0.0, 5.0)
    bench.turn()
    assert bench.stage.wire[-1] == ("insert", 0.0, 5.0)
    bench.stage.depth_mm -= 20.0
    bench.turn()
    assert bench.stage.wire[-1] == ("stop",)
    assert Cause.STAGE_JUMPED in bench.guard.state.latched
    assert not bench.guard.state.is_homed


def test_when_it_is_done_a_stage_that_moves_is_a_fault_again() -> None:
    bench = in_state("paused")
    bench.stage.moving = True
    bench.guard.retract(0.0, 20.0)
    while bench.stage.depth_mm > 0:
        bench.stage.depth_mm -= 0.1
        bench.turn()
    bench.stage.moving = False
    bench.turns(0.6)
    assert bench.guard.state.operating is OperatingState.PAUSED
    bench.stage.moving = True
    bench.turn()
    assert bench.guard.state.operating is OperatingState.FAULT
    assert bench.stage.wire[-1] == ("stop",)


@pytest.mark.parametrize("order", [Order.RESUME, Order.ENABLE])
def test_until_it_ends_nobody_can_enable(order: Order) -> None:
    bench = in_state("paused" if order is Order.RESUME else "never enabled")
    guard = bench.guard
    bench.turn()
    guard.order(Order.RESET)
    if order is Order.ENABLE:
        guard.order(Order.HOME)
    bench.stage.moving = True
    guard.retract(0.0, 5.0, "anna")
    bench.turn()
    with pytest.raises(MotionRefused, match="not_possible"):
        guard.order(order, "anna")
    assert bench.stage.wire[-1] == ("insert", 0.0, 5.0)
    bench.stage.depth_mm, bench.stage.moving = 39.7, False
    bench.turns(0.6)
    assert guard.order(order, "anna").operating is OperatingState.ENABLED


def test_after_it_a_fault_stops_the_next_insertion() -> None:
    bench = in_state("enabled")
    guard = bench.guard
    guard.retract(39.9, 5.0, "anna")
    bench.turn()
    guard.order(Order.RESUME, "anna")
    bench.rest()
    guard.insert(60.0, 5.0)
    bench.force = {"force_n": (0.0, 0.0, 50.0)}
    bench.turn()
    assert bench.stage.wire[-1] == ("stop",)
    assert guard.state.operating is OperatingState.FAULT


def test_it_ends_also_if_it_began_before_the_first_sample(bench: Bench) -> None:
    bench.guard.retract(-100.0, 20.0, "anna")
    bench.stage.depth_mm, bench.stage.moving = 40.0, True
    for _ in range(40):
        bench.stage.depth_mm -= 0.1
        bench.turn()
    assert bench.stage.wire == [("insert", -100.0, 20.0)]
    bench.stage.moving = False
    bench.turns(1.2)
    bench.guard.order(Order.HOME, "anna")
    assert bench.guard.order(Order.ENABLE, "anna").operating is OperatingState.ENABLED


def test_a_retraction_that_fails_does_not_end_the_stop() -> None:
    bench = in_state("enabled")
    bench.stage.moving = True
    bench.guard.order(Order.PAUSE, "anna")
    bench.turn()
    bench.stage.broken = True
    with pytest.raises(DeviceFault, match="not there"):
        bench.guard.retract(0.0, 5.0, "anna")
    bench.stage.broken = False
    count = len(bench.stage.wire)
    bench.turns(0.3)
    assert ("stop",) in bench.stage.wire[count:]
    assert ("insert", 0.0, 5.0) not in bench.stage.wire
