"""Every command in every state of the capture side: what becomes of it, and of the state."""

import pytest

from needleplan.devices.robot import Fault, RobotMachine, RobotState, SteadyDrive
from needleplan.devices.robot.messages import Answer, Head, Hello, Result, RobotCommand, RobotKind, decode, encode

PEER = ("controller", 1)
A, B, F = Result.ACCEPTED, Result.OLD_SESSION, Result.IN_FAULT
DISABLED, ENABLED, FAULT = RobotState
K = RobotKind

# By state: for each command its result, and the state after it. A repeated HELLO is that of the controller itself.
TABLE = {
    DISABLED: {
        K.HELLO: (A, DISABLED), K.ENABLE: (A, ENABLED), K.INSERT: (Result.NOT_ENABLED, DISABLED),
        K.ROTATE: (Result.NOT_ENABLED, DISABLED), K.STOP: (A, DISABLED), K.ALIVE: (None, DISABLED),
        K.RESET: (A, DISABLED), K.GOODBYE: (A, DISABLED), K.HOME: (A, DISABLED), K.UNHOME: (A, DISABLED),
    },
    ENABLED: {
        K.HELLO: (A, ENABLED), K.ENABLE: (A, ENABLED), K.INSERT: (A, ENABLED), K.ROTATE: (A, ENABLED),
        K.STOP: (A, ENABLED), K.ALIVE: (None, ENABLED), K.RESET: (A, ENABLED), K.GOODBYE: (A, DISABLED),
        K.HOME: (A, ENABLED), K.UNHOME: (A, ENABLED),
    },
    FAULT: {
        K.HELLO: (A, FAULT), K.ENABLE: (F, FAULT), K.INSERT: (F, FAULT), K.ROTATE: (F, FAULT),
        K.STOP: (A, FAULT), K.ALIVE: (None, FAULT), K.RESET: (A, DISABLED), K.GOODBYE: (A, FAULT),
        K.HOME: (F, FAULT), K.UNHOME: (A, FAULT),
    },
}  # fmt: skip


class Told:
    """A machine on a clock of whole milliseconds, and what it answers."""

    def __init__(self) -> None:
        self.drive = SteadyDrive()
        self.machine = RobotMachine(self.drive)
        self.now_ns = 0
        self.number = 0

    def tick(self) -> None:
        self.now_ns += 1_000_000
        self.machine.tick(self.now_ns)

    def tell(self, kind: RobotKind, session: int = 1) -> Result | None:
        """Give a command that is in time, and return its result."""
        self.number += 1
        head = Head(session, self.number, 1, number=self.number)
        command = Hello(head) if kind is K.HELLO else RobotCommand(head, kind, self.now_ns + 1, 20.0, 5.0)
        answer = self.machine.receive(encode(command), PEER, self.now_ns)
        if not answer:
            return None
        message = decode(answer)
        assert isinstance(message, Answer)
        assert (message.asked, message.head.number, message.state) == (kind, self.number, self.machine.state)
        return message.result


def in_state(state: RobotState) -> Told:
    told = Told()
    told.tick()
    assert told.tell(RobotKind.HELLO) is A
    if state is not DISABLED:
        told.tell(RobotKind.ENABLE)
    if state is FAULT:
        told.drive.faults.reported = Fault.DRIVE
        told.tick()
        told.drive.faults.reported = Fault(0)
        told.tick()
    assert told.machine.state is state
    return told


@pytest.mark.parametrize("kind", [kind for kind in RobotKind if kind < 0x80])
@pytest.mark.parametrize("state", RobotState)
def test_every_command_in_every_state(state: RobotState, kind: RobotKind) -> None:
    told = in_state(state)
    result, after = TABLE[state][kind]
    assert told.tell(kind) is result
    assert told.machine.state is after
    told.tick()
    moves = state is ENABLED and kind in (RobotKind.INSERT, RobotKind.ROTATE)
    last = told.drive.advance(told.now_ns / 1e9)
    assert last.moving == moves
    assert (told.machine.controller is None) == (kind is RobotKind.GOODBYE)


@pytest.mark.parametrize("kind", [kind for kind in RobotKind if kind < 0x80 and kind is not RobotKind.HELLO])
@pytest.mark.parametrize("state", RobotState)
def test_no_command_of_another_session_changes_anything(state: RobotState, kind: RobotKind) -> None:
    told = in_state(state)
    assert told.tell(kind, session=2) is B
    assert told.machine.state is state
    assert told.machine.controller == PEER


@pytest.mark.parametrize("kind", [kind for kind in RobotKind if kind < 0x80 and kind is not RobotKind.HELLO])
def test_without_a_session_there_is_nothing_to_command(kind: RobotKind) -> None:
    told = Told()
    told.tick()
    assert told.tell(kind) is B
    assert told.machine.state is DISABLED


def test_a_command_that_comes_again_is_answered_the_same_and_obeyed_once() -> None:
    told = in_state(ENABLED)
    head = Head(1, 50, 1, number=50)
    insert = encode(RobotCommand(head, RobotKind.INSERT, told.now_ns + 10_000_000, 20.0, 5.0))
    stop = encode(RobotCommand(Head(1, 51, 1, number=51), RobotKind.STOP))
    for datagram, result in ((insert, A), (insert, A), (stop, A), (insert, Result.SUPERSEDED), (stop, A)):
        answer = decode(told.machine.receive(datagram, PEER, told.now_ns))
        assert isinstance(answer, Answer)
        assert answer.result is result
    assert not told.drive.advance(told.now_ns / 1e9).moving


def test_sessions_that_have_ended_are_remembered() -> None:
    told = in_state(DISABLED)
    told.tell(RobotKind.GOODBYE)
    for session in range(2, 60):
        assert told.tell(RobotKind.HELLO, session) is A
        assert told.tell(RobotKind.GOODBYE, session) is A
    assert told.tell(RobotKind.HELLO, 1) is B
    assert told.tell(RobotKind.HELLO, 0) is B


@pytest.mark.parametrize("claims_rest", [False, True])
@pytest.mark.parametrize("sends_stops", [False, True])
def test_a_drive_that_reports_no_motion_is_stopped_when_the_controller_is_silent(
    claims_rest: bool, sends_stops: bool
) -> None:
    """Measured positions tell that the needle moves; and STOPs that a drive misses are no sign of life."""
    told = in_state(ENABLED)
    told.drive.faults.claims_rest, told.drive.faults.missed_stops = claims_rest, 10**9 if sends_stops else 1
    told.tell(K.INSERT)
    for turn in range(200):
        told.tick()
        if sends_stops and turn % 10 == 0:
            told.tell(K.STOP)
    assert told.machine.faults == Fault.WATCHDOG
    assert sends_stops or told.drive.advance(told.now_ns / 1e9).depth_mm < 0.3  # 30 ms and 0.1 mm at 5 mm/s


def test_a_silent_controller_of_an_axis_at_rest_is_no_fault() -> None:
    """Encoder noise and a servo that settles are no motion, also over a long time."""
    told = in_state(ENABLED)
    told.tell(K.INSERT)
    while told.drive.advance(told.now_ns / 1e9).moving:
        told.tick()
        told.tell(K.ALIVE)
    for turn in range(4000):
        told.drive.faults.jump_mm = 0.04 * (-1) ** turn
        told.tick()
    assert told.machine.faults == Fault(0)
