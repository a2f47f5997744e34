"""The reply to TX: text, with numbers of fixed width.

`NN` tools; for each its handle, then `MISSING`, `DISABLED`, `UNOCCUPIED` or 51 characters of transform, port status,
frame number and a line feed; at the end the system status.
"""

from __future__ import annotations

import re

from needleplan.devices.ndi.frames import Frames, Seen, ToolFrame
from needleplan.errors import ProtocolError

__all__ = ["encode_tx", "parse_tx"]

_TOOL = re.compile(
    r"([0-9A-F]{2})(?:(MISSING|DISABLED|UNOCCUPIED)|((?:[+-]\d{5}){4})((?:[+-]\d{6}){3})([+-]\d{5}))"
    r"(?:([0-9A-F]{8})([0-9A-F]{8}))?\n"
)
_HEX = re.compile(r"[0-9A-F]+")


def parse_tx(text: str) -> Frames:
    """Read a reply to TX:0001 or TX:0801, without its CRC. Raises ProtocolError."""
    count = _hexadecimal(text[:2], 2)
    tools, position = [], 2
    for _ in range(count):
        match = _TOOL.match(text, position)
        if match is None:
            raise ProtocolError(f"TX: no tool at character {position} of {len(text)}")
        tools.append(_tool(match))
        position = match.end()
    return Frames(tuple(tools), _hexadecimal(text[position:], 4))


def encode_tx(frames: Frames) -> str:
    """Return a reply to TX, without its CRC."""
    lines = []
    for tool in frames.tools:
        where = tool.seen.name
        if tool.seen is Seen.VALID:
            numbers = [f"{round(each * 1e4):+06d}" for each in tool.quaternion]
            numbers += [f"{round(each * 1e2):+07d}" for each in tool.position_mm]
            where = "".join(numbers) + f"{round(tool.error_mm * 1e4):+06d}"
        status = "" if tool.port_status is None else f"{tool.port_status:08X}{tool.frame or 0:08X}"
        lines.append(f"{tool.handle:02X}{where}{status}\n")
    return f"{len(lines):02X}{''.join(lines)}{frames.system_status:04X}"


def _tool(match: re.Match[str]) -> ToolFrame:
    handle, word, quaternion, position, error, status, frame = match.groups()
    port_status = None if status is None else int(status, 16)
    number = None if frame is None else int(frame, 16)
    if word is not None:
        return ToolFrame(int(handle, 16), Seen[word], port_status=port_status, frame=number)
    w, x, y, z = (int(quaternion[at : at + 6]) * 1e-4 for at in range(0, 24, 6))
    px, py, pz = (int(position[at : at + 7]) * 1e-2 for at in range(0, 21, 7))
    return ToolFrame(int(handle, 16), Seen.VALID, (w, x, y, z), (px, py, pz), int(error) * 1e-4, port_status, number)


def _hexadecimal(text: str, digits: int) -> int:
    if len(text) != digits or not _HEX.fullmatch(text):
        raise ProtocolError(f"TX: {text[:20]!r} is not {digits} hexadecimal digits")
    return int(text, 16)
