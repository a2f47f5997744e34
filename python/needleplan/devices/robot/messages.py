"""The needleplan robot protocol, version 3: the messages and their bytes.

docs/reference/needleplan_robot.h describes all fields. Each side has its own monotonic clock, and the clocks are not
synchronised. Each datagram repeats the sending time of the last received datagram, so that each side can measure the
round-trip time on its own clock. The deadline of a command is a time on the clock of the robot.

A datagram is a little-endian structure of fixed size. In every version the first six bytes have the same meaning, and
the last four bytes are the CRC-32 of all bytes before them (the same CRC-32 as in zlib, Ethernet and MATLAB's
java.util.zip.CRC32).

With a shared key, a datagram has 16 more bytes before its checksum: the first half of an HMAC-SHA256 (RFC 2104) over a
nonce of the robot and over all bytes before the tag. The robot draws the nonce for each session and sends it in its
answer to HELLO, so that a recorded session cannot be replayed.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import struct
import zlib
from dataclasses import dataclass

from needleplan.artifacts import CallRepr
from needleplan.devices.robot._codes import NAMES_OF_FAULTS, Fault, Result, RobotKind, RobotState
from needleplan.errors import ProtocolError

__all__ = [
    "MAGIC",
    "NAMES_OF_FAULTS",
    "OLDEST_VERSION",
    "ROBOT_PORT",
    "VERSION",
    "Answer",
    "Fault",
    "Head",
    "Hello",
    "MotionLimits",
    "NotAuthentic",
    "OtherVersion",
    "Result",
    "RobotCommand",
    "RobotKind",
    "RobotMessage",
    "RobotState",
    "RobotStatus",
    "Seal",
    "decode",
    "encode",
]


@dataclass(frozen=True, slots=True)
class Head:
    """Fields at the start of every datagram.

    - `sequence` numbers the datagrams; commands, statuses and answers are numbered separately.
    - `sent_ns` is the time of sending on the clock of the sender.
    - `echo_ns` is `sent_ns` of the last datagram received from the other side, or 0 before the first one.
    - `held_us` is the time (us) from the arrival of that datagram to the sending of this datagram.
    - `number` is the number of the command: in an answer, of the answered command; in a status, of the last accepted
      command. A command that is sent again keeps its number.
    - `version` is the version of the datagram: `VERSION`, or `OLDEST_VERSION` for a peer that knows no later one.
    """

    session: int
    sequence: int
    sent_ns: int
    echo_ns: int = 0
    held_us: int = 0
    number: int = 0
    version: int = 3


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of the motions of one session. HELLO sets them, and they are fixed until the session ends.

    - `least_mm`, `most_mm`: range of depths that INSERT may command; both 0 select the range of the robot.
    - `speed_mm_s`, `rotation_rad_s`: largest speeds of INSERT and ROTATE; 0 selects the limit of the robot.
    - `roll_rad`: largest roll to either side; 0 selects the limit of the robot.
    - `valid_us`: longest time (us) from the present to the deadline of a motion; 0 selects the limit of the robot.
    """

    least_mm: float = 0.0
    most_mm: float = 0.0
    speed_mm_s: float = 0.0
    roll_rad: float = 0.0
    rotation_rad_s: float = 0.0
    valid_us: int = 0

    def __str__(self) -> str:
        speeds = f"{self.speed_mm_s:g} mm/s, {self.roll_rad:g} rad, {self.rotation_rad_s:g} rad/s"
        return f"{self.least_mm:g} to {self.most_mm:g} mm, {speeds}"

    def within(self, own: MotionLimits) -> MotionLimits | Result:
        """Return these limits, completed by the limits of the robot (`own`); the cause if a limit is invalid or wider.

        A limit that is wider than that of the robot is refused, not reduced, so that the controller knows its limits.
        """
        numbers = (self.least_mm, self.most_mm, self.speed_mm_s, self.roll_rad, self.rotation_rad_s)
        if not all(map(math.isfinite, numbers)):
            return Result.OUT_OF_RANGE
        least, most = self.least_mm, self.most_mm
        if least == 0 and most == 0:
            least, most = own.least_mm, own.most_mm
        if not own.least_mm <= least < most <= own.most_mm:
            return Result.DEPTH_BEYOND
        for asked, limit, cause in (
            (self.speed_mm_s, own.speed_mm_s, Result.SPEED_BEYOND),
            (self.roll_rad, own.roll_rad, Result.ROLL_BEYOND),
            (self.rotation_rad_s, own.rotation_rad_s, Result.ROTATION_BEYOND),
            (self.valid_us, own.valid_us, Result.DEADLINE_BEYOND),
        ):
            if not 0 <= asked <= limit:
                return cause
        return MotionLimits(
            least, most, self.speed_mm_s or own.speed_mm_s, self.roll_rad or own.roll_rad,
            self.rotation_rad_s or own.rotation_rad_s, self.valid_us or own.valid_us,
        )  # fmt: skip

    def against(self, command: RobotCommand, now_ns: int) -> Result | None:
        """Return the cause against a motion that arrives at `now_ns` on the robot's clock; None if it is allowed."""
        if not (math.isfinite(command.target) and math.isfinite(command.speed) and command.speed > 0):
            return Result.OUT_OF_RANGE
        if command.deadline_ns - now_ns > 1000 * self.valid_us:
            return Result.DEADLINE_BEYOND
        if command.kind is RobotKind.INSERT:
            if not self.least_mm <= command.target <= self.most_mm:
                return Result.DEPTH_BEYOND
            return Result.SPEED_BEYOND if command.speed > self.speed_mm_s else None
        if abs(command.target) > self.roll_rad:
            return Result.ROLL_BEYOND
        return Result.ROTATION_BEYOND if command.speed > self.rotation_rad_s else None


