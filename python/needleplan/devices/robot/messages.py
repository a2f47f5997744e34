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
    """Kind of a datagram; kinds sent by the robot have the highest bit set."""

    HELLO = 0x01
    """Requests control in the session that the controller has drawn."""

    ENABLE = 0x02
    INSERT = 0x03
    """Moves to the depth `target` (mm) at `speed` (mm/s)."""

    ROTATE = 0x04
    """Rotates to the roll `target` (rad) at `speed` (rad/s)."""

    STOP = 0x05
    ALIVE = 0x06
    """Heartbeat; it has no answer, but the next status echoes it."""

    RESET = 0x07
    """Changes from FAULT to DISABLED if the cause is gone."""

    GOODBYE = 0x08
    """Stops, disables, and releases control."""

    STATUS = 0x80
    ANSWER = 0x81


class Result(IntEnum):
    """Result of a command."""

    ACCEPTED = 0
    BUSY = 1
    """Another controller has the robot."""

    OLD_SESSION = 2
    WRONG_VERSION = 3
    LATE = 4
    """It arrived after its deadline, or had none."""

    SUPERSEDED = 5
    """A command with a higher number arrived before it."""

    NOT_ENABLED = 6
    OUT_OF_RANGE = 7
    """The drive does not accept the target or the speed."""

    IN_FAULT = 8


class RobotState(IntEnum):
    """State of the robot, named as in CRTK."""

    DISABLED = 0
    ENABLED = 1
    FAULT = 3


class Fault(IntFlag):
    """Causes of a stop; a set bit stays until RESET."""

    WATCHDOG = 0x01
    ESTOP = 0x02
    DRIVE = 0x04
    FOLLOWING = 0x08
    LIMIT = 0x10
    ENCODER = 0x20
    NO_MOTION = 0x40


NAMES_OF_FAULTS = {
    Fault.WATCHDOG: "nothing was received from the controller while it moved",
    Fault.ESTOP: "the emergency stop was pressed",
    Fault.DRIVE: "a drive reports a fault",
    Fault.FOLLOWING: "an axis does not follow",
    Fault.LIMIT: "a limit switch was reached",
    Fault.ENCODER: "an encoder has jumped or counts in the wrong direction",
    Fault.NO_MOTION: "an axis does not move",
}


@dataclass(frozen=True, slots=True)
class Head:
    """Fields at the start of every datagram.

    - `sequence` counts the datagrams of the controller, and separately the statuses and the answers of the robot.
    - `sent_ns` is the time of sending on the clock of the sender.
    - `echo_ns` is `sent_ns` of the last datagram received from the other side, or 0.
    - `held_us` is the time since that datagram was received.
    - `number` is the number of a command, which stays the same when the command is repeated; in an answer the number of
      its command; in a status the number of the last accepted command.
    """

    session: int
    sequence: int
    sent_ns: int
    echo_ns: int = 0
    held_us: int = 0
    number: int = 0


@dataclass(frozen=True, slots=True)
class RobotCommand:
    """A datagram of the controller.

    `deadline_ns` is the latest time of execution on the clock of the robot; HELLO, STOP and GOODBYE need none. The
    robot stops if it receives nothing for `silence_us` while it moves; 0 selects its own value.
    """

    head: Head
    kind: RobotKind
    deadline_ns: int = 0
    target: float = 0.0
    speed: float = 0.0
    silence_us: int = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """Result of a command of the kind `asked`; a repeated command has the same answer."""

    head: Head
    asked: int
    result: Result
    state: RobotState


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """State of the robot, sent 1000 times per second.

    `overruns` counts late ticks of the servo up to 65535, `missed` the missing datagrams of the controller in this
    session.
    """

    head: Head
    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    velocity_rad_s: float
    faults: Fault
    state: RobotState
    moving: bool
    overruns: int = 0
    missed: int = 0


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
    """An undamaged datagram of another protocol version."""

    def __init__(self, version: int, kind: int) -> None:
        super().__init__(f"robot: the other side speaks version {version} of the protocol, this one {VERSION}")
        self.version, self.kind = version, kind


def encode(message: RobotMessage) -> bytes:
    """Return the datagram of a message. Raises ProtocolError if a number does not fit its field."""
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
    """Return the message in a datagram. Raises OtherVersion, or ProtocolError for damaged and foreign datagrams."""
    if len(datagram) < _FIRST.size + _CRC.size or not datagram.startswith(MAGIC):
        raise ProtocolError(f"robot: a datagram of {len(datagram)} bytes does not belong to this protocol")
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
