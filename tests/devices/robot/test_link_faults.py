"""Faults 32 and 36 of the device layer on the robot's link: loss, delay, duplicates, old sessions, other versions.

The clock is virtual, that of the robot is 77 s ahead, and datagrams take no time unless a test says so. What needs
real processes is in test_processes.
"""

import struct
import zlib
from collections import deque
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.devices.robot import Fault, RobotMachine, RobotStage, RobotState, RobotTiming, SteadyDrive
from needleplan.devices.robot.messages import Answer, Head, Hello, Result, RobotCommand, RobotKind, decode, encode
from needleplan.errors import DeviceFault
from tests.devices.robot.bench import Bench, at_rest, fault_of, moving, next_of, raw, result_of, stands_still
from tests.devices.robot.network import RobotNetwork

MS = 1e-3


@pytest.mark.parametrize("silence_s", [0.01, 0.03, 0.1])
def test_32_the_robot_stops_itself_when_the_control_side_falls_silent(bench: Bench, silence_s: float) -> None:
    stage = bench.stage(RobotTiming(silence_s=silence_s))
    stage.insert(100.0, 10.0)
    for _ in range(30):
        next_of(stage)
    bench.wait(0.5)
    depth_mm, still_moving = bench.truth
    assert not still_moving
    # From the last heartbeat; and one tick.
    assert 0.3 <= depth_mm <= 0.301 + 10 * (silence_s + MS)
    fault_of(stage, "nothing was received from the controller while the robot moved")


def test_32_a_robot_at_rest_bears_silence_until_it_takes_another_controller(bench: Bench, stage: RobotStage) -> None:
    bench.wait(4.0)
    stage.insert(1.0, 10.0)
    bench.clock.advance(-1)
    while next_of(stage).moving:
        pass
    bench.wait(5.1)
    assert bench.machine.controller is None
    assert bench.machine.state is RobotState.DISABLED
    with pytest.raises(DeviceFault, match="the robot has ended this session"):
        stage.insert(2.0, 10.0)
    bench.stage(name="other")


def test_32_a_thread_that_reads_does_not_hide_a_loop_that_has_died(stage: RobotStage) -> None:
    stage.insert(100.0, 10.0)
    for _ in range(100):
        assert next_of(stage).moving
    with pytest.raises(DeviceFault, match="nothing was received"):
        deque((stage.read(0.02) for _ in range(1000)), maxlen=0)
    fault_of(stage, "nothing was received")


def test_32_no_reply_at_start(bench: Bench) -> None:
    bench.network.to_robot.cut = True
    began_ns = bench.clock.now_ns()
    with pytest.raises(DeviceFault, match=r"hello: no answer within 0\.9 s"):
        bench.stage()
    assert bench.clock.now_ns() - began_ns <= 1.0e9


def test_32_a_cut_link_stops_the_robot_and_is_told_here(bench: Bench) -> None:
    stage = moving(bench)
    bench.network.to_robot.cut = bench.network.from_robot.cut = True
    began_ns = bench.clock.now_ns()
    fault_of(stage, r"silent for 0\.1 s")
    assert bench.clock.now_ns() - began_ns <= 0.11e9
    assert bench.machine.faults is Fault.WATCHDOG
    depth_mm, still_moving = bench.truth
    assert not still_moving
    assert depth_mm <= 0.5 + 10 * 0.032
    bench.network.to_robot.cut = bench.network.from_robot.cut = False
    stands_still(bench)


@pytest.mark.parametrize("lost", range(6))
@pytest.mark.parametrize("direction", ["to_robot", "from_robot"])
def test_32_a_lost_datagram_does_not_lose_a_stop(bench: Bench, lost: int, direction: str) -> None:
    stage = moving(bench)
    getattr(bench.network, direction).lose = lost
    began_ns = bench.clock.now_ns()
    stage.stop()
    assert not bench.truth[1]
    # At once, and again every 5 ms; where only the way back is bad, the robot had it from the first.
    assert bench.clock.now_ns() - began_ns <= lost * 5e6 + 2e6
    at_rest(stage)


def test_32_a_stop_gets_through_where_most_is_lost(bench: Bench) -> None:
    stage = moving(bench)
    bench.network.to_robot.lose = 150
    fault_of(stage, "nothing was received")
    stage.stop()
    assert not bench.truth[1]


