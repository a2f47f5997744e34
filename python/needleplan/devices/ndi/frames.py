"""Frames of NDI trackers: replies to TX (text) and BX (binary) of the combined API, their CRC, and their validation.

A reply to BX has a header of six bytes (0xA5C4, the length of the body, the CRC of these four bytes), the body, and the
CRC of the body, all little-endian. The CRC of a header that includes its CRC is zero, so the CRC of header and body
equals the CRC of the body. A reply to TX has numbers of fixed width: first the number of tools; for each tool its
handle, then `MISSING`, `DISABLED`, `UNOCCUPIED` or a transform of 51 characters, then port status, frame number and a
line feed; at the end the system status.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr
from needleplan.devices._base import PoseSample, PoseValidator, Stamp
from needleplan.errors import DeviceFault, ProtocolError

__all__ = [
    "HEADER_BYTES",
    "START",
    "Frames",
    "NdiPoseLimits",
    "NdiPoseValidator",
    "NdiVisibility",
    "ToolFrame",
    "body_length",
    "crc16",
    "encode_bx",
    "encode_tx",
    "parse_bx",
    "parse_tx",
]


def _entry(value: int) -> int:
    for _ in range(8):
        value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


_TABLE = tuple(map(_entry, range(256)))


def crc16(data: bytes) -> int:
    """Return the CRC-16/ARC of `data`: polynomial x^16 + x^15 + x^2 + 1, reflected (0xA001), initial value 0."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


_NAN = math.nan

_PORT_SUSPECT = {0x40: "out of the volume", 0x80: "partly out of the volume"}
"""Bits of the port status that make a pose SUSPECT, and their names in the notes of the sample."""

_SYSTEM_SUSPECT = {
    0x01: "synchronisation",
    0x02: "external infrared",
    0x04: "CRC in the system",
    0x08: "recoverable error",
}
"""Bits of the system status that make all poses SUSPECT, and their names in the notes of the sample."""


class NdiVisibility(StrEnum):
    """Status of a tool in a frame."""

    VALID = "valid"
    MISSING = "missing"
    DISABLED = "disabled"
    UNOCCUPIED = "unoccupied"


@dataclass(frozen=True)
class ToolFrame(CallRepr):
    """One tool in one frame; quaternion (w, x, y, z), position and error are NaN unless `visibility` is VALID."""

    handle: int
    visibility: NdiVisibility
    quaternion: tuple[float, float, float, float] = (_NAN, _NAN, _NAN, _NAN)
    position_mm: tuple[float, float, float] = (_NAN, _NAN, _NAN)
    error_mm: float = _NAN
    port_status: int | None = None
    frame: int | None = None


@dataclass(frozen=True)
class Frames(CallRepr):
    """Content of one reply to TX or BX: the tools, and the system status word."""

    tools: tuple[ToolFrame, ...]
    system_status: int


def _bits_of(status: int, names: dict[int, str]) -> tuple[str, ...]:
    """Return the names of the bits that are set in `status`; `names` maps bits to names."""
    return tuple(name for bit, name in names.items() if status & bit)


START = b"\xc4\xa5"
HEADER_BYTES = 6

_TRANSFORM = struct.Struct("<8f")
_STATUS = struct.Struct("<II")
_VISIBILITY = {0x01: NdiVisibility.VALID, 0x02: NdiVisibility.MISSING, 0x04: NdiVisibility.DISABLED}
_CODES = {visibility: code for code, visibility in _VISIBILITY.items()}


def body_length(header: bytes) -> int:
    """Return the length (bytes) of the body that a header of six bytes announces. Raises ProtocolError."""
    if len(header) != HEADER_BYTES or header[:2] != START:
        raise ProtocolError("BX: does not begin with C4 A5")
    if crc16(header):
        raise ProtocolError("BX: wrong CRC of the header")
    return int.from_bytes(header[2:4], "little")


