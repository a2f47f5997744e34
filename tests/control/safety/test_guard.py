"""The guard: what reaches the stage, and what does not."""

import math
import threading
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.control.safety import Cause, GuardedStage, OperatingState, Order, SafetyEventName, SafetyLimits
from needleplan.devices import ForceSample, Health, PoseSample, Source, Stamp
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.stopping import Rest
from tests.control.safety.bench import NAN, Bench

D, E, P, F = OperatingState.DISABLED, OperatingState.ENABLED, OperatingState.PAUSED, OperatingState.FAULT


def refused(call: Any, *arguments: Any) -> set[str]:
    with pytest.raises(MotionRefused) as refusal:
        call(*arguments)
    return set(refusal.value.causes)


def test_nothing_moves_before_it_is_enabled(bench: Bench) -> None:
    bench.turn()
    assert refused(bench.guard.insert, 10.0, 5.0) == {Cause.NOT_ENABLED}
    assert refused(bench.guard.rotate, 1.0, 5.0) == {Cause.NOT_ENABLED}
    assert bench.stage.wire == []
    assert len(bench.named(SafetyEventName.REFUSAL)) == 2


def test_it_is_not_enabled_without_inputs(bench: Bench) -> None:
    bench.guard.order(Order.HOME)
    wanting = {Cause.FORCE_STALE, Cause.POSE_STALE, Cause.STAGE_STALE, Cause.LOOP_LATE}
    assert refused(bench.guard.order, Order.ENABLE) == wanting


