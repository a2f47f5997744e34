"""The threads that own the socket of a robot, in real time, while Python holds its interpreter or posts nothing."""

import contextlib
import ctypes
import socket
import struct
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import pytest

from needleplan.control.safety import Cause, GuardedStage, OperatingState, Order, SafetyLimits
from needleplan.devices import ForceSample, PoseSample, Stamp
from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer, RobotStage, RobotTiming, SteadyDrive
from needleplan.devices.robot.messages import RobotCommand, RobotKind, decode
from needleplan.errors import LinkClosed, MotionRefused

PATIENT = RobotTiming(silence_s=20.0, valid_s=20.0, answer_s=20.0, lost_s=20.0)
LIMITS = SafetyLimits(force_age_s=10.0, pose_age_s=10.0, stage_age_s=10.0, loop_age_s=10.0)
TIMESTAMPS = 35  # SO_TIMESTAMPNS, which `socket` does not name

linux = pytest.mark.skipif(not hasattr(socket, "SO_REUSEPORT"), reason="the kernel gives no times of arrival")


class Rig:
    """A guarded robot in this process; between `freeze` and the end, only the kernel takes what is sent to it."""

    def __init__(self, server: RobotServer, stage: RobotStage) -> None:
        self.server, self.stage = server, stage
        self.guard = GuardedStage(stage, LIMITS, accepted_limits="a busy machine")

    def turn(self) -> None:
        stamp = Stamp(time.monotonic_ns(), time.monotonic_ns())
        self.guard.observe(ForceSample(stamp, (0, 0, 1), (0, 0, 0)))
        self.guard.observe(PoseSample(stamp, (0, 0, 0), (1, 0, 0, 0), 0.1), tip_mm=(0, 0), out_of_plane_mm=0)
        self.guard.read(0.02)
        self.guard.tick()

    def begin(self) -> None:
        """Enable the guard and move."""
        self.turn()
        for order in (Order.HOME, Order.RESET, Order.ENABLE):
            self.guard.order(order, "anna")
        while self.guard.state.waits:
            self.turn()
        self.guard.insert(100.0, 5.0)

    def freeze(self, loop_age_s: float) -> None:
        """Freeze the robot, and let the loop report for the last time, with a limit for its silence."""
        self.server.stop()
        assert self.server._thread is not None
        self.server._thread.join()
        self.stage.timing = replace(PATIENT, answer_s=0.02, again_s=0.002)
        self.guard._limits = replace(LIMITS, loop_age_s=loop_age_s)
        self.guard.tick()

    def arrived(self) -> Iterator[tuple[RobotCommand, float]]:
        """Yield what has arrived at the frozen robot, with its time of arrival (s, time of day)."""
        with contextlib.suppress(BlockingIOError):
            while True:
                data, extra, _, _ = self.server._door._socket.recvmsg(2048, 64)
                seconds, nanoseconds = struct.unpack("qq", extra[0][2]) if extra else (0, 0)
                message = decode(data)
                assert isinstance(message, RobotCommand)
                yield message, seconds + nanoseconds * 1e-9


@pytest.fixture
def rig() -> Iterator[Rig]:
    limits = RobotLimits(longest_silence_s=20.0, release_s=60.0, longest_valid_s=30.0)
    with (
        RobotServer(RobotMachine(SteadyDrive(), limits)) as server,
        RobotStage.open(server.address, timing=PATIENT) as stage,
    ):
        # The kernel notes times some milliseconds later. A datagram that came before has the time of its reading.
        server._door._socket.setsockopt(socket.SOL_SOCKET, TIMESTAMPS, 1)
        yield Rig(server, stage)


@linux
def test_a_program_that_holds_the_interpreter_is_stopped(rig: Rig) -> None:
    rig.begin()
    rig.freeze(0.1)
    now_s = time.time()
    ctypes.PyDLL(None).usleep(300_000)  # C code that does not give the interpreter away
    arrived = [(command, time_s - now_s) for command, time_s in rig.arrived() if time_s > now_s]
    within = [command.kind for command, time_s in arrived if time_s < 0.3]
    stops = [time_s for command, time_s in arrived if command.kind is RobotKind.STOP]
    beats = [time_s for command, time_s in arrived if command.kind is RobotKind.ALIVE]
    assert within.count(RobotKind.ALIVE) >= 5
    assert within.count(RobotKind.STOP) >= 2  # it is repeated
    assert max(beats) <= stops[0]
    assert 0.09 <= stops[0] < 0.3
    numbers = [command.head.number for command, _ in arrived if command.kind is RobotKind.STOP]
    assert numbers == sorted(set(numbers))
    assert Cause.LOOP_LATE in rig.guard.check().latched


@linux
def test_after_a_trip_a_motion_of_a_program_that_does_not_know_it_is_not_sent(rig: Rig) -> None:
    rig.begin()
    rig.freeze(0.02)
    trips = rig.stage.supervisor.seen(10.0)[0]
    while rig.stage.supervisor.seen(10.0)[0] == trips:
        pass
    with pytest.raises(MotionRefused, match="stop_ordered"):
        rig.stage.insert(90.0, 5.0)
    assert not any(command.kind is RobotKind.INSERT for command, _ in rig.arrived())
    with pytest.raises(MotionRefused, match="loop_late"):
        rig.guard.insert(90.0, 5.0)
    assert rig.guard.state.operating is OperatingState.FAULT


def test_an_unplugged_serial_line_is_a_fault_of_the_guard() -> None:
    limits = RobotLimits(longest_silence_s=20.0, release_s=60.0, longest_valid_s=30.0)
    server = RobotServer(RobotMachine(SteadyDrive(), limits), line=True)
    with server, RobotStage.open(server.address, timing=PATIENT) as stage:
        rig = Rig(server, stage)
        rig.begin()
        server.stop()
        assert server._thread is not None
        server._thread.join()
        server._door.close()
        with pytest.raises(LinkClosed, match="the line was unplugged"):
            deque((rig.turn() for _ in range(100)), maxlen=0)
        assert Cause.STAGE_FAULT in rig.guard.check().latched
        assert rig.guard.state.operating is OperatingState.FAULT
