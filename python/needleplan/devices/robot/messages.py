"""The needleplan robot protocol, version 1: the messages and their bytes.

docs/reference/robot-protocol.md describes all fields. Each side has its own monotonic clock, and the clocks are not
synchronised. Each datagram repeats the sending time of the last received datagram, so that each side can measure the
round-trip time on its own clock. The deadline of a command is a time on the clock of the robot.

A datagram is a little-endian structure of fixed size. In every version the first six bytes have the same meaning, and
the last four bytes are the CRC-32 of all bytes before them (the same CRC-32 as in zlib, Ethernet and MATLAB's
java.util.zip.CRC32).
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
    """Requests control of the robot in a new session, whose number the controller has chosen at random."""

    ENABLE = 0x02
    INSERT = 0x03
    """Moves to the depth `target` (mm) at `speed` (mm/s)."""

    ROTATE = 0x04
    """Rotates to the roll `target` (rad) at `speed` (rad/s)."""

    STOP = 0x05
    ALIVE = 0x06
    """Heartbeat. The robot sends no answer, but repeats the sending time of the heartbeat in the next status."""

    RESET = 0x07
    """Changes the state from FAULT to DISABLED if the cause is gone."""

    GOODBYE = 0x08
    """Stops and disables the robot, and releases control."""

    STATUS = 0x80
    ANSWER = 0x81


class Result(IntEnum):
    """Result of a command."""

    ACCEPTED = 0
    BUSY = 1
    """Another controller has the robot."""

    OLD_SESSION = 2
    """The session of the command has ended, or was never accepted."""

    WRONG_VERSION = 3
    LATE = 4
    """The command arrived after its deadline, or has no deadline although its kind needs one."""

    SUPERSEDED = 5
    """A later command (with a higher number) arrived before this command."""

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
    """Causes of a stop, with texts in `NAMES_OF_FAULTS`; a set bit stays set until RESET."""

    WATCHDOG = 0x01
    ESTOP = 0x02
    DRIVE = 0x04
    FOLLOWING = 0x08
    LIMIT = 0x10
    ENCODER = 0x20
    NO_MOTION = 0x40


NAMES_OF_FAULTS = {
    Fault.WATCHDOG: "nothing was received from the controller while the robot moved",
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

    - `sequence` numbers the datagrams; commands, statuses and answers are numbered separately.
    - `sent_ns` is the time of sending on the clock of the sender.
    - `echo_ns` is `sent_ns` of the last datagram received from the other side, or 0 before the first one.
    - `held_us` is the time (us) from the arrival of that datagram to the sending of this datagram.
    - `number` is the number of the command: in an answer, of the answered command; in a status, of the last accepted
      command. A command that is sent again keeps its number.
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

    `deadline_ns` is the latest time of execution on the clock of the robot; HELLO, STOP and GOODBYE need no deadline.
    While the robot moves, it stops if it receives nothing for `silence_us`; 0 selects the default of the robot.
    """

    head: Head
    kind: RobotKind
    deadline_ns: int = 0
    target: float = 0.0
    speed: float = 0.0
    silence_us: int = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of the robot to a command of the kind `asked`; a command that is sent again gets the same result."""

    head: Head
    asked: int
    result: Result
    state: RobotState


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """State of the robot, sent 1000 times per second.

    `overruns` is the number of late ticks of the servo, at most 65535. `missed` is the number of datagrams of the
    controller that did not arrive in this session.
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
        super().__init__(f"robot: the other side speaks version {version} of the protocol, this side {VERSION}")
        self.version, self.kind = version, kind


def encode(message: RobotMessage) -> bytes:
    """Return the datagram of a message. Raises ProtocolError if a number does not fit into its field."""
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
    """Return the message in a datagram.

    Raises OtherVersion for another protocol version, ProtocolError for a damaged datagram or another protocol.
    """
    if len(datagram) < _FIRST.size + _CRC.size or not datagram.startswith(MAGIC):
        raise ProtocolError(f"robot: a datagram of {len(datagram)} bytes does not belong to this protocol")
    if zlib.crc32(datagram[: -_CRC.size]) != _CRC.unpack(datagram[-_CRC.size :])[0]:
        raise ProtocolError("robot: a datagram has a wrong checksum")
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
        raise ProtocolError(f"robot: a {kind.name} datagram must have {size} bytes, not {len(datagram)}")
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
        raise ValueError(f"`moving` is {moving}, must be 0 or 1")
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
