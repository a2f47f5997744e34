"""Behaviours that surviving mutants of the guard (benches/python/mutation.py) showed to be untested."""

import threading
from dataclasses import FrozenInstanceError, replace
from typing import Any

import pytest

from needleplan import _ppvi
from needleplan.control.safety import (
    Cause,
    GuardedStage,
    Inputs,
    OperatingState,
    Order,
    Owner,
    SafetyEvent,
    SafetyEventName,
    SafetyLimits,
    SafetyState,
    Watchdog,
)
from needleplan.control.safety._inputs import Delay, InputStatus, LoopStatus, RecordingStatus
from needleplan.control.safety._monitor import ForceRise, RunMonitor
from needleplan.control.safety._motion import Goal, MotionWatch
from needleplan.control.safety._states import InputReport, Ordered, SafetyTransition
from needleplan.control.safety._wire import GuardWire
from needleplan.devices import ForceSample, Health, StageSample, Stamp
from needleplan.errors import DeviceFault, MotionRefused, SafetyError
from needleplan.recording import RecorderState, RecorderStatus
from tests.control.safety.bench import Bench

LIMITS = SafetyLimits()
STAGE = StageSample(Stamp(0, 1), 10.0, 0.0, 0.0, False)
SECOND_NS = 10**9
VALUES: list[Any] = [
    SafetyState(), SafetyTransition(SafetyState()), InputReport(), Ordered(Order.STOP, Owner.PERSON), Delay(),
    InputStatus(), Inputs(), LoopStatus(0), RecordingStatus(), MotionWatch(), Goal(0.0, 1.0, 1.0, 0.0, 0), LIMITS,
    SafetyEvent(SafetyEventName.STOP, 0, OperatingState.FAULT),
]  # fmt: skip
POSITIVE = {
    "force_n": 50, "force_rate_n_s": 1000, "insertion_velocity_mm_s": 100, "retraction_velocity_mm_s": 100,
    "rotation_velocity_rad_s": 100, "roll_rad": 200, "pose_jump_mm": 50, "out_of_plane_mm": 1000, "run_s": 7200,
    "force_age_s": 10, "pose_age_s": 10, "stage_age_s": 10, "loop_age_s": 10, "deadman_age_s": 10,
    "recording_age_s": 10, "motion_s": 10, "following_mm": 5, "following_rad": 3,
}  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_no_listener_can_change_what_the_guard_knows(value: Any) -> None:
    with pytest.raises(FrozenInstanceError):
        setattr(value, next(iter(value.__dataclass_fields__)), None)


@pytest.mark.parametrize(("name", "most"), POSITIVE.items())
def test_a_limit_is_any_positive_number_up_to_its_most(name: str, most: float) -> None:
    for value in (1e-6, 0.5, float(most)):
        assert getattr(SafetyLimits(**{name: value}), name) == value
    for value in (0.0, -1e-6, most + 1e-6):
        with pytest.raises(SafetyError):
            SafetyLimits(**{name: value})


@pytest.mark.parametrize(("name", "sides"), [("shallowest_mm", (-500, 149)), ("deepest_mm", (-99, 500))])
def test_depths_are_at_most_500_mm_to_either_side(name: str, sides: tuple[float, float]) -> None:
    for value, beyond in zip(sides, (-501.0, 501.0), strict=True):
        assert getattr(SafetyLimits(**{name: float(value)}), name) == value
        with pytest.raises(SafetyError):
            SafetyLimits(**{name: beyond})


def test_a_listener_that_failed_once_is_reported_once(bench: Bench, guard: GuardedStage) -> None:
    guard._wire.events.failed = True
    bench.turn()
    assert guard.state.latched == {Cause.RECORDING_LOST}
    assert guard.state.present == set()
    assert [each.causes for each in bench.named(SafetyEventName.RAISED)][-1:] == [{Cause.RECORDING_LOST}]


def test_events_name_what_appeared_and_what_went_and_nothing_else(bench: Bench, guard: GuardedStage) -> None:
    bench.events.clear()
    for causes in ({Cause.PLAN_LOST}, {Cause.PLAN_LOST, Cause.IN_OBSTACLE}, {Cause.IN_OBSTACLE}, set()):
        guard.report(causes)
    assert [each.causes for each in bench.named(SafetyEventName.RAISED)] == [{Cause.PLAN_LOST}, {Cause.IN_OBSTACLE}]
    assert [each.causes for each in bench.named(SafetyEventName.CLEARED)] == [{Cause.PLAN_LOST}, {Cause.IN_OBSTACLE}]