@pytest.mark.parametrize("lost", [1, 3])
def test_32_a_motion_of_which_the_answer_is_lost_begins_once(bench: Bench, stage: RobotStage, lost: int) -> None:
    bench.network.from_robot.lose = lost
    inserted = []
    begin = bench.drive.insert
    bench.drive.insert = lambda depth, speed: (inserted.append(depth), begin(depth, speed))[1]  # type: ignore[method-assign]
    stage.insert(10.0, 10.0)
    for _ in range(20):
        next_of(stage)
    assert inserted == [10.0]


def test_32_a_motion_that_nobody_answers_is_stopped(bench: Bench, stage: RobotStage) -> None:
    bench.network.from_robot.lose = 60
    with pytest.raises(DeviceFault, match=r"insert: no answer within 0\.03 s"):
        stage.insert(10.0, 10.0)
    assert bench.machine.state is RobotState.ENABLED
    stands_still(bench, 0.02)


def test_32_duplicates_change_nothing(bench: Bench) -> None:
    bench.network.to_robot.double = bench.network.from_robot.double = 10_000
    stage = bench.stage()
    stage.insert(5.0, 10.0)
    samples = [next_of(stage) for _ in range(100)]
    numbers = [each.stamp.sequence for each in samples]
    assert numbers == list(range(numbers[0], numbers[0] + 100))
    assert stage.counts.repeated >= 99
    stage.stop()
    first_stop = next(each for each in bench.network.to_robot.seen if decode(each).kind is RobotKind.STOP)  # type: ignore[union-attr]
    stage.insert(6.0, 10.0)
    bench.machine.receive(first_stop, ("controller", 1), bench.clock.now_ns() + bench.network.ahead_ns)
    assert bench.truth[1]


def test_32_lost_statuses_are_counted_with_the_sample_after_them(bench: Bench, stage: RobotStage) -> None:
    next_of(stage)
    bench.network.from_robot.lose = 7
    assert [next_of(stage).stamp.lost for _ in range(3)] == [7, 0, 0]
    assert stage.counts.lost == 7


def test_32_who_does_not_read_is_told_how_much_was_lost(bench: Bench, stage: RobotStage) -> None:
    last = next_of(stage).stamp.sequence
    bench.wait(3.0)
    stage.stop()
    first = next_of(stage).stamp
    assert first.lost == first.sequence - last - 1 > 900


@pytest.mark.parametrize("delay_s", [0.035, 0.2])
def test_32_a_command_that_comes_after_its_deadline_is_not_executed(
    bench: Bench, stage: RobotStage, delay_s: float
) -> None:
    next_of(stage)
    bench.network.to_robot.delay_s = delay_s
    with pytest.raises(DeviceFault, match=r"after its deadline|no answer"):
        stage.insert(10.0, 10.0)
    bench.network.to_robot.delay_s = 0.0
    bench.wait(0.5)
    assert bench.truth == (0.0, False)
    assert bench.machine.counts.late > 0


def test_32_late_proofs_of_life_do_not_count(bench: Bench) -> None:
    stage = moving(bench)
    bench.network.to_robot.delay_s = 0.05
    fault_of(stage, "nothing was received")
    assert bench.truth[0] <= 0.5 + 10 * 0.032


def test_32_a_delay_below_the_deadline_is_borne(bench: Bench) -> None:
    bench.network.to_robot.delay_s = bench.network.from_robot.delay_s = 0.006
    stage = bench.stage()
    stage.insert(5.0, 10.0)
    for _ in range(450):
        assert next_of(stage).stamp.lost == 0
    assert stage.robot_clock.round_trip_s == pytest.approx(0.012, abs=1e-3)


def test_32_a_motion_behind_a_stop_is_not_begun(bench: Bench, stage: RobotStage) -> None:
    stage.stop()
    answer = raw(bench, RobotKind.INSERT, number=2)
    assert result_of(answer) is Result.SUPERSEDED
    stands_still(bench, 0.02)


def test_32_an_old_session_is_refused(bench: Bench) -> None:
    with bench.stage(session=7):
        pass
    with pytest.raises(DeviceFault, match="hello: the robot has ended this session"):
        bench.stage(session=7)
    stage = bench.stage(session=8)
    stage.insert(5.0, 1.0)
    for kind in (
        RobotKind.INSERT,
        RobotKind.STOP,
        RobotKind.GOODBYE,
        RobotKind.ALIVE,
        RobotKind.RESET,
    ):
        assert result_of(raw(bench, kind, session=7)) is Result.OLD_SESSION
    assert bench.truth[1]
    assert next_of(stage).moving


