"""The reply to BX: binary, little-endian, with a CRC for its header and one for its body.

Start 0xA5C4, length of the body, CRC of these four bytes; then the body and its CRC. A header with its CRC leaves the
CRC register at zero, so that the CRC over the whole message is that over the body.
"""

from __future__ import annotations

import struct

from needleplan.devices.ndi.crc import crc16
from needleplan.devices.ndi.frames import Frames, Seen, ToolFrame
from needleplan.errors import ProtocolError

__all__ = ["HEADER_BYTES", "START", "body_length", "encode_bx", "parse_bx"]

START = b"\xc4\xa5"
HEADER_BYTES = 6

_TRANSFORM = struct.Struct("<8f")
_STATUS = struct.Struct("<II")
_SEEN = {0x01: Seen.VALID, 0x02: Seen.MISSING, 0x04: Seen.DISABLED}
_CODES = {seen: code for code, seen in _SEEN.items()}


def body_length(header: bytes) -> int:
    """Return the length of the body behind a header of six bytes. Raises ProtocolError."""
    if len(header) != HEADER_BYTES or header[:2] != START:
        raise ProtocolError("BX: does not begin with C4 A5")
    if crc16(header):
        raise ProtocolError("BX: wrong CRC of the header")
    return int.from_bytes(header[2:4], "little")


def parse_bx(message: bytes) -> Frames:
    """Read a whole reply to BX:0001 or BX:0801. Raises ProtocolError."""
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
    """Return a whole reply to BX."""
    body = bytearray([len(frames.tools)])
    for tool in frames.tools:
        body += bytes([tool.handle, _CODES.get(tool.seen, _CODES[Seen.DISABLED])])
        if tool.seen is Seen.VALID:
            body += _TRANSFORM.pack(*tool.quaternion, *tool.position_mm, tool.error_mm)
        if tool.seen in (Seen.VALID, Seen.MISSING):
            body += _STATUS.pack(tool.port_status or 0, tool.frame or 0)
    body += frames.system_status.to_bytes(2, "little")
    header = START + len(body).to_bytes(2, "little")
    return header + crc16(header).to_bytes(2, "little") + bytes(body) + crc16(bytes(body)).to_bytes(2, "little")


def _tool(body: bytes, position: int) -> tuple[ToolFrame, int]:
    handle, code = body[position], body[position + 1]
    position += 2
    if code not in _SEEN:
        raise ProtocolError(f"BX: handle status {code:02X} is not known")
    seen = _SEEN[code]
    if seen is Seen.DISABLED:
        return ToolFrame(handle, seen), position
    values: tuple[float, ...] = ()
    if seen is Seen.VALID:
        values = _TRANSFORM.unpack_from(body, position)
        position += _TRANSFORM.size
    port_status, frame = _STATUS.unpack_from(body, position)
    position += _STATUS.size
    if not values:
        return ToolFrame(handle, seen, port_status=port_status, frame=frame), position
    w, x, y, z, px, py, pz, error_mm = values
    return ToolFrame(handle, seen, (w, x, y, z), (px, py, pz), error_mm, port_status, frame), position
