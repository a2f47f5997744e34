"""Frames of a serial line to a robot, each of which carries one datagram.

The content of a frame is the number of the sender, its complement, and the datagram. It is stuffed by COBS (Cheshire
and Baker, "Consistent overhead byte stuffing", 1999), so that no byte of it is 0, and stands between two bytes 0. An
answer and a status carry the number of their recipient.
"""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["Unframer", "framed"]

_LONGEST = 112  # bytes of the longest datagram: HELLO with a tag
_MOST = 3 + _LONGEST  # bytes between two bytes 0: code of COBS, sender and its complement, datagram


def framed(sender: int, datagram: bytes) -> bytes:
    """Return the frame of a datagram of at most 112 bytes; `sender` is from 0 to 255."""
    content = bytes((sender, sender ^ 0xFF)) + datagram
    return b"\0" + b"".join(bytes([len(part) + 1]) + part for part in content.split(b"\0")) + b"\0"


class Unframer:
    """Finds frames in the bytes of a line; `damaged` counts what stands between two bytes 0 and is no frame."""

    def __init__(self) -> None:
        self._rest = b""
        self.damaged: int = 0

    def take(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Take the next bytes of the line; yield sender and datagram of each frame that they complete."""
        *contents, rest = (self._rest + data).split(b"\0")
        self._rest = rest[: _MOST + 1]
        for stuffed in filter(None, contents):
            content = _unstuffed(stuffed)
            if len(content) >= 2 and content[0] == content[1] ^ 0xFF:
                yield content[0], content[2:]
            else:
                self.damaged += 1


def _unstuffed(stuffed: bytes) -> bytes:
    """Return the content of bytes that COBS has stuffed; b"" if it has not, or if they are too many."""
    if len(stuffed) > _MOST:
        return b""
    parts, at = [], 0
    while at < len(stuffed):
        parts.append(stuffed[at + 1 : at + stuffed[at]])
        at += stuffed[at]
    return b"\0".join(parts) if at == len(stuffed) else b""