def test_the_time_of_a_run_begins_when_it_is_enabled_and_not_when_it_is_homed() -> None:
    bench = Bench(run_s=1.0)
    bench.turn()
    bench.guard.order(Order.HOME, "anna")
    bench.turns(2.0)
    bench.guard.order(Order.ENABLE, "anna")
    bench.turns(0.9)
    assert bench.guard.state.operating is OperatingState.ENABLED
    bench.turns(0.2)
    assert bench.guard.state.first == {Cause.TIME_EXCEEDED}


def test_a_read_without_a_sample_is_no_fault(
    bench: Bench, guard: GuardedStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench.stage, "read", lambda _: None)
    assert guard.read(0.0) is None
    assert guard.state.operating is OperatingState.ENABLED


@pytest.mark.parametrize(
    ("order", "commanded", "other", "jump"),
    [("rotate", "roll_rad", "depth_mm", 0.6), ("insert", "depth_mm", "roll_rad", 0.25)],
)
def test_what_has_no_command_and_drifts_during_a_motion_is_a_fault(
    bench: Bench, guard: GuardedStage, order: str, commanded: str, other: str, jump: float
) -> None:
    """The stage says that it moves, which is true of one axis; the other has no command."""
    getattr(guard, order)(20.0, 5.0)
    bench.stage.moving = True

    def turn() -> None:
        setattr(bench.stage, commanded, getattr(bench.stage, commanded) + 5.0 * 0.005)
        bench.turn()

    for _ in range(200):
        turn()
    assert guard.state.operating is OperatingState.ENABLED
    setattr(bench.stage, other, getattr(bench.stage, other) + jump)
    turn()
    assert guard.state.first == {Cause.WRONG_WAY}


def test_a_retraction_that_has_not_begun_to_move_is_still_one() -> None:
    watch = MotionWatch(last=STAGE).retracts(0.0, 5.0, 0)
    for number, (at_s, is_in_force) in enumerate([(0.1, True), (0.5, True), (0.501, False)]):
        sample = replace(STAGE, stamp=Stamp(round(at_s * SECOND_NS), number + 2))
        assert watch.then(sample, LIMITS).retracting == is_in_force


def test_an_axis_that_must_turn_round_has_the_time_for_it_before_it_is_stuck() -> None:
    """0.5 s to begin, 0.15 s to brake from 20 mm/s outward, and as long to come back at 10 mm/s."""
    goal = Goal(begin=0.0, end=50.0, velocity=10.0, begin_velocity=-20.0, began_ns=0)
    assert not goal.stuck(0.0, 0.1, 0.5, round(0.79 * SECOND_NS))
    assert goal.stuck(0.0, 0.1, 0.5, round(0.81 * SECOND_NS))


@pytest.mark.parametrize(("velocity_mm_s", "is_too_fast"), [(0.8, True), (0.5, False), (-0.8, False), (-31.0, True)])
def test_slow_limits_hold_for_slow_motions(velocity_mm_s: float, is_too_fast: bool) -> None:
    watch = MotionWatch(last=replace(STAGE, velocity_mm_s=velocity_mm_s, moving=True), rest_mm=10.0)
    found = set(watch.causes(SafetyLimits(insertion_velocity_mm_s=0.4), 0))
    assert (Cause.OVERSPEED in found) == is_too_fast


