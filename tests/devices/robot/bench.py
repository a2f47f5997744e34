"""A robot on a virtual clock, and a network between it and its controllers that can be told to misbehave."""

from collections import deque
from dataclasses import replace
from itertools import count

import pytest

from needleplan.devices import StageSample, VirtualClock
from needleplan.devices.robot import (
    MotionLimits,
    RobotLimits,
    RobotMachine,
    RobotStage,
    RobotTiming,
    SteadyDrive,
)
from needleplan.devices.robot.messages import Answer, Head, Result, RobotCommand, RobotKind, decode, encode
from needleplan.errors import DeviceFault
from tests.devices.contract import heard_and_read
from tests.devices.robot.network import RobotNetwork


class Bench:
    """Drive, machine and network, all in this process; what a test does takes no time but that of the clock."""

    def __init__(self, limits: RobotLimits | None = None, key: bytes | None = None) -> None:
        self.clock = VirtualClock(5_000_000_000)
        self.drive = SteadyDrive()
        self.machine = RobotMachine(self.drive, limits, key=key)
        self.network = RobotNetwork(self.machine, self.clock)
        self._sessions = count(1)

    def stage(
        self, timing: RobotTiming | None = None, *, name: str = "controller", session: int | None = None,
        limits: MotionLimits | None = None, key: bytes | None = None,
    ) -> RobotStage:  # fmt: skip
        """Open a stage; its session is the next number, unless one is given."""
        draw = (lambda: next(self._sessions)) if session is None else (lambda: session)
        return RobotStage(
            self.network.link(name), timing=timing, limits=limits, key=key, clock=self.clock, draw_session=draw
        )

    def wait(self, seconds: float) -> None:
        """Let time pass for the robot while nobody on the control side does anything."""
        self.network.pass_until(self.clock.now_ns() + round(seconds * 1e9))

    @property
    def truth(self) -> tuple[float, bool]:
        """Where the insertion axis is, and whether it should move."""
        state = self.drive.advance((self.clock.now_ns() + self.network.ahead_ns) / 1e9)
        return state.depth_mm, state.moving


def next_of(stage: RobotStage) -> StageSample:
    """Return the next sample for a loop that is alive."""
    sample = heard_and_read(stage, 0.05)
    assert sample is not None
    return sample


def moving(bench: Bench, speed_mm_s: float = 10.0) -> RobotStage:
    """Return a stage that has moved for 50 ms."""
    stage = bench.stage()
    stage.insert(100.0, speed_mm_s)
    for _ in range(50):
        assert next_of(stage).moving
    return stage


def fault_of(stage: RobotStage, cause: str) -> None:
    """Read until the stage gives up, and see that it stays given up, and takes no motion."""
    with pytest.raises(DeviceFault, match=cause):
        deque((heard_and_read(stage, 0.02) for _ in range(1000)), maxlen=0)
    with pytest.raises(DeviceFault, match=cause):
        stage.read(0)
    with pytest.raises(DeviceFault, match=cause):
        stage.insert(1.0, 1.0)


def stands_still(bench: Bench, seconds: float = 1.0) -> None:
    """See that nothing moves, for a while."""
    before, _ = bench.truth
    bench.wait(seconds)
    assert bench.truth == (before, False)


def raw(bench: Bench, kind: RobotKind, **fields: object) -> Answer | None:
    """Send a datagram of the controller's session by hand and return its answer."""
    session = bench.machine._session
    assert session is not None
    head = Head(session.id, session.sequence + 1, 1, number=session.number + 1)
    deadline_ns = bench.clock.now_ns() + bench.network.ahead_ns + 10_000_000
    command = RobotCommand(head, kind, deadline_ns, 50.0, 5.0)
    head_fields = {name: fields.pop(name) for name in list(fields) if name in ("session", "sequence", "number")}
    command = replace(command, head=replace(head, **head_fields), **fields)  # type: ignore[arg-type]
    answer = bench.machine.receive(encode(command), session.peer, bench.clock.now_ns() + bench.network.ahead_ns)
    if not answer:
        return None
    message = decode(answer)
    assert isinstance(message, Answer)
    return message


def result_of(answer: Answer | None) -> Result | None:
    return None if answer is None else answer.result


def at_rest(stage: RobotStage) -> StageSample:
    """Read what was said while it moved, until it says that it stands still."""
    sample = next(each for each in (next_of(stage) for _ in range(2500)) if not each.moving)
    assert sample.velocity_mm_s == 0
    return sample
