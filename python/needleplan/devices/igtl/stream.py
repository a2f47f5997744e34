"""Whole messages out of a stream of bytes that may be damaged, cut short, or begin in the middle.

Only messages with the right checksum come out. What can be none is dropped and counted, and the search goes on one byte
further, so that a whole message behind a damaged one is found. Memory is taken for what has come, never for what a
length promises; a length that its kind of message cannot have is damage.
"""

from __future__ import annotations

from collections.abc import Collection

from needleplan.devices.igtl.message import HEADER_BYTES, Header, Message, decode_body, decode_header
from needleplan.errors import ProtocolError

__all__ = ["MessageReader"]

_LONGEST_POSE = 1 << 16
_POSES = frozenset({"TRANSFORM", "POSITION", "TDATA", "QTDATA", "STATUS", "SENSOR"})
_QUERIES = ("GET_", "STT_", "STP_", "RTS_")


class MessageReader:
    """Feed it bytes; it gives messages. Of kinds that are not `wanted` the bodies are passed over as they come.

    `longest` is the longest body, in bytes, that is believed.
    """

    def __init__(self, wanted: Collection[str] | None = None, longest: int = 1 << 24) -> None:
        self.wanted, self.longest = wanted, longest
        self.damaged_bytes = 0
        """Bytes that belonged to no message with a right checksum."""

        self.damaged = 0
        """Messages whose header was plausible, and whose body was not."""

        self.skipped = 0
        """Messages of kinds that nobody wants; their checksums are not looked at."""

        self._buffer = bytearray()
        self._at = 0
        self._header: Header | None = None
        self._to_skip = 0

    @property
    def pending(self) -> int:
        """Bytes that wait for the rest of their message."""
        return len(self._buffer) - self._at

    def feed(self, data: bytes) -> None:
        """Add what came."""
        del self._buffer[: self._at]
        self._at = 0
        passed_over = min(self._to_skip, len(data))
        self._to_skip -= passed_over
        self._buffer += data[passed_over:]

    def clear(self) -> None:
        """Give up on the rest of a message."""
        self.damaged_bytes += self.pending
        self._buffer.clear()
        self._at = self._to_skip = 0
        self._header = None

    def next(self) -> Message | None:
        """Return the next whole message, or None where more bytes are needed."""
        while self._header is not None or self._find_header():
            header = self._header
            assert header is not None
            begin = self._at + HEADER_BYTES
            if self.wanted is not None and header.kind not in self.wanted:
                self._pass_over(begin + header.body_bytes)
                continue
            if len(self._buffer) - begin < header.body_bytes:
                return None
            self._header = None
            try:
                message = decode_body(header, bytes(self._buffer[begin : begin + header.body_bytes]))
            except ProtocolError:
                self.damaged += 1
                self._drop()
                continue
            self._at = begin + header.body_bytes
            return message
        return None

    def _find_header(self) -> bool:
        """Go on to the next bytes that can be a header; whether there are some."""
        while self.pending >= HEADER_BYTES:
            # Both bytes of the version are looked at before anything is unpacked: noise must not take long.
            if self._buffer[self._at] or self._buffer[self._at + 1] not in (1, 2, 3):
                self._drop()
                continue
            try:
                header = decode_header(bytes(self._buffer[self._at : self._at + HEADER_BYTES]))
            except ProtocolError:
                self._drop()
                continue
            if header.body_bytes <= self._believed(header.kind):
                self._header = header
                return True
            self.damaged += 1
            self._drop()
        return False

    def _believed(self, kind: str) -> int:
        short = kind in _POSES or kind.startswith(_QUERIES)
        return min(self.longest, _LONGEST_POSE) if short else self.longest

    def _pass_over(self, end: int) -> None:
        self.skipped += 1
        self._header = None
        self._to_skip = max(end - len(self._buffer), 0)
        self._at = min(end, len(self._buffer))

    def _drop(self) -> None:
        self.damaged_bytes += 1
        self._at += 1