def test_no_force_is_no_rise_and_a_sample_of_50_ms_ago_still_counts() -> None:
    rise = ForceRise()
    assert not rise.exceeds(1.0)
    for time_ns, force_n, expected in ((0, 1.0, 0.0), (50_000_000, 3.0, 2.0), (100_000_000, 4.0, 1.0)):
        rise.observe(ForceSample(Stamp(time_ns, time_ns), (force_n, 0.0, 0.0), (0.0, 0.0, 0.0)))
        assert rise.rise_n == pytest.approx(expected)
    rise.observe(ForceSample(Stamp(150_000_001, 9), (5.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert rise.rise_n == 0.0


def test_the_age_of_the_deadman_switch_is_a_difference() -> None:
    monitor = RunMonitor(0, None, needs_deadman=True)
    monitor.observe_deadman(True, 1000)
    for now_ns, is_released in ((200_001_000, False), (200_001_001, True), (1_000_000_000, True)):
        found = monitor.causes(LIMITS, now_ns, running=False)
        assert (Cause.DEADMAN_RELEASED in found) == is_released


def test_a_repeated_number_is_repeated_wherever_it_was_read() -> None:
    """Two readings of one number are equal and need not be the same object."""
    first, again = (replace(STAGE, stamp=Stamp(at_ns, int("100000"))) for at_ns in (0, SECOND_NS))
    status = Inputs().with_stage(first)
    assert status.with_stage(again).stage == status.stage
    watch = MotionWatch().then(first, LIMITS)
    assert watch.then(replace(again, depth_mm=50.0), LIMITS) == watch


@pytest.mark.parametrize("damage", [{"health": Health.SUSPECT}, {"depth_mm": float("nan")}])
def test_from_a_suspect_sample_nobody_knows_where_the_stage_is(damage: dict[str, Any]) -> None:
    inputs = Inputs().with_stage(STAGE)
    assert inputs.stage_known(LIMITS, 1) == STAGE
    assert inputs.with_stage(replace(STAGE, stamp=Stamp(1, 2), **damage)).stage_known(LIMITS, 2) is None


@pytest.mark.parametrize(("age_ns", "is_reported"), [(0, True), (500_000_000, True), (500_000_001, False)])
def test_a_lost_message_is_reported_for_half_a_second(age_ns: int, is_reported: bool) -> None:
    status = RecorderStatus(RecorderState.RECORDING, "", 1, 0, 0.0, overflowed={"/force": 1})
    found = RecordingStatus().then(status, SECOND_NS).causes(LIMITS, SECOND_NS + age_ns)
    assert found == ({Cause.RECORDING_LOST} if is_reported else set())


def test_a_stop_after_a_command_that_it_has_overtaken_is_repeated_too(bench: Bench) -> None:
    wire = GuardWire(bench.stage, bench.clock, None, threading.RLock(), lambda *_: None)
    wire.plan_repetition()
    wire.flush(wire.taken())
    assert bench.stage.wire == [("stop",)]
    assert not wire.is_busy


def test_the_watchdog_goes_on_after_a_blocked_guard() -> None:
    checked = threading.Semaphore(0)

    class Blocked:
        def check(self) -> None:
            checked.release()
            raise MotionRefused("reach the guard", (Cause.LOOP_LATE,))

        def fail(self, error: Exception) -> None:
            raise AssertionError(error)

    with Watchdog(Blocked(), period_s=0.001) as watchdog:
        assert all(checked.acquire(timeout=10) for _ in range(3))
        assert watchdog.alive


def test_the_longest_time_of_a_retraction_is_twice_its_way_and_two_seconds(bench: Bench) -> None:
    bench.stage.depth_mm = 40.0
    guard = bench.enabled()
    assert guard.retraction_s == 0.0
    guard.retract(-10.0, 5.0, "anna")
    assert guard.retraction_s == 22.0


def test_stage_and_limits_may_be_named(bench: Bench) -> None:
    stage = bench.stage
    bench.guard.close()
    with GuardedStage(stage=stage, limits=LIMITS) as guard:
        assert guard.limits is LIMITS


def test_a_workspace_lies_within_10_m_to_either_side() -> None:
    for name in ("workspace_x_mm", "workspace_y_mm"):
        assert getattr(SafetyLimits(**{name: (-10_000.0, 10_000.0)}), name) == (-10_000.0, 10_000.0)
        for pair in ((-10_000.5, 0.0), (0.0, 10_000.5)):
            with pytest.raises(SafetyError):
                SafetyLimits(**{name: pair})


def test_a_way_shorter_than_the_least_is_never_stuck() -> None:
    near = Goal(begin=10.0, end=10.05, velocity=1.0, begin_velocity=0.0, began_ns=0)
    assert not near.stuck(10.0, 0.1, 0.5, SECOND_NS)
    assert replace(near, end=10.2).stuck(10.0, 0.1, 0.5, SECOND_NS)
    assert replace(near, end=9.8).stuck(10.0, 0.1, 0.5, SECOND_NS)
    # Of a way of 0.2 mm, a tenth is 0.02 mm.
    assert not replace(near, end=10.2).stuck(10.03, 0.1, 0.5, SECOND_NS)


@pytest.mark.parametrize(("place", "side"), [(8.0, 1.0), (0.0, -1.0)])
def test_an_axis_at_the_margin_of_its_way_has_not_left_it(place: float, side: float) -> None:
    goal = Goal(begin=0.0, end=8.0, velocity=2.0, begin_velocity=0.0, began_ns=0)
    margin = 0.5 + 0.15 * 2.0
    assert not goal.left(place + side * margin, 0.5)
    assert goal.left(place + side * (margin + 1e-9), 0.5)


def test_a_force_may_rise_by_its_limit() -> None:
    rise = ForceRise()
    for time_ns, force_n in ((0, 1.0), (5_000_000, 3.5)):
        rise.observe(ForceSample(Stamp(time_ns, time_ns), (force_n, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert not rise.exceeds(50.0)
    assert rise.exceeds(49.999)


def test_a_place_of_rest_is_known_after_the_time_to_come_to_rest() -> None:
    limits = SafetyLimits(motion_s=0.5)
    watch = replace(MotionWatch(last=STAGE), stopped_ns=0)
    at_end = watch.then(replace(STAGE, stamp=Stamp(500_000_000, 2)), limits)
    assert (500_000_000 - 0) * 1e-9 == 0.5
    assert (at_end.rest_mm, at_end.rest_rad) == (None, None)
    after = at_end.then(replace(STAGE, stamp=Stamp(501_000_000, 3)), limits)
    assert (after.rest_mm, after.rest_rad) == (10.0, 0.0)


def test_no_place_of_rest_is_taken_from_a_stage_that_still_moves() -> None:
    moving = replace(STAGE, stamp=Stamp(SECOND_NS, 2), moving=True)
    watch = MotionWatch(last=STAGE).then(moving, LIMITS)
    assert (watch.rest_mm, watch.rest_rad) == (None, None)


def test_a_stop_is_repeated_after_20_ms_or_ten_times_what_it_took() -> None:
    ms = 1_000_000
    for took_ms, arrived, wait_ms in ((1, True, 20), (5, True, 50), (300, True, 1000), (1, False, 250)):
        stop = _ppvi.RepeatedStop()
        stop.begin()
        assert not stop.due(10**12)
        assert stop.is_on_its_way
        stop.end(7 * ms, (7 + took_ms) * ms, arrived=arrived)
        again_ns = (7 + took_ms + wait_ms) * ms
        assert stop.is_on_its_way == (not arrived)
        assert not stop.due(again_ns - ms // 10)
        assert stop.due(again_ns + ms // 10)


def test_the_time_of_sending_is_recorded_where_there_is_one() -> None:
    event = SafetyEvent(SafetyEventName.STOP, 0, OperatingState.FAULT)
    assert "sent_ns" not in event.entry()
    assert replace(event, sent_ns=12345678901234567).entry()["sent_ns"] == "12345678901234567"


def test_retractions_are_counted_one_by_one(bench: Bench) -> None:
    bench.stage.depth_mm = 40.0
    guard = bench.enabled()
    for count in (1, 2):
        guard.retract(0.0, 5.0, "anna")
        assert guard.retractions == count


def test_a_listener_that_has_not_failed_is_not_reported(bench: Bench) -> None:
    bench.turn()
    raised = {cause for event in bench.named(SafetyEventName.RAISED) for cause in event.causes}
    assert Cause.RECORDING_LOST not in raised | bench.causes


def test_a_stop_that_the_stage_refuses_is_a_failure_of_the_stage(
    bench: Bench, guard: GuardedStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(bench.stage, "stop", refuse)
        guard.stop()
        guard.check()
    assert Cause.STAGE_FAULT in guard.state.present


def refuse() -> None:
    raise DeviceFault("the stage does not answer")


@pytest.mark.parametrize("before", [None, OperatingState.PAUSED])
def test_the_entry_of_an_event_has_the_state_before_if_there_is_one(before: OperatingState | None) -> None:
    entry = SafetyEvent(SafetyEventName.STOP, 0, OperatingState.FAULT, before=before).entry()
    assert entry.get("before") == before
    assert ("before" in entry) == (before is not None)