def parse_bx(message: bytes) -> Frames:
    """Return the frames in a complete reply to BX:0001 or BX:0801. Raises ProtocolError."""
    length = body_length(message[:HEADER_BYTES])
    body, crc = message[HEADER_BYTES:-2], message[-2:]
    if len(message) != length + HEADER_BYTES + 2:
        raise ProtocolError(f"BX: {len(message)} bytes, its header says {length + HEADER_BYTES + 2}")
    if crc16(body) != int.from_bytes(crc, "little"):
        raise ProtocolError("BX: wrong CRC of the body")
    try:
        count, position, tools = body[0], 1, []
        for _ in range(count):
            tool, position = _tool(body, position)
            tools.append(tool)
        (system_status,) = struct.unpack_from("<H", body, position)
    except (struct.error, IndexError) as error:
        raise ProtocolError("BX: its body ends too early") from error
    if position + 2 != len(body):
        raise ProtocolError("BX: its body is longer than its tools")
    return Frames(tuple(tools), system_status)


def encode_bx(frames: Frames) -> bytes:
    """Return the bytes of a complete reply to BX; a tool that is UNOCCUPIED is sent as DISABLED."""
    body = bytearray([len(frames.tools)])
    for tool in frames.tools:
        body += bytes([tool.handle, _CODES.get(tool.visibility, _CODES[NdiVisibility.DISABLED])])
        if tool.visibility is NdiVisibility.VALID:
            body += _TRANSFORM.pack(*tool.quaternion, *tool.position_mm, tool.error_mm)
        if tool.visibility in (NdiVisibility.VALID, NdiVisibility.MISSING):
            body += _STATUS.pack(tool.port_status or 0, tool.frame or 0)
    body += frames.system_status.to_bytes(2, "little")
    header = START + len(body).to_bytes(2, "little")
    return header + crc16(header).to_bytes(2, "little") + bytes(body) + crc16(bytes(body)).to_bytes(2, "little")


def _tool(body: bytes, position: int) -> tuple[ToolFrame, int]:
    handle, code = body[position], body[position + 1]
    position += 2
    if code not in _VISIBILITY:
        raise ProtocolError(f"BX: handle status {code:02X} is not known")
    visibility = _VISIBILITY[code]
    if visibility is NdiVisibility.DISABLED:
        return ToolFrame(handle, visibility), position
    values: tuple[float, ...] = ()
    if visibility is NdiVisibility.VALID:
        values = _TRANSFORM.unpack_from(body, position)
        position += _TRANSFORM.size
    port_status, frame = _STATUS.unpack_from(body, position)
    position += _STATUS.size
    if not values:
        return ToolFrame(handle, visibility, port_status=port_status, frame=frame), position
    w, x, y, z, px, py, pz, error_mm = values
    return ToolFrame(handle, visibility, (w, x, y, z), (px, py, pz), error_mm, port_status, frame), position


_TOOL = re.compile(
    r"([0-9A-F]{2})(?:(MISSING|DISABLED|UNOCCUPIED)|((?:[+-]\d{5}){4})((?:[+-]\d{6}){3})([+-]\d{5}))"
    r"(?:([0-9A-F]{8})([0-9A-F]{8}))?\n"
)
_HEX = re.compile(r"[0-9A-F]+")


def parse_tx(text: str) -> Frames:
    """Return the frames in a reply to TX:0001 or TX:0801; `text` has no CRC. Raises ProtocolError."""
    count = _hexadecimal(text[:2], 2)
    tools, position = [], 2
    for _ in range(count):
        match = _TOOL.match(text, position)
        if match is None:
            raise ProtocolError(f"TX: no tool at character {position} of {len(text)}")
        tools.append(_text_tool(match))
        position = match.end()
    return Frames(tuple(tools), _hexadecimal(text[position:], 4))


def encode_tx(frames: Frames) -> str:
    """Return the text of a reply to TX, without its CRC."""
    lines = []
    for tool in frames.tools:
        where = tool.visibility.name
        if tool.visibility is NdiVisibility.VALID:
            numbers = [f"{round(component * 1e4):+06d}" for component in tool.quaternion]
            numbers += [f"{round(coordinate * 1e2):+07d}" for coordinate in tool.position_mm]
            where = "".join(numbers) + f"{round(tool.error_mm * 1e4):+06d}"
        status = "" if tool.port_status is None else f"{tool.port_status:08X}{tool.frame or 0:08X}"
        lines.append(f"{tool.handle:02X}{where}{status}\n")
    return f"{len(lines):02X}{''.join(lines)}{frames.system_status:04X}"


