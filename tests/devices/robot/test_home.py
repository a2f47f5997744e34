"""The zero of a robot: who knows that it is lost, and for how long; and robots and controllers of the older version."""

from dataclasses import replace

import pytest

from needleplan.devices.robot import Fault, RobotMachine, RobotStage, RobotState, SteadyDrive
from needleplan.devices.robot.messages import (
    OLDEST_VERSION,
    Answer,
    Head,
    Hello,
    Result,
    RobotCommand,
    RobotKind,
    RobotStatus,
    decode,
    encode,
)
from needleplan.errors import DeviceFault
from tests.devices.robot.bench import Bench, fault_of, moving, next_of, stands_still


def homed(bench: Bench) -> bool | None:
    """Return what a later controller reads."""
    stage = bench.stage()
    next_of(stage)
    found = stage.homed
    stage.close()
    return found


def test_a_jump_of_the_encoder_loses_the_zero_until_it_is_found(bench: Bench) -> None:
    assert homed(bench)
    stage = moving(bench)
    bench.drive.faults.jump_mm = 3.0
    fault_of(stage, "an encoder has jumped")
    stage.close()
    assert homed(bench) is False
    stage = bench.stage()
    next_of(stage)
    stage.home()
    assert stage.homed
    assert next_of(stage).moving is False
    assert stage.homed
    stage.close()
    assert homed(bench)


def test_the_controller_may_say_that_the_zero_is_lost_also_in_a_fault(bench: Bench, stage: RobotStage) -> None:
    next_of(stage)
    stage.unhome()
    assert stage.homed is False
    next_of(stage)
    assert stage.homed is False
    bench.drive.faults.reported = Fault.DRIVE
    fault_of(stage, "a drive reports a fault")
    stage.unhome()
    with pytest.raises(DeviceFault, match="home: the robot is in a fault"):
        stage.home()
    stage.close()
    with pytest.raises(DeviceFault, match="closed"):
        stage.home()


def test_a_robot_without_its_zero_says_so_from_the_start(bench: Bench) -> None:
    bench.machine.homed = RobotMachine(SteadyDrive(), homed=False).homed
    stage = bench.stage()
    assert stage.homed is None  # before the first status
    next_of(stage)
    assert stage.homed is False


def test_standing_is_what_the_positions_say(bench: Bench) -> None:
    bench.wait(0.1)
    stage = moving(bench)
    assert stage.last_status is not None
    assert stage.last_status.standing is False
    stage.stop()
    stands_still(bench)
    for _ in range(60):
        next_of(stage)
    assert stage.last_status.standing


class OldMachine(RobotMachine):
    """A robot of version 2: it answers any other version with WRONG_VERSION, and knows one flag."""

    def receive(self, datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
        command = decode(datagram)
        assert isinstance(command, Hello | RobotCommand)
        if command.head.version != OLDEST_VERSION:
            head = Head(0, 1, now_ns, version=OLDEST_VERSION)
            return encode(Answer(head, command.kind, Result.WRONG_VERSION, RobotState.DISABLED))
        assert command.kind not in (RobotKind.HOME, RobotKind.UNHOME)
        return super().receive(datagram, sender, now_ns)


def test_an_old_robot_is_spoken_to_in_its_version(bench: Bench) -> None:
    bench.machine = bench.network.machine = OldMachine(bench.drive)
    stage: RobotStage = moving(bench)
    assert stage._conversation.version == OLDEST_VERSION
    assert (stage.homed, stage.last_status and stage.last_status.standing) == (None, None)
    stage.home()
    stage.unhome()
    stage.stop()
    stands_still(bench)


def test_an_old_controller_is_answered_in_its_version() -> None:
    machine = RobotMachine(SteadyDrive())
    hello = Hello(Head(7, 1, 1, number=1, version=OLDEST_VERSION))
    answer = decode(machine.receive(encode(hello), ("old", 1), 0))
    assert (answer.head.version, answer.head.session) == (OLDEST_VERSION, 7)
    sent = machine.tick(1_000_000)
    assert sent is not None
    status = decode(sent[0])
    assert isinstance(status, RobotStatus)
    assert (status.head.version, status.homed) == (OLDEST_VERSION, None)
    stop = RobotCommand(replace(hello.head, sequence=2, number=2), RobotKind.STOP)
    assert decode(machine.receive(encode(stop), ("old", 1), 0)).head.version == OLDEST_VERSION


def test_in_a_session_no_answer_changes_the_version(bench: Bench, stage: RobotStage) -> None:
    next_of(stage)
    false = Answer(Head(0, 1, 1, version=OLDEST_VERSION), RobotKind.HELLO, Result.WRONG_VERSION, RobotState.DISABLED)
    stage._wire.supervisor.take(encode(false), bench.clock.now_ns())
    stage.unhome()
    assert bench.machine.homed is False
