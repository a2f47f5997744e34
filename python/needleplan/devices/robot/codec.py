"""The bytes of the needleplan robot protocol, version 1: little-endian structures of fixed size, and a CRC-32.

docs/reference/robot-protocol.md has the tables. In every version the first six bytes are the same, and the last four
are the CRC of all before them (that of zlib, Ethernet and MATLAB's java.util.zip.CRC32).
"""

from __future__ import annotations

import struct
import zlib

from needleplan.devices.robot.messages import Answer, Command, Fault, Head, Kind, Message, Result, RobotState, Status
from needleplan.errors import ProtocolError

__all__ = ["MAGIC", "ROBOT_PORT", "VERSION", "OtherVersion", "decode", "encode"]

ROBOT_PORT = 5005
MAGIC = b"NPLR"
VERSION = 1

_FIRST = struct.Struct("<4sBB")
_HEAD = struct.Struct("<4sBBHIIQQII")
_COMMAND = struct.Struct("<QddI")
_ANSWER = struct.Struct("<BBH")
_STATUS = struct.Struct("<ddddIBBHI")
_CRC = struct.Struct("<I")
_COMMANDS = frozenset(Kind) - {Kind.STATUS, Kind.ANSWER}
_BODIES = {**dict.fromkeys(_COMMANDS, _COMMAND), Kind.STATUS: _STATUS, Kind.ANSWER: _ANSWER}


class OtherVersion(ProtocolError):
    """A sound datagram of a version that is not ours."""

    def __init__(self, version: int, kind: int) -> None:
        super().__init__(f"robot: the other side speaks version {version} of the protocol, this one {VERSION}")
        self.version, self.kind = version, kind


def encode(message: Message) -> bytes:
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


def decode(datagram: bytes) -> Message:
    """Return the message of a datagram. Raises OtherVersion, or ProtocolError where it is not one or damaged."""
    if len(datagram) < _FIRST.size + _CRC.size or not datagram.startswith(MAGIC):
        raise ProtocolError(f"robot: a datagram of {len(datagram)} bytes does not begin as one of this protocol")
    if zlib.crc32(datagram[: -_CRC.size]) != _CRC.unpack(datagram[-_CRC.size :])[0]:
        raise ProtocolError("robot: a datagram with a wrong checksum")
    _, version, code = _FIRST.unpack_from(datagram)
    if version != VERSION:
        raise OtherVersion(version, code)
    try:
        kind = Kind(code)
    except ValueError as error:
        raise ProtocolError(f"robot: 0x{code:02X} is not a kind of datagram") from error
    body = _BODIES[kind]
    size = _HEAD.size + body.size + _CRC.size
    if len(datagram) != size or _HEAD.unpack_from(datagram)[3] != size:
        raise ProtocolError(f"robot: {kind.name} has {size} bytes, this one {len(datagram)}")
    head = Head(*_HEAD.unpack_from(datagram)[4:])
    values = body.unpack_from(datagram, _HEAD.size)
    try:
        if kind is Kind.STATUS:
            return _status(head, values)
        if kind is Kind.ANSWER:
            asked, state, result = values
            return Answer(head, asked, Result(result), RobotState(state))
    except ValueError as error:
        raise ProtocolError(f"robot: {kind.name}: {error}") from error
    return Command(head, kind, *values)


def _status(head: Head, values: tuple[float, ...]) -> Status:
    depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, faults, state, moving, overruns, missed = values
    if moving not in (0, 1):
        raise ValueError(f"{moving} does not say whether it moves")
    return Status(
        head, depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, Fault(int(faults)), RobotState(int(state)),
        moving == 1, int(overruns), int(missed),
    )  # fmt: skip


def _fields(message: Message) -> tuple[Kind, tuple[float, ...]]:
    if isinstance(message, Command):
        return message.kind, (message.deadline_ns, message.target, message.speed, message.silence_us)
    if isinstance(message, Answer):
        return Kind.ANSWER, (message.asked, message.state, message.result)
    return Kind.STATUS, (
        message.depth_mm, message.velocity_mm_s, message.roll_rad, message.velocity_rad_s, message.faults,
        message.state, message.moving, message.overruns, message.missed,
    )  # fmt: skip