def _text_tool(match: re.Match[str]) -> ToolFrame:
    handle, word, quaternion, position, error, status, frame = match.groups()
    port_status = None if status is None else int(status, 16)
    number = None if frame is None else int(frame, 16)
    if word is not None:
        return ToolFrame(int(handle, 16), NdiVisibility[word], port_status=port_status, frame=number)
    w, x, y, z = (int(quaternion[at : at + 6]) * 1e-4 for at in range(0, 24, 6))
    px, py, pz = (int(position[at : at + 7]) * 1e-2 for at in range(0, 21, 7))
    return ToolFrame(
        int(handle, 16), NdiVisibility.VALID, (w, x, y, z), (px, py, pz), int(error) * 1e-4, port_status, number
    )


def _hexadecimal(text: str, digits: int) -> int:
    if len(text) != digits or not _HEX.fullmatch(text):
        raise ProtocolError(f"TX: {text[:20]!r} is not {digits} hexadecimal digits")
    return int(text, 16)


_WRAP = 1 << 32
_HARDWARE_FAILURE, _HARDWARE_CHANGE, _PLUGGED = 0x10, 0x20, 0xC0  # bits of the system status
_SOUND_PORT = 0x31 | 0x0E  # bits of the port status that are not faults: tool in port, initialised, enabled; switches


_RATE_S = 1.0  # time (s) after the first frame at which the frame rate is compared with `rate_hz`
_RATE_RATIO = 1.2  # ratio of the frame rate to `rate_hz` above which `rate_hz` is wrong


@dataclass(frozen=True)
class NdiPoseLimits(CallRepr):
    """Frame rate of the tracker, and limits above which a pose is SUSPECT or the tracker raises DeviceFault."""

    rate_hz: float = 40.0  # frame rate of the tracker, which converts frame numbers to times; it must be exact
    silence_s: float = 0.5  # time without a new frame after which the tracker raises DeviceFault
    reply_s: float = 12.0  # longest time from a command to its reply; then DeviceFault
    gap_s: float = 0.1  # pause between the bytes of a reply after which the reply counts as truncated
    late_s: float = 0.2  # time from a request to its reply above which the pose is SUSPECT (it may be outdated)
    damaged: int = 10  # number of damaged replies in succession at which the tracker raises DeviceFault
    most_error_mm: float = 1.0  # fit error above which a pose is SUSPECT
    step_mm: float = 5.0  # change of the position from one frame to the next above which a pose is SUSPECT
    norm_tolerance: float = 0.01  # deviation of the quaternion's length from one above which a pose is SUSPECT


