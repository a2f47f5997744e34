"""Whole replies out of bytes that come in pieces, and may be damaged, cut short or mixed with noise.

Only replies with the right CRC come out. What cannot be one is dropped and counted; the search goes on one byte
further, so that a whole reply behind a damaged one is found.
"""

from __future__ import annotations

from needleplan.devices.ndi.bx import HEADER_BYTES, START, body_length
from needleplan.devices.ndi.crc import crc16
from needleplan.errors import ProtocolError

__all__ = ["ReplyReader"]

_LONGEST_TEXT = 16_384
_TEXT = frozenset(range(0x20, 0x7F)) | {0x0A}


class ReplyReader:
    """Feed it bytes; it gives text replies as `str` without CRC, and binary ones as `bytes` with header and CRC."""

    def __init__(self) -> None:
        self.damaged = 0
        """Bytes that belonged to no reply with a right CRC."""

        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Bytes that wait for the rest of their reply."""
        return len(self._buffer)

    def feed(self, data: bytes) -> None:
        """Add what came."""
        self._buffer += data

    def clear(self) -> None:
        """Give up on the rest of a reply."""
        self._drop(len(self._buffer))

    def next(self) -> str | bytes | None:
        """Return the next whole reply, or None where more bytes are needed."""
        reply: str | bytes | None
        while self._buffer:
            if self._buffer[0] == START[0]:
                reply, more = self._binary()
            else:
                reply, more = self._text()
            if reply is not None or more:
                return reply
        return None

    def _drop(self, count: int) -> None:
        self.damaged += count
        del self._buffer[:count]

    def _binary(self) -> tuple[bytes | None, bool]:
        """Return a reply, and whether bytes are missing; neither where the first byte is none of a reply."""
        buffer = self._buffer
        if len(buffer) < HEADER_BYTES:
            if buffer[1:2] in (b"", START[1:]):
                return None, True
            self._drop(1)
            return None, False
        try:
            end = HEADER_BYTES + body_length(bytes(buffer[:HEADER_BYTES])) + 2
        except ProtocolError:
            self._drop(1)
            return None, False
        if len(buffer) < end:
            return None, True
        message = bytes(buffer[:end])
        if crc16(message[:-2]) != int.from_bytes(message[-2:], "little"):
            self._drop(1)
            return None, False
        del buffer[:end]
        return message, False

    def _text(self) -> tuple[str | None, bool]:
        line = bytes(self._buffer)
        length = len(line) - len(line.lstrip(bytes(_TEXT)))
        if length == len(line):
            if length > _LONGEST_TEXT:
                self._drop(length)
            return None, length <= _LONGEST_TEXT
        if line[length] != 0x0D:
            self._drop(max(length, 1))
            return None, False
        text, crc = line[: max(length - 4, 0)], line[max(length - 4, 0) : length]
        if not text or crc.upper() != b"%04X" % crc16(text):
            self._drop(length + 1)
            return None, False
        del self._buffer[: length + 1]
        return text.decode("ascii"), False
