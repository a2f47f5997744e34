"""The contract of a stage in this process, over a real socket, and on hardware where there is some that may move."""

import os
import socket
import threading
from collections.abc import Iterator

import pytest

from needleplan.devices import Stage
from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer, RobotStage, RobotTiming, SteadyDrive
from needleplan.devices.robot.messages import Fault, Head, RobotState, RobotStatus, encode
from needleplan.errors import AddressError, DeviceFault, LinkClosed
from tests.devices.contract import StageContract, heard_and_read
from tests.devices.robot.bench import Bench, next_of

HARDWARE = "NEEDLEPLAN_TEST_ROBOT"
PATIENT = RobotTiming(silence_s=20.0, valid_s=20.0, answer_s=20.0, lost_s=20.0)
"""For a machine with other things to do than to run a simulated robot at 1 kHz."""


@pytest.fixture
def server() -> Iterator[RobotServer]:
    with RobotServer(
        RobotMachine(SteadyDrive(), RobotLimits(longest_silence_s=20.0, release_s=60.0, longest_valid_s=30.0))
    ) as running:
        yield running


class TestInThisProcess(StageContract):
    @pytest.fixture
    def sensor(self) -> Stage:
        return Bench().stage()


class TestOnSockets(StageContract):
    @pytest.fixture
    def sensor(self, server: RobotServer) -> Iterator[Stage]:
        with RobotStage.open(server.address, timing=PATIENT) as opened:
            yield opened


@pytest.mark.skipif(HARDWARE not in os.environ, reason=f"set {HARDWARE} to the address of a robot that may move 40 mm")
class TestOnHardware(StageContract):
    @pytest.fixture
    def sensor(self) -> Iterator[Stage]:
        with RobotStage.open(os.environ[HARDWARE]) as opened:
            yield opened


def test_two_threads_may_read_and_command(server: RobotServer) -> None:
    with RobotStage.open(server.address, timing=PATIENT) as stage:
        samples = []
        enough = threading.Event()

        def read() -> None:
            while not enough.is_set():
                sample = heard_and_read(stage, 0.5)
                if sample is not None:
                    samples.append(sample)

        reader = threading.Thread(target=read)
        reader.start()
        for number in range(40):
            stage.insert(10.0 + number % 2, 5.0)
        stage.stop()
        enough.set()
        reader.join()
    numbers = [each.stamp.sequence for each in samples]
    assert numbers == sorted(set(numbers))
    assert server.machine.state is RobotState.DISABLED
    assert server.machine.controller is None


def test_the_round_trip_is_measured_without_comparing_clocks(server: RobotServer) -> None:
    with RobotStage.open(server.address, timing=PATIENT) as stage:
        next_of(stage)
        assert stage.robot_clock.round_trip_s is not None
        assert 0 < stage.robot_clock.round_trip_s <= stage.robot_clock.worst_round_trip_s < 20


def test_a_status_of_somebody_else_is_not_a_sample(server: RobotServer) -> None:
    with (
        RobotStage.open(server.address, timing=PATIENT) as stage,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        head = Head(stage._conversation.session, 9_999_999, 1, number=3)
        false = RobotStatus(head, 99.0, 0.0, 0.0, 0.0, Fault(0), RobotState.ENABLED, False)
        stranger.sendto(encode(false), ("127.0.0.1", stage._wire.local_port))
        samples = [next_of(stage) for _ in range(20)]
        while not stage.unknown_senders:
            samples.append(next_of(stage))
        assert max(each.depth_mm for each in samples) == 0


def test_a_second_controller_is_refused_until_the_first_is_gone(server: RobotServer) -> None:
    with RobotStage.open(server.address, timing=PATIENT) as first:
        with pytest.raises(DeviceFault, match="hello: the robot has another controller"):
            RobotStage.open(server.address, timing=PATIENT)
        first.insert(5.0, 10.0)
        assert next_of(first).moving
    with RobotStage.open(server.address, timing=PATIENT) as second:
        assert not next_of(second).moving


def test_wrong_addresses_are_refused_before_anything_is_sent(server: RobotServer) -> None:
    for address, message in {
        "tcp://127.0.0.1:1": "udp://host",
        "udp://127.0.0.1?watchdog=1": "did you mean",
        "udp://127.0.0.1?watchdog_s=0": "at least 0.001 and at most 60",
        "udp://127.0.0.1?valid_s=nan": "at least 0.001 and at most 60",
    }.items():
        with pytest.raises(AddressError, match=message):
            RobotStage.open(address)
    assert server.machine.controller is None


def test_nobody_at_the_address_is_a_fault() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        with pytest.raises(DeviceFault, match=r"hello: no answer within 0\.05 s"):
            RobotStage.open(f"udp://127.0.0.1:{silent.getsockname()[1]}", timing=RobotTiming(answer_s=0.05))


def test_a_closed_robot_takes_no_command() -> None:
    stage = Bench().stage()
    stage.close()
    for command in (lambda: stage.insert(1.0, 1.0), lambda: stage.rotate(1.0, 1.0), stage.stop, stage.heartbeat):
        with pytest.raises(LinkClosed):
            command()
