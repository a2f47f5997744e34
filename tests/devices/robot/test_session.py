"""What a session agrees at HELLO: limits of motion and a key; and what becomes of those who do not keep to it."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.devices.robot import MotionLimits, RobotLimits, RobotStage, RobotState, RobotTiming, read_key
from needleplan.devices.robot.messages import Answer, Head, Hello, Result, RobotCommand, RobotKind, decode, encode
from needleplan.errors import AddressError, DeviceFault
from tests.devices.robot.bench import Bench, fault_of, moving, next_of, raw, result_of, stands_still

NARROW = MotionLimits(-5.0, 30.0, 8.0, 4.0, 2.0, 100_000)
KEY, OTHER = bytes(range(32)), bytes(32)
SHORT = RobotTiming(answer_s=0.02)


@pytest.mark.parametrize(("kind", "target", "speed", "result"), [
    (RobotKind.INSERT, 30.0, 8.0, Result.ACCEPTED), (RobotKind.INSERT, 30.1, 1.0, Result.DEPTH_BEYOND),
    (RobotKind.INSERT, -5.1, 1.0, Result.DEPTH_BEYOND), (RobotKind.INSERT, 1.0, 8.1, Result.SPEED_BEYOND),
    (RobotKind.ROTATE, -4.0, 2.0, Result.ACCEPTED), (RobotKind.ROTATE, 4.1, 1.0, Result.ROLL_BEYOND),
    (RobotKind.ROTATE, 1.0, 2.1, Result.ROTATION_BEYOND), (RobotKind.INSERT, float("nan"), 1.0, Result.OUT_OF_RANGE),
    (RobotKind.INSERT, 1.0, -1.0, Result.OUT_OF_RANGE),
])  # fmt: skip
def test_a_motion_beyond_the_limits_of_the_session_is_refused_with_its_cause(
    bench: Bench, kind: RobotKind, target: float, speed: float, result: Result
) -> None:
    bench.stage(limits=NARROW)
    assert result_of(raw(bench, kind, target=target, speed=speed)) is result
    assert bench.truth[1] == (result is Result.ACCEPTED)


def test_a_deadline_far_in_the_future_is_refused(bench: Bench) -> None:
    bench.stage(limits=NARROW)
    now_ns = bench.clock.now_ns() + bench.network.ahead_ns
    motion = {"target": 1.0, "speed": 1.0}
    assert result_of(raw(bench, RobotKind.INSERT, deadline_ns=now_ns + 100_000_001, **motion)) is Result.DEADLINE_BEYOND
    assert result_of(raw(bench, RobotKind.INSERT, deadline_ns=now_ns + 100_000_000, **motion)) is Result.ACCEPTED


@pytest.mark.parametrize(("limits", "why"), [
    (MotionLimits(-300.0, 100.0), "depth is outside"), (MotionLimits(50.0, 50.0), "depth is outside"),
    (MotionLimits(speed_mm_s=51.0), "speed is above"), (MotionLimits(roll_rad=201.0), "roll is beyond"),
    (MotionLimits(rotation_rad_s=-1.0), "rotation speed"), (MotionLimits(valid_us=1_500_001), "deadline is farther"),
    (MotionLimits(most_mm=float("inf")), "does not accept"),
])  # fmt: skip
def test_a_session_cannot_widen_the_limits_of_the_robot(bench: Bench, limits: MotionLimits, why: str) -> None:
    with pytest.raises(DeviceFault, match=f"hello: .*{why}"):
        bench.stage(limits=limits)
    assert bench.machine.controller is None
    bench.stage()


@given(st.builds(MotionLimits, *[st.floats(-300, 300)] * 5, st.integers(0, 2_000_000)))
def test_the_limits_of_a_session_lie_within_those_of_the_robot(asked: MotionLimits) -> None:
    own = RobotLimits().motion
    got = asked.within(own)
    if isinstance(got, MotionLimits):
        assert own.least_mm <= got.least_mm < got.most_mm <= own.most_mm
        assert 0 < got.speed_mm_s <= own.speed_mm_s
        assert 0 < got.roll_rad <= own.roll_rad
        assert 0 < got.rotation_rad_s <= own.rotation_rad_s
        assert 0 < got.valid_us <= own.valid_us


def test_limits_are_fixed_for_the_session(bench: Bench) -> None:
    bench.stage(limits=NARROW)
    session = bench.machine._session
    assert session is not None
    again = Hello(Head(session.id, session.sequence + 1, 1), MotionLimits(-200.0, 200.0))
    answer = decode(bench.machine.receive(encode(again), session.peer, bench.clock.now_ns()))
    assert isinstance(answer, Answer)
    assert session.limits == NARROW


def stranger_stops(bench: Bench) -> None:
    stop = encode(RobotCommand(Head(0, 1, 1, number=1), RobotKind.STOP))
    bench.machine.receive(stop, ("stranger", 9), bench.clock.now_ns() + bench.network.ahead_ns)


@pytest.mark.parametrize("before", [moving, Bench.stage])
def test_a_stop_by_a_stranger_is_a_fault_at_rest_and_moving(bench: Bench, before: Callable[[Bench], object]) -> None:
    stage = before(bench)
    stranger_stops(bench)
    assert not bench.truth[1]
    fault_of(stage, "another sender ordered a stop")  # type: ignore[arg-type]
    stands_still(bench)
    assert bench.machine.counts.foreign_stops == 1
    stage.start()  # type: ignore[attr-defined]
    stands_still(bench, 0.1)
    stage.insert(1.0, 5.0)  # type: ignore[attr-defined]
    stranger_stops(bench)
    assert result_of(raw(bench, RobotKind.INSERT)) is Result.IN_FAULT


def test_a_motion_that_arrives_behind_the_stop_of_a_stranger_is_not_obeyed(bench: Bench, stage: RobotStage) -> None:
    next_of(stage)
    bench.network.to_robot.delay_s = 0.01
    stranger_stops(bench)
    with pytest.raises(DeviceFault, match=r"another sender ordered a stop|in a fault"):
        stage.insert(50.0, 10.0)
    stands_still(bench, 0.2)


def test_a_stranger_may_stop_a_robot_without_a_session(bench: Bench) -> None:
    bench.wait(0.01)
    stranger_stops(bench)
    assert bench.machine.state is RobotState.DISABLED
    bench.stage()


def test_a_robot_that_rests_before_its_goal_is_a_fault(bench: Bench) -> None:
    """For example because a person has stopped it at its own panel, which no message tells."""
    stage = moving(bench)
    bench.drive.stop()
    fault_of(stage, "it has ended its motion at .* instead of 100 mm, although this program has ordered no stop")


def test_one_key_on_both_sides() -> None:
    bench = Bench(key=KEY)
    stage = bench.stage(key=KEY)
    stage.insert(1.0, 10.0)
    while next_of(stage).moving:
        pass
    assert bench.truth[0] == pytest.approx(1.0)
    assert bench.machine.counts.not_authentic == 0


@pytest.mark.parametrize("key", [None, OTHER])
def test_a_controller_without_the_key_is_told_so(key: bytes | None) -> None:
    bench = Bench(key=KEY)
    with pytest.raises(DeviceFault, match=r"requires another key|authenticated with the key"):
        bench.stage(SHORT, key=key)
    assert bench.machine.controller is None
    assert bench.machine.counts.not_authentic > 0


def test_a_robot_without_the_key_is_not_trusted() -> None:
    with pytest.raises(DeviceFault, match=r"no answer within 0\.02 s that is authenticated with the key"):
        Bench().stage(SHORT, key=KEY)


def test_a_recorded_session_cannot_be_played_again() -> None:
    bench = Bench(key=KEY)
    stage = bench.stage(key=KEY)
    stage.insert(5.0, 10.0)
    recorded = list(bench.network.to_robot.seen)
    stage.close()
    again = Bench(key=KEY)  # a robot that was switched off and on has forgotten the session, and its clock begins anew
    results = []
    for datagram in recorded:
        answer = decode(again.machine.receive(datagram, ("controller", 1), 0))
        assert isinstance(answer, Answer)
        results.append(answer.result)
    assert set(results[1:]) == {Result.NOT_AUTHENTIC}
    assert again.machine.state is RobotState.DISABLED


def test_anyone_may_stop_a_robot_with_a_key() -> None:
    bench = Bench(key=KEY)
    stage = bench.stage(key=KEY)
    stage.insert(50.0, 10.0)
    stranger_stops(bench)
    assert not bench.truth[1]
    fault_of(stage, "another sender ordered a stop")


def test_a_key_is_read_from_a_file_of_hexadecimal_digits(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text(KEY.hex() + "\n")
    assert read_key(str(file)) == KEY
    for text, why in (("secret", "hexadecimal digits"), ("00" * 15, "at least 16 bytes")):
        file.write_text(text)
        with pytest.raises(AddressError, match=why):
            read_key(str(file))
    with pytest.raises(AddressError, match="No such file"):
        read_key(str(tmp_path / "nowhere"))
