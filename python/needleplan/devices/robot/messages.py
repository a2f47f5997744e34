"""The needleplan robot protocol, version 1: the messages and their bytes.

The tables are in docs/reference/robot-protocol.md. Both sides have a monotonic clock, and neither knows the clock of
the other: a time is only echoed back to its sender. So the round trip is measured on one clock, and the deadline of a
command is a time on the clock of the robot.

A datagram is a little-endian structure of fixed size. In every version the first six bytes have the same meaning, and
the last four bytes are the CRC-32 of all bytes before them (that of zlib, Ethernet and MATLAB's java.util.zip.CRC32).
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from needleplan.errors import ProtocolError

__all__ = [
    "MAGIC",
    "NAMES_OF_FAULTS",
    "ROBOT_PORT",
    "VERSION",
    "Answer",
    "Fault",
    "Head",
    "OtherVersion",
    "Result",
    "RobotCommand",
    "RobotKind",
    "RobotMessage",
    "RobotState",
    "RobotStatus",
    "decode",
    "encode",
]


class RobotKind(IntEnum):
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
class RobotCommand:
    """A datagram of the control side."""

    head: Head
    kind: RobotKind
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
class RobotStatus:
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


RobotMessage = RobotCommand | Answer | RobotStatus


ROBOT_PORT = 5005
MAGIC = b"NPLR"
VERSION = 1

_FIRST = struct.Struct("<4sBB")
_HEAD = struct.Struct("<4sBBHIIQQII")
_COMMAND = struct.Struct("<QddI")
_ANSWER = struct.Struct("<BBH")
_STATUS = struct.Struct("<ddddIBBHI")
_CRC = struct.Struct("<I")
_COMMANDS = frozenset(RobotKind) - {RobotKind.STATUS, RobotKind.ANSWER}
_BODIES = {**dict.fromkeys(_COMMANDS, _COMMAND), RobotKind.STATUS: _STATUS, RobotKind.ANSWER: _ANSWER}


class OtherVersion(ProtocolError):
    """A sound datagram of a version that is not ours."""

    def __init__(self, version: int, kind: int) -> None:
        super().__init__(f"robot: the other side speaks version {version} of the protocol, this one {VERSION}")
        self.version, self.kind = version, kind


def encode(message: RobotMessage) -> bytes:
    """Return the datagram of a message. Raises ProtocolError where a number does not fit in its field."""
    kind, fields = _fields(message)
    head = message.head
    try:
        packed = _BODIES[kind].pack(*fields)
        begin = _HEAD.pack(
            MAGIC, VERSION, kind, _HEAD.size + len(packed) + _CRC.size, head.session, head.sequence, head.sent_ns,
            head.echo_ns, head.held_us, head.number,
        )  # fmt: skip
    except struct.error as error:
        raise ProtocolError(f"robot: {kind.name} cannot be sent: {error}") from error
    return begin + packed + _CRC.pack(zlib.crc32(begin + packed))


def decode(datagram: bytes) -> RobotMessage:
    """Return the message of a datagram. Raises OtherVersion, or ProtocolError where it is not one or damaged."""
    if len(datagram) < _FIRST.size + _CRC.size or not datagram.startswith(MAGIC):
        raise ProtocolError(f"robot: a datagram of {len(datagram)} bytes does not begin as one of this protocol")
    if zlib.crc32(datagram[: -_CRC.size]) != _CRC.unpack(datagram[-_CRC.size :])[0]:
        raise ProtocolError("robot: a datagram with a wrong checksum")
    _, version, code = _FIRST.unpack_from(datagram)
    if version != VERSION:
        raise OtherVersion(version, code)
    try:
        kind = RobotKind(code)
    except ValueError as error:
        raise ProtocolError(f"robot: 0x{code:02X} is not a kind of datagram") from error
    body = _BODIES[kind]
    size = _HEAD.size + body.size + _CRC.size
    if len(datagram) != size or _HEAD.unpack_from(datagram)[3] != size:
        raise ProtocolError(f"robot: {kind.name} has {size} bytes, this one {len(datagram)}")
    head = Head(*_HEAD.unpack_from(datagram)[4:])
    values = body.unpack_from(datagram, _HEAD.size)
    try:
        if kind is RobotKind.STATUS:
            return _status(head, values)
        if kind is RobotKind.ANSWER:
            asked, state, result = values
            return Answer(head, asked, Result(result), RobotState(state))
    except ValueError as error:
        raise ProtocolError(f"robot: {kind.name}: {error}") from error
    return RobotCommand(head, kind, *values)


def _status(head: Head, values: tuple[float, ...]) -> RobotStatus:
    depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, faults, state, moving, overruns, missed = values
    if moving not in (0, 1):
        raise ValueError(f"{moving} does not say whether it moves")
    return RobotStatus(
        head, depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, Fault(int(faults)), RobotState(int(state)),
        moving == 1, int(overruns), int(missed),
    )  # fmt: skip


def _fields(message: RobotMessage) -> tuple[RobotKind, tuple[float, ...]]:
    if isinstance(message, RobotCommand):
        return message.kind, (message.deadline_ns, message.target, message.speed, message.silence_us)
    if isinstance(message, Answer):
        return RobotKind.ANSWER, (message.asked, message.state, message.result)
    return RobotKind.STATUS, (
        message.depth_mm, message.velocity_mm_s, message.roll_rad, message.velocity_rad_s, message.faults,
        message.state, message.moving, message.overruns, message.missed,
    )  # fmt: skip