@dataclass(frozen=True, slots=True)
class Hello(CallRepr):
    """The first datagram of a session, with its limits; `silence_us` is that of `RobotCommand`."""

    head: Head
    limits: MotionLimits = MotionLimits()
    silence_us: int = 0

    kind = RobotKind.HELLO


@dataclass(frozen=True, slots=True)
class RobotCommand(CallRepr):
    """A datagram of the controller other than HELLO.

    `deadline_ns` is the latest time of execution on the clock of the robot; STOP and GOODBYE need no deadline.
    While the robot moves, it stops if it receives nothing for `silence_us`; 0 selects the default of the robot.
    """

    head: Head
    kind: RobotKind
    deadline_ns: int = 0
    target: float = 0.0
    speed: float = 0.0
    silence_us: int = 0


@dataclass(frozen=True, slots=True)
class Answer(CallRepr):
    """Answer of the robot to a command of the kind `asked`; a command that is sent again gets the same result.

    `nonce` is a random number of the session in the answer to HELLO, else 0.
    """

    head: Head
    asked: int
    result: Result
    state: RobotState
    nonce: int = 0


@dataclass(frozen=True, slots=True)
class RobotStatus(CallRepr):
    """State of the robot, sent 1000 times per second; on a serial line, as COMPACT, at least 200 times.

    `overruns` is the number of late ticks of the servo, at most 65535. `missed` is the number of datagrams of the
    controller that did not arrive in this session. `homed` tells whether the zero of the robot is known, `standing`
    whether both axes have stood for 50 ms by their measured positions; both are None in version 2. The numbers of a
    `compact` status have 4 bytes each.
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
    homed: bool | None = None
    standing: bool | None = None
    compact: bool = False


RobotMessage = Hello | RobotCommand | Answer | RobotStatus


ROBOT_PORT = 5005
MAGIC = b"NPLR"
VERSION, OLDEST_VERSION = 3, 2

_FIRST = struct.Struct("<4sBB")
_HEAD = struct.Struct("<4sBBHIIQQII")
_HELLO = struct.Struct("<dddddIII")
_COMMAND = struct.Struct("<QddI")
_ANSWER = struct.Struct("<QBBH")
_STATUS = struct.Struct("<ddddIBBHI")
_COMPACT = struct.Struct("<ffffIBBHI")
_CRC = struct.Struct("<I")
_NONCE = struct.Struct("<Q")
_MOVING, _HOMED, _STANDING = 1, 2, 4  # bits of the byte `flags` of a status; only `moving` in version 2
_NEW_KINDS = (RobotKind.HOME, RobotKind.UNHOME)  # since version 3
_TAG = 16  # bytes of a tag: half of an HMAC-SHA256
_LEAST_KEY = 16  # bytes of the shortest accepted key
_BODIES = dict.fromkeys(RobotKind, _COMMAND) | {
    RobotKind.HELLO: _HELLO, RobotKind.STATUS: _STATUS, RobotKind.ANSWER: _ANSWER, RobotKind.COMPACT: _COMPACT,
}  # fmt: skip


class OtherVersion(ProtocolError):
    """An undamaged datagram of another protocol version."""

    def __init__(self, version: int, kind: int) -> None:
        super().__init__(f"robot: the other side speaks version {version} of the protocol, this side {VERSION}")
        self.version = version
        self.kind = kind


class NotAuthentic(ProtocolError):
    """An undamaged datagram without a tag, or with the tag of another key or session."""


@dataclass(frozen=True)
class Seal:
    """Key of at least 16 bytes, and nonce of the session (0 before the answer to HELLO), which authenticate datagrams.

    Raises ProtocolError if the key is too short.
    """

    key: bytes
    nonce: int = 0

    def __post_init__(self) -> None:
        if len(self.key) < _LEAST_KEY:
            raise ProtocolError(f"robot: a key must have at least {_LEAST_KEY} bytes, not {len(self.key)}")

    def tag(self, begin: bytes) -> bytes:
        """Return the tag (16 bytes) of a datagram that begins with the bytes `begin`."""
        return hmac.digest(self.key, _NONCE.pack(self.nonce) + begin, hashlib.sha256)[:_TAG]


def encode(message: RobotMessage, seal: Seal | None = None) -> bytes:
    """Return the datagram of a message, with the tag of `seal` if given.

    Raises ProtocolError if a number does not fit into its field.
    """
    kind, fields = _fields(message)
    head = message.head
    tag_size = 0 if seal is None else _TAG
    try:
        packed = _BODIES[kind].pack(*fields)
        begin = _HEAD.pack(
            MAGIC, head.version, kind, _HEAD.size + len(packed) + tag_size + _CRC.size, head.session, head.sequence,
            head.sent_ns, head.echo_ns, head.held_us, head.number,
        )  # fmt: skip
    except (struct.error, OverflowError) as error:
        raise ProtocolError(f"robot: {kind.name} cannot be sent: {error}") from error
    begin += packed
    if seal is not None:
        begin += seal.tag(begin)
    return begin + _CRC.pack(zlib.crc32(begin))


def decode(datagram: bytes, seal: Seal | None = None) -> RobotMessage:
    """Return the message in a datagram. Without a `seal`, a tag is ignored.

    Raises OtherVersion for another protocol version, NotAuthentic if the tag is missing or not that of `seal`, and
    ProtocolError for a damaged datagram or another protocol.
    """
    if len(datagram) < _FIRST.size + _CRC.size or not datagram.startswith(MAGIC):
        raise ProtocolError(f"robot: a datagram of {len(datagram)} bytes does not belong to this protocol")
    if zlib.crc32(datagram[: -_CRC.size]) != _CRC.unpack(datagram[-_CRC.size :])[0]:
        raise ProtocolError("robot: a datagram has a wrong checksum")
    _, version, code = _FIRST.unpack_from(datagram)
    if version not in (VERSION, OLDEST_VERSION):
        raise OtherVersion(version, code)
    try:
        kind = RobotKind(code)
    except ValueError as error:
        raise ProtocolError(f"robot: 0x{code:02X} is not a kind of datagram") from error
    if version < VERSION and kind in _NEW_KINDS:
        raise ProtocolError(f"robot: {kind.name} is not a kind of datagram of version {version}")
    body = _BODIES[kind]
    size = _HEAD.size + body.size + _CRC.size
    if len(datagram) not in (size, size + _TAG) or _HEAD.unpack_from(datagram)[3] != len(datagram):
        raise ProtocolError(f"robot: a {kind.name} datagram must have {size} bytes, not {len(datagram)}")
    if seal is not None:
        end = _HEAD.size + body.size
        if not hmac.compare_digest(datagram[end : -_CRC.size], seal.tag(datagram[:end])):
            raise NotAuthentic(f"robot: a {kind.name} datagram is not authenticated with the key of this session")
    session, sequence, sent_ns, echo_ns, held_us, number = _HEAD.unpack_from(datagram)[4:]
    head = Head(session, sequence, sent_ns, echo_ns, held_us, number, version)
    values = body.unpack_from(datagram, _HEAD.size)
    try:
        if kind in (RobotKind.STATUS, RobotKind.COMPACT):
            return _status(head, values, compact=kind is RobotKind.COMPACT)
        if kind is RobotKind.ANSWER:
            nonce, asked, state, result = values
            return Answer(head, asked, Result(result), RobotState(state), nonce)
        if kind is RobotKind.HELLO:
            return _hello(head, values)
    except ValueError as error:
        raise ProtocolError(f"robot: {kind.name}: {error}") from error
    return RobotCommand(head, kind, *values)


def _hello(head: Head, values: tuple[float, ...]) -> Hello:
    least, most, speed, roll, rotation, silence_us, valid_us, unused = values
    if unused:
        raise ValueError(f"`unused` is {unused}, must be 0")
    return Hello(head, MotionLimits(least, most, speed, roll, rotation, int(valid_us)), int(silence_us))


def _status(head: Head, values: tuple[float, ...], *, compact: bool) -> RobotStatus:
    depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, faults, state, byte, overruns, missed = values
    flags, is_old = int(byte), head.version < VERSION
    known = _MOVING if is_old else _MOVING | _HOMED | _STANDING
    if flags & ~known:
        raise ValueError(f"`flags` is {flags}, must be at most {known}")
    homed, standing = (None, None) if is_old else (bool(flags & _HOMED), bool(flags & _STANDING))
    return RobotStatus(
        head, depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, Fault(int(faults)), RobotState(int(state)),
        bool(flags & _MOVING), int(overruns), int(missed), homed, standing, compact,
    )  # fmt: skip


def _fields(message: RobotMessage) -> tuple[RobotKind, tuple[float, ...]]:
    if isinstance(message, Hello):
        limits = message.limits
        return RobotKind.HELLO, (
            limits.least_mm, limits.most_mm, limits.speed_mm_s, limits.roll_rad, limits.rotation_rad_s,
            message.silence_us, limits.valid_us, 0,
        )  # fmt: skip
    if isinstance(message, RobotCommand):
        return message.kind, (message.deadline_ns, message.target, message.speed, message.silence_us)
    if isinstance(message, Answer):
        return RobotKind.ANSWER, (message.nonce, message.asked, message.state, message.result)
    flags = _MOVING * message.moving
    if message.head.version == VERSION:
        flags |= _HOMED * bool(message.homed) | _STANDING * bool(message.standing)
    return RobotKind.COMPACT if message.compact else RobotKind.STATUS, (
        message.depth_mm, message.velocity_mm_s, message.roll_rad, message.velocity_rad_s, message.faults,
        message.state, flags, message.overruns, message.missed,
    )  # fmt: skip
