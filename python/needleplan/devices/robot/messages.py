"""What control side and capture side of a needle robot say to each other, without the bytes.

Both sides have a monotonic clock, and neither knows that of the other: a time of the other side is only ever sent back
to it. So the round trip is measured on one clock, and a command's deadline is a time on the clock of the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag

__all__ = ["NAMES_OF_FAULTS", "Answer", "Command", "Fault", "Head", "Kind", "Message", "Result", "RobotState", "Status"]


class Kind(IntEnum):
    """What a datagram is; those of the capture side have the highest bit."""

    HELLO = 0x01
    """Asks for control. The session is the one that the control side has drawn."""

    ENABLE = 0x02
    INSERT = 0x03
    """To the depth `target` (mm) at `speed` (mm/s)."""

    ROTATE = 0x04
    """To the roll `target` (rad) at `speed` (rad/s)."""

    STOP = 0x05
    ALIVE = 0x06
    """Proof of life; not answered, but by the status."""

    RESET = 0x07
    """Leaves FAULT for DISABLED, where the cause is gone."""

    GOODBYE = 0x08
    """Stops, disables, and gives control up."""

    STATUS = 0x80
    ANSWER = 0x81


class Result(IntEnum):
    """What became of a command."""

    ACCEPTED = 0
    BUSY = 1
    """Another controller has the robot."""

    OLD_SESSION = 2
    WRONG_VERSION = 3
    LATE = 4
    """It came after its deadline, or had none."""

    SUPERSEDED = 5
    """A command with a higher number came before it."""

    NOT_ENABLED = 6
    OUT_OF_RANGE = 7
    """Target or speed is not a number, or not one that the drive accepts."""

    IN_FAULT = 8


class RobotState(IntEnum):
    """The state of the robot, by the names of CRTK."""

    DISABLED = 0
    ENABLED = 1
    FAULT = 3


class Fault(IntFlag):
    """Why the robot has stopped; a set bit stays until RESET."""

    WATCHDOG = 0x01
    ESTOP = 0x02
    DRIVE = 0x04
    FOLLOWING = 0x08
    LIMIT = 0x10
    ENCODER = 0x20
    NO_MOTION = 0x40


NAMES_OF_FAULTS = {
    Fault.WATCHDOG: "nothing was heard of the control side while it moved",
    Fault.ESTOP: "the emergency stop was pressed",
    Fault.DRIVE: "a drive reports a fault",
    Fault.FOLLOWING: "an axis does not follow",
    Fault.LIMIT: "a limit switch was reached",
    Fault.ENCODER: "an encoder has jumped or counts the wrong way",
    Fault.NO_MOTION: "an axis does not move",
}


@dataclass(frozen=True, slots=True)
class Head:
    """What every datagram begins with."""

    session: int
    sequence: int
    """Of the control side every datagram has its own number; of the capture side every status, and every answer."""

    sent_ns: int
    """When it was sent, on the sender's clock."""

    echo_ns: int = 0
    """`sent_ns` of the last datagram that came from the other side; 0 where none came."""

    held_us: int = 0
    """How long ago that came."""

    number: int = 0
    """Of a command its own number, which stays when it is sent again; of an answer that of its command; of a status
    that of the last command that was accepted."""


@dataclass(frozen=True, slots=True)
class Command:
    """A datagram of the control side."""

    head: Head
    kind: Kind
    deadline_ns: int = 0
    """Not to be executed later, on the clock of the robot; HELLO, STOP and GOODBYE need none."""

    target: float = 0.0
    speed: float = 0.0
    silence_us: int = 0
    """The robot stops where it hears nothing more for so long; 0: its own value."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a command; the same again where the command comes again."""

    head: Head
    asked: int
    """The kind of the command."""

    result: Result
    state: RobotState


@dataclass(frozen=True, slots=True)
class Status:
    """Where the robot is, a thousand times in a second."""

    head: Head
    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    velocity_rad_s: float
    faults: Fault
    state: RobotState
    moving: bool
    overruns: int = 0
    """Ticks of the servo that came late; stays at 65535."""

    missed: int = 0
    """Datagrams of the control side that are missing in this session."""


Message = Command | Answer | Status