def test_32_anybody_may_stop(bench: Bench) -> None:
    moving(bench)
    assert result_of(raw(bench, RobotKind.STOP, session=0)) is Result.ACCEPTED
    assert not bench.truth[1]


def test_32_another_version_is_refused_and_named(bench: Bench) -> None:
    newer = bytearray(encode(Hello(Head(1, 1, 1))))
    newer[4] = 4
    newer[-4:] = struct.pack("<I", zlib.crc32(bytes(newer[:-4])))
    answer = decode(bench.machine.receive(bytes(newer), ("new", 1), 1))
    assert isinstance(answer, Answer)
    assert (answer.result, answer.asked) == (Result.WRONG_VERSION, RobotKind.HELLO)
    assert bench.machine.controller is None
    # To an answer of another version there is none.
    newer[5] = RobotKind.ANSWER
    newer[-4:] = struct.pack("<I", zlib.crc32(bytes(newer[:-4])))
    assert bench.machine.receive(bytes(newer), ("new", 1), 1) == b""

    bench.machine.receive = lambda *_: bytes(newer)  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match="speaks version 4 of the protocol, this side 3"):
        bench.stage()


def test_36_two_controllers_at_once(bench: Bench) -> None:
    first = moving(bench)
    with pytest.raises(DeviceFault, match="hello: the robot has another controller"):
        bench.stage(RobotTiming(answer_s=0.01), name="second")
    session = bench.machine._session
    assert session is not None
    stolen = RobotCommand(Head(session.id, session.sequence + 1, 1, number=session.number + 1), RobotKind.STOP)
    answer = decode(bench.machine.receive(encode(stolen), ("thief", 1), 0))
    assert isinstance(answer, Answer)
    assert answer.result is Result.BUSY
    assert next_of(first).moving


def test_a_restarted_robot_no_longer_knows_us(bench: Bench) -> None:
    stage = moving(bench)
    bench.network.machine = RobotMachine(SteadyDrive())
    fault_of(stage, "the robot has ended this session")


ACTS: dict[str, Callable[[RobotNetwork], None]] = {
    "lose": lambda net: setattr(net.to_robot, "lose", 3),
    "lose back": lambda net: setattr(net.from_robot, "lose", 3),
    "double": lambda net: setattr(net.to_robot, "double", 3),
    "slow": lambda net: setattr(net.to_robot, "delay_s", 0.04),
    "fast": lambda net: setattr(net.to_robot, "delay_s", 0.0),
    "slow back": lambda net: setattr(net.from_robot, "delay_s", 0.02),
    "fast back": lambda net: setattr(net.from_robot, "delay_s", 0.0),
}


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(["insert", "stop", "read", "alive", "idle", *ACTS]), max_size=30))
def test_whatever_happens_it_stands_still_a_moment_after_the_last_word(story: list[str]) -> None:
    """Loss, doubles, delays and reordering in any order; what is on its way then is too late to begin anything."""
    bench = Bench()
    stage = bench.stage()
    for act in story:
        try:
            if act == "insert":
                stage.insert(50.0, 10.0)
            elif act == "stop":
                stage.stop()
            elif act == "read":
                stage.read(0.01)
            elif act == "alive":
                stage.heartbeat()
            elif act == "idle":
                bench.wait(0.02)
            else:
                ACTS[act](bench.network)
        except DeviceFault:
            bench.network.to_robot.delay_s = bench.network.from_robot.delay_s = 0.0
    bench.wait(0.1)
    stands_still(bench, 0.2)


def test_a_stop_is_sent_before_anything_that_has_arrived_is_read(bench: Bench, stage: RobotStage) -> None:
    stage.insert(100.0, 5.0)
    bench.wait(0.02)
    sent, received = len(bench.network.to_robot.seen), []
    receive = stage._wire._link.receive
    stage._wire._link.receive = lambda timeout_s: (
        received.append(len(bench.network.to_robot.seen)) or receive(timeout_s)
    )  # type: ignore[method-assign]
    stage.stop()
    assert received[0] == sent + 1