def test_a_command_goes_to_the_stage_as_it_is_and_into_the_record(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(10.0, 5.0)
    guard.rotate(-3.0, 6.0)
    assert bench.stage.wire == [("insert", 10.0, 5.0), ("rotate", -3.0, 6.0)]
    insert, rotate = bench.named(SafetyEventName.COMMAND)
    assert insert.entry()["depth_mm"] == 10.0
    assert rotate.entry()["state"] == "ENABLED"


@pytest.mark.parametrize(
    ("call", "values", "cause"),
    [
        ("insert", (151.0, 5.0), Cause.DEPTH_BEYOND),
        ("insert", (-101.0, 5.0), Cause.DEPTH_BEYOND),
        ("insert", (10.0, 10.1), Cause.VELOCITY_BEYOND),
        ("insert", (10.0, 0.0), Cause.VELOCITY_BEYOND),
        ("insert", (-10.0, 20.1), Cause.VELOCITY_BEYOND),
        ("insert", (NAN, 5.0), Cause.NOT_FINITE),
        ("insert", (10.0, math.inf), Cause.NOT_FINITE),
        ("rotate", (201.0, 5.0), Cause.ROLL_BEYOND),
        ("rotate", (1.0, 12.1), Cause.ROTATION_BEYOND),
        ("rotate", (1.0, -1.0), Cause.ROTATION_BEYOND),
        ("rotate", (NAN, 1.0), Cause.NOT_FINITE),
    ],
)
def test_a_value_beyond_a_limit_is_refused_with_its_cause_and_nothing_else_happens(
    bench: Bench, guard: GuardedStage, call: str, values: tuple[float, float], cause: Cause
) -> None:
    assert refused(getattr(guard, call), *values) == {cause}
    assert bench.stage.wire == []
    assert guard.state.operating is E
    assert bench.events[-1].name is SafetyEventName.REFUSAL
    assert bench.events[-1].causes == {cause}


@given(depth_mm=st.floats(), velocity_mm_s=st.floats(), here_mm=st.floats(-100, 150))
def test_no_value_beyond_a_limit_reaches_the_wire(depth_mm: float, velocity_mm_s: float, here_mm: float) -> None:
    bench = Bench()
    bench.stage.depth_mm = here_mm
    guard = bench.enabled()
    fastest = 20.0 if depth_mm <= here_mm else 10.0
    good = -100 <= depth_mm <= 150 and 0 < velocity_mm_s <= fastest
    if good:
        guard.insert(depth_mm, velocity_mm_s)
    else:
        refused(guard.insert, depth_mm, velocity_mm_s)
    assert bench.stage.wire == ([("insert", depth_mm, velocity_mm_s)] if good else [])


BROKEN: dict[str, tuple[dict[str, Any], OperatingState, Cause]] = {
    "the force is silent": ({"without": {"force"}}, F, Cause.FORCE_STALE),
    "the force is suspect": ({"force": {"health": Health.SUSPECT}}, F, Cause.FORCE_SUSPECT),
    "the force is no number": ({"force": {"force_n": (NAN, 0, 0)}}, F, Cause.FORCE_SUSPECT),
    "the force is too large": ({"force": {"force_n": (6.0, 6.0, -6.0)}}, F, Cause.FORCE_EXCEEDED),
    "a suspect force is too large": (
        {"force": {"force_n": (0, 0, -11.0), "health": Health.SUSPECT}}, F, Cause.FORCE_EXCEEDED),
    "the tracker is silent": ({"without": {"pose"}}, P, Cause.POSE_STALE),
    "the pose is suspect": ({"pose": {"health": Health.SUSPECT}}, P, Cause.POSE_SUSPECT),
    "the coil is not seen": ({"pose": {"health": Health.MISSING}}, P, Cause.POSE_UNSEEN),
    "the pose is no number": ({"pose": {"position_mm": (NAN, 0, 0)}}, P, Cause.POSE_SUSPECT),
    "the coil jumps": ({"pose": {"position_mm": (7.0, 2.0, 3.0)}}, F, Cause.POSE_JUMPED),
    "the tip is not told": ({"tip": {}}, P, Cause.TIP_UNKNOWN),
    "the tip is no number": ({"tip": {"tip_mm": (1.0, NAN), "out_of_plane_mm": 0.0}}, P, Cause.TIP_UNKNOWN),
    "the tip leaves the plane": ({"tip": {"tip_mm": (1, 1), "out_of_plane_mm": -5.1}}, F, Cause.OUT_OF_PLANE),
    "the tip leaves the workspace": ({"tip": {"tip_mm": (61, 1), "out_of_plane_mm": 0}}, F, Cause.OUT_OF_WORKSPACE),
    "the stage is silent": ({"without": {"stage"}}, F, Cause.STAGE_STALE),
    "the loop hangs": ({"without": {"loop"}}, F, Cause.LOOP_LATE),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_an_input_that_fails_stops_the_stage(name: str) -> None:
    change, operating, cause = BROKEN[name]
    bench = Bench(workspace_x_mm=(0.0, 60.0), force_rate_n_s=1000.0)
    guard = bench.enabled()
    guard.insert(50.0, 5.0)
    bench.turns(0.02)
    began_ns = bench.clock.now_ns()
    for key, value in change.items():
        setattr(bench, key, value)
    while bench.stage.wire[-1] != ("stop",):
        bench.turn()
        assert bench.clock.now_ns() - began_ns < 0.12e9
    assert guard.state.operating is operating
    assert bench.causes == {cause}
    stop = bench.named(SafetyEventName.STOP)[-1]
    assert stop.causes == {cause}
    assert stop.sent_ns == bench.stage.times_ns[-1]
    assert Cause.NOT_ENABLED in refused(guard.insert, 50.0, 5.0)
    # Healthy again: it does not go on by itself.
    bench.without, bench.force, bench.pose = set(), {}, {}
    bench.tip = {"tip_mm": (10.0, 5.0), "out_of_plane_mm": 0.1}
    bench.turns(0.05)
    assert guard.state.operating is (D if operating is F else P)
    assert Cause.NOT_ENABLED in refused(guard.insert, 50.0, 5.0)
    if operating is F:
        assert refused(guard.order, Order.ENABLE) == {Cause.NOT_RESET, cause}
        guard.order(Order.RESET, "anna")
    guard.order(Order.ENABLE if operating is F else Order.RESUME, "anna")
    bench.rest()
    guard.insert(50.0, 5.0)
    assert bench.stage.wire[-1] == ("insert", 50.0, 5.0)


@pytest.mark.parametrize(("key", "health"), [("force", Health.SUSPECT), ("pose", Health.MISSING)])
def test_one_bad_sample_is_not_used_and_stops_nothing(
    bench: Bench, guard: GuardedStage, key: str, health: Health
) -> None:
    for _ in range(20):
        setattr(bench, key, {"health": health})
        bench.turn()
        setattr(bench, key, {})
        bench.turn()
    assert guard.state.operating is E


def test_a_repeated_sample_with_a_new_date_is_not_fresh(bench: Bench, guard: GuardedStage) -> None:
    number = bench.number
    for _ in range(9):
        bench.number = number - 1
        bench.turn()
    assert guard.state.operating is F
    assert Cause.FORCE_STALE in bench.causes


def test_a_sample_from_the_future_is_a_fault(bench: Bench, guard: GuardedStage) -> None:
    bench.clock.advance(10.0)
    bench.turn()
    bench.clock._now_ns -= 10**9
    guard.check()
    assert Cause.CLOCK_MISMATCH in guard.state.present


def test_the_time_of_a_run_ends() -> None:
    bench = Bench(run_s=1.0)
    guard = bench.enabled()
    bench.turns(0.995)
    assert guard.state.operating is E
    bench.turns(0.02)
    assert bench.causes == {Cause.TIME_EXCEEDED}
    assert guard.state.operating is D


WATCHED = [Source.FORCE, Source.POSE, Source.STAGE]


@pytest.mark.parametrize("source", [each for each in Source if each not in WATCHED])
def test_a_sensor_that_only_improves_the_tip_passes_the_guard_unwatched(source: Source) -> None:
    class Broken:
        def read(self, timeout_s: float) -> None:
            raise DeviceFault(f"no sample within {timeout_s} s")

        def close(self) -> None: ...

    bench = Bench()
    guard = bench.enabled()
    with pytest.raises(DeviceFault, match="no sample within 1"):
        guard.read_device(source, Broken(), 1.0)
    assert not bench.causes


@pytest.mark.parametrize("source", WATCHED)
def test_a_device_that_gives_up_is_a_fault_until_its_next_sample(
    bench: Bench, guard: GuardedStage, source: Source
) -> None:
    guard.insert(20.0, 5.0)
    cause = Cause(f"{source}_fault")
    assert guard.device_failed(source, DeviceFault("its cable is out")).operating is F
    assert bench.stage.wire[-1] == ("stop",)
    assert bench.causes == {cause}
    assert any("its cable is out" in each.text for each in bench.named(SafetyEventName.TRANSITION))
    bench.turn()
    assert guard.state.operating is D


def test_a_stage_that_takes_no_command_is_a_fault(bench: Bench, guard: GuardedStage) -> None:
    bench.stage.broken = True
    with pytest.raises(DeviceFault, match="not there"):
        guard.insert(10.0, 5.0)
    assert guard.state.operating is F
    assert bench.causes == {Cause.STAGE_FAULT}
    bench.stage.broken = False
    bench.turns(0.2)
    assert bench.stage.wire == []
    bench.turns(0.1)
    assert bench.stage.wire == [("stop",)], "the stop is sent again, and the stage stands still"


def test_a_stop_is_repeated_until_the_stage_stands_still(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(50.0, 5.0)
    bench.turn()
    guard.order(Order.PAUSE)
    for _ in range(20):
        bench.stage.depth_mm += 0.022
        bench.turn()
    count = bench.stage.wire.count(("stop",))
    assert count == 6
    bench.stage.moving = True  # what it says of itself proves nothing
    bench.turns(0.1)
    assert bench.stage.wire.count(("stop",)) == count
    assert guard.rest is Rest.RESTS


def test_stop_latches(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(50.0, 5.0)
    guard.stop()
    assert bench.stage.wire[-1] == ("stop",)
    assert guard.state.operating is D
    assert refused(guard.order, Order.ENABLE) == {Cause.NOT_RESET, Cause.STOP_ORDERED}


def test_the_guard_sends_the_heartbeat_while_the_loop_ticks(bench: Bench) -> None:
    heard = []
    bench.guard.close()
    bench.stage.broken = False
    bench.stage.heartbeat = lambda: heard.append(bench.clock.now_ns())  # type: ignore[method-assign]
    bench.guard = GuardedStage(bench.stage, clock=bench.clock)
    bench.turns(0.1)
    assert len(heard) == 20
    for _ in range(100):
        bench.turn(0.001)
    assert len(heard) == 40
    bench.without = {"loop"}
    bench.turns(0.1)
    assert len(heard) == 40

    def fail() -> None:
        raise DeviceFault("no way to it")

    bench.without = set()
    guard = bench.enabled()
    bench.stage.heartbeat = fail  # type: ignore[method-assign]
    bench.turn()
    assert Cause.STAGE_FAULT in guard.state.latched


def test_two_threads_do_not_command(guard: GuardedStage) -> None:
    guard.insert(10.0, 5.0)
    found: list[set[str]] = []
    thread = threading.Thread(target=lambda: found.append(refused(guard.insert, 20.0, 5.0)))
    thread.start()
    thread.join()
    assert found == [{Cause.SECOND_COMMANDER}]
    assert guard.state.operating is E


def test_a_stage_has_one_guard(bench: Bench) -> None:
    for stage in (bench.stage, bench.guard):
        assert refused(GuardedStage, stage) == {Cause.SECOND_COMMANDER}
    bench.guard.close()
    GuardedStage(bench.stage).close()


def test_limits_are_exchanged_only_while_nothing_is_enabled(bench: Bench) -> None:
    other = SafetyLimits(deepest_mm=20.0)
    guard = bench.enabled()
    assert refused(guard.exchange_limits, other) == {Cause.LIMITS_IN_USE}
    guard.order(Order.DISABLE)
    guard.exchange_limits(other)
    guard.order(Order.ENABLE)
    bench.rest()
    assert refused(guard.insert, 21.0, 5.0) == {Cause.DEPTH_BEYOND}


def test_a_listener_that_fails_does_not_keep_the_stop_back(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(50.0, 5.0)

    def fail(_: object) -> None:
        raise OSError("no space left")

    guard._wire.events._listener = fail
    bench.without = {"force"}
    bench.turns(0.05)
    assert bench.stage.wire[-1] == ("stop",)
    assert Cause.RECORDING_LOST in guard.state.latched


def test_closing_stops_and_closes_the_stage(bench: Bench, guard: GuardedStage) -> None:
    with guard:
        guard.insert(50.0, 5.0)
    assert bench.stage.wire[-1] == ("stop",)
    assert bench.stage.broken


class OneSample:
    """A device that returns one sample, or fails."""

    def __init__(self, sample: ForceSample | PoseSample | Exception) -> None:
        self.sample = sample

    def read(self, _: float) -> ForceSample | PoseSample:
        if isinstance(self.sample, Exception):
            raise self.sample
        return self.sample


def test_a_sample_is_validated_as_it_is_read_before_the_loop_takes_it(bench: Bench, guard: GuardedStage) -> None:
    guard.insert(50.0, 5.0)
    force = ForceSample(Stamp(bench.clock.now_ns(), 10_000), (0.0, 0.0, 60.0), (0.0, 0.0, 0.0))
    assert guard.read_device(Source.FORCE, OneSample(force), 0.0) is force  # type: ignore[arg-type]
    assert bench.stage.wire[-1] == ("stop",)
    assert Cause.FORCE_EXCEEDED in guard.state.latched


def test_a_pose_that_is_read_keeps_the_tip_until_the_loop_has_another(bench: Bench, guard: GuardedStage) -> None:
    pose = PoseSample(Stamp(bench.clock.now_ns(), 10_000), (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), 0.1)
    guard.read_device(Source.POSE, OneSample(pose), 0.0)  # type: ignore[arg-type]
    assert guard.state.operating is E
    guard.observe_tip((10.0, 5.0), 0.2)
    assert guard.state.operating is E
    assert guard.observe_tip(None, 0.2).present == {Cause.TIP_UNKNOWN}


@pytest.mark.parametrize("error", [DeviceFault("cable"), OSError("cable")], ids=["fault", "other error"])
def test_a_device_that_fails_as_it_is_read_is_a_fault(guard: GuardedStage, error: Exception) -> None:
    with pytest.raises(type(error), match="cable"):
        guard.read_device(Source.FORCE, OneSample(error), 0.0)  # type: ignore[arg-type]
    assert Cause.FORCE_FAULT in guard.state.latched