class NdiPoseValidator(PoseValidator):
    """Validates the frames of the tool with the handle `handle`."""

    handle: int
    limits: NdiPoseLimits
    last: PoseSample | None

    def __init__(self, handle: int, limits: NdiPoseLimits) -> None:
        super().__init__()
        self.handle, self.limits = handle, limits
        self._first = True
        self._new_frame_ns = 0
        self._begun: tuple[int, int] | None = None
        self._rate_checked = False

    def validate(self, frames: Frames, now_ns: int, took_s: float = 0.0) -> PoseSample | None:
        """Return the sample of a new frame, or None if the frame is repeated.

        `took_s` is the time from the request to its reply. Raises DeviceFault if the tool is missing or disabled, if
        the tracker reports a hardware failure or plugged tools, if frame numbers go back, or after `silence_s` without
        a new frame.
        """
        self._check_system(frames.system_status)
        matching = [tool for tool in frames.tools if tool.handle == self.handle]
        if len(matching) != 1:
            raise DeviceFault(f"tracker: handle {self.handle:02X} occurs {len(matching)} times in the reply")
        tool = matching[0]
        if tool.visibility in (NdiVisibility.DISABLED, NdiVisibility.UNOCCUPIED) or tool.frame is None:
            raise DeviceFault(
                f"tracker: the tool with handle {self.handle:02X} is {tool.visibility} in the middle of the run"
            )
        lost = 0
        if self.last is not None:
            ahead = (tool.frame - self.last.stamp.sequence) % _WRAP
            if ahead == 0:
                self._check_progress(now_ns - round(took_s * 1e9))
                return None
            if ahead >= _WRAP // 2:
                raise DeviceFault("tracker: its frame number went back: it was restarted")
            lost = ahead - 1
        self._check_rate(tool.frame, now_ns)
        stamp = Stamp(now_ns, tool.frame, lost, tool.frame / self.limits.rate_hz)
        notes = _bits_of(frames.system_status, _SYSTEM_SUSPECT)
        if took_s > self.limits.late_s:
            notes += (f"the reply took {took_s:.3g} s",)
        self.last, self._new_frame_ns = self._sample(tool, stamp, notes), now_ns
        return self.last

    def _check_rate(self, frame: int, now_ns: int) -> None:
        """Compare the frame rate of the first second with `rate_hz`, and raise DeviceFault if the frames come faster.

        The age of a pose is computed from its frame number, and would be too small. Frames that come more slowly look
        old, and are refused by the guard.
        """
        if self._begun is None:
            self._begun = frame, now_ns
        passed_s = (now_ns - self._begun[1]) / 1e9
        if self._rate_checked or passed_s < _RATE_S:
            return
        self._rate_checked = True
        rate_hz = ((frame - self._begun[0]) % _WRAP) / passed_s
        if rate_hz > _RATE_RATIO * self.limits.rate_hz:
            raise DeviceFault(
                f"tracker: its frames come at {rate_hz:.3g} Hz instead of {self.limits.rate_hz:g} Hz: "
                "state its frame rate as rate_hz in its address"
            )

    def _check_progress(self, asked_ns: int) -> None:
        still_s = (asked_ns - self._new_frame_ns) / 1e9
        if still_s > self.limits.silence_s:
            raise DeviceFault(f"tracker: no new frame for {still_s:.3g} s: it has stopped tracking")

    def _check_system(self, status: int) -> None:
        first, self._first = self._first, False
        if status & _HARDWARE_FAILURE:
            raise DeviceFault(f"tracker: hardware failure (system status {status:04X})")
        # The first reply reports tools plugged in before the start. A later change is a fault, because the handle may
        # then belong to another tool.
        if not first and status & (_PLUGGED | _HARDWARE_CHANGE):
            raise DeviceFault(
                f"tracker: tools were plugged in or out (system status {status:04X}): is it the same tool?"
            )

    def _sample(self, tool: ToolFrame, stamp: Stamp, notes: tuple[str, ...]) -> PoseSample:
        limits, port = self.limits, tool.port_status or 0
        notes += _bits_of(port, _PORT_SUSPECT)
        if unknown := port & ~_SOUND_PORT & ~sum(_PORT_SUSPECT):
            notes += (f"port status {unknown:08X}",)
        if tool.visibility is NdiVisibility.MISSING:
            return self.missing(stamp, "not seen", notes)
        norm = math.sqrt(math.fsum(component * component for component in tool.quaternion))
        if not self.are_plausible((*tool.position_mm, tool.error_mm, norm)) or norm < 0.5:
            return self.missing(stamp, "not a pose", notes)
        if abs(norm - 1) > limits.norm_tolerance:
            notes += (f"quaternion of length {norm:.3g}",)
        if tool.error_mm > limits.most_error_mm:
            notes += (f"fit error {tool.error_mm:.3g} mm",)
        frames = 1 if self.last is None else (stamp.sequence - self.last.stamp.sequence) % _WRAP
        w, x, y, z = (component / norm for component in tool.quaternion)
        return self.sample(stamp, tool.position_mm, (w, x, y, z), tool.error_mm, notes, limits.step_mm * frames)
