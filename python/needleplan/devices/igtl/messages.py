"""Encoding of OpenIGTLink messages, and their extraction from a stream of bytes.

A message has a header of 58 bytes and a body. From header version 2 on, the body begins with an extended header and
ends with metadata. Numbers are big-endian, texts are padded with zeros, and the checksum is the CRC-64 of ECMA-182.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache, reduce
from operator import xor

import numpy as np
import numpy.typing as npt

from needleplan.artifacts import CallRepr
from needleplan.errors import InputError, Mistake, ProtocolError

__all__ = [
    "HEADER_BYTES",
    "Header",
    "IgtlMessage",
    "MessageReader",
    "crc64",
    "decode_body",
    "decode_header",
    "encode_message",
    "padded",
    "stamp_of",
    "text_of",
]

_POLYNOMIAL = 0x42F0E1EBA9EA3693
_MASK = (1 << 64) - 1
_BLOCK = 256  # bytes that `crc64` processes in one step; shorter data are processed byte by byte


def crc64(data: bytes) -> int:
    """Return the CRC-64 of `data` according to ECMA-182: highest bit first, initial value 0, not inverted."""
    if len(data) < _BLOCK:
        register = 0
        for byte in data:
            register = (register << 8) & _MASK ^ _TABLE[register >> 56 ^ byte]
        return register
    # The checksum is linear: the contribution of a byte depends only on its value and position. Leading zeros add 0.
    places, heads = _contributions()
    blocks = np.frombuffer(bytes(-len(data) % _BLOCK) + data, dtype=np.uint8).reshape(-1, _BLOCK)
    register = 0
    for part in np.bitwise_xor.reduce(places[np.arange(_BLOCK), blocks], axis=1).tolist():
        register = reduce(xor, (head[byte] for head, byte in zip(heads, register.to_bytes(8), strict=True)), part)
    return register


def _of_byte(byte: int) -> int:
    register = byte << 56
    for _ in range(8):
        register = (register << 1) & _MASK ^ (_POLYNOMIAL if register >> 63 else 0)
    return register


_TABLE = [_of_byte(byte) for byte in range(256)]


@cache
def _contributions() -> tuple[npt.NDArray[np.uint64], list[list[int]]]:
    """Return the contribution to the CRC of each byte value at each position of a block, shape (256, 256).

    The second value holds the rows of the first eight positions as lists.
    """
    rows = [_TABLE]
    while len(rows) < _BLOCK:
        rows.append([(code << 8) & _MASK ^ _TABLE[code >> 56] for code in rows[-1]])
    rows.reverse()
    return np.array(rows, dtype=np.uint64), rows[:8]


HEADER_BYTES = 58

_HEADER = struct.Struct(">H12s20sQQQ")
_EXTENDED = struct.Struct(">HHII")
_ENTRY = struct.Struct(">HHI")
_KIND = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_")
_ASCII, _UTF8 = 3, 106
_FRACTION = 1 << 32


@dataclass(frozen=True)
class Header:
    """Fields of a message header; `timestamp` is the time since 1970 in units of 2**-32 s, 0 if absent."""

    version: int
    kind: str
    device: str
    timestamp: int
    body_bytes: int
    crc: int


@dataclass(frozen=True)
class IgtlMessage(CallRepr):
    """One message; `content` is its body without extended header and metadata. Metadata need `version` 2."""

    kind: str
    device: str
    content: bytes = b""
    timestamp: int = 0
    version: int = 1
    message_id: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def time_s(self) -> float | None:
        """Time of the message on the sender's clock in seconds since 1970, or None if absent."""
        return self.timestamp / _FRACTION if self.timestamp else None


def stamp_of(time_s: float) -> int:
    """Convert a time in seconds since 1970 to a timestamp in units of 2**-32 s."""
    return round(time_s * _FRACTION)


def encode_message(message: IgtlMessage) -> bytes:
    """Return the bytes of `message`.

    Raises InputError if a name is too long, if there are too many metadata, or if a message of version 1 has metadata
    or a message number.
    """
    if message.version < 2 and (message.metadata or message.message_id):
        raise InputError(Mistake("version", str(message.version), "must be 2 for metadata and message numbers"))
    body = message.content if message.version < 2 else _extended(message)
    kind, device = padded(message.kind, 12, "message type"), padded(message.device, 20, "device name")
    return _HEADER.pack(message.version, kind, device, message.timestamp, len(body), crc64(body)) + body


def decode_header(data: bytes) -> Header:
    """Return the header in `data`, which has 58 bytes. Raises ProtocolError if it is not a plausible header."""
    version, kind, device, timestamp, body_bytes, crc = _HEADER.unpack(data)
    name = kind.rstrip(b"\0")
    if version not in (1, 2, 3) or not name or not _KIND.issuperset(name):
        raise ProtocolError("OpenIGTLink: the bytes are not a header")
    return Header(version, name.decode("ascii"), text_of(device), timestamp, body_bytes, crc)


def decode_body(header: Header, body: bytes, *, needs_crc: bool = True) -> IgtlMessage:
    """Return the message with the given header and body. Raises ProtocolError if checksum or lengths are wrong.

    If not `needs_crc`, a checksum of 0 stands for none: some servers leave it out.
    """
    is_absent = header.crc == 0 and not needs_crc
    if len(body) != header.body_bytes or not (is_absent or crc64(body) == header.crc):
        raise ProtocolError(f"OpenIGTLink: {header.kind} {header.device!r} has a wrong checksum")
    if header.version < 2:
        return IgtlMessage(header.kind, header.device, body, header.timestamp, header.version)
    if len(body) < _EXTENDED.size:
        raise ProtocolError(f"OpenIGTLink: {header.kind} has no extended header")
    size, index_bytes, metadata_bytes, number = _EXTENDED.unpack_from(body)
    end = len(body) - index_bytes - metadata_bytes
    if not _EXTENDED.size <= size <= end:
        raise ProtocolError(f"OpenIGTLink: the extended header of {header.kind} has lengths beyond the message")
    metadata = _metadata(body[end : end + index_bytes], body[end + index_bytes :])
    return IgtlMessage(header.kind, header.device, body[size:end], header.timestamp, header.version, number, metadata)


def padded(text: str, length: int, what: str) -> bytes:
    """Return `text` in UTF-8, padded with zeros to `length` bytes.

    Raises InputError, which names `what`, if the text is longer or contains a zero.
    """
    data = text.encode()
    if len(data) > length or b"\0" in data:
        raise InputError(Mistake(what, text, f"must have at most {length} bytes, none of them zero"))
    return data.ljust(length, b"\0")


def text_of(data: bytes) -> str:
    """Return the text before the first zero in `data`; bytes that are not UTF-8 become U+FFFD."""
    return data.split(b"\0", 1)[0].decode("utf-8", "replace")


def _extended(message: IgtlMessage) -> bytes:
    keys = [key.encode() for key in message.metadata]
    values = [value.encode() for value in message.metadata.values()]
    if any(len(key) > 0xFFFF for key in keys) or len(keys) > 0x1FFE:
        raise InputError(
            Mistake("metadata", str(len(keys)), "must be fewer than 8191, with keys of at most 65535 bytes")
        )
    index = struct.pack(">H", len(keys))
    for key, value in zip(keys, values, strict=True):
        index += _ENTRY.pack(len(key), _ASCII if value.isascii() else _UTF8, len(value))
    texts = b"".join(key + value for key, value in zip(keys, values, strict=True))
    head = _EXTENDED.pack(_EXTENDED.size, len(index), len(texts), message.message_id)
    return head + message.content + index + texts


def _metadata(index: bytes, texts: bytes) -> dict[str, str]:
    if not index:
        return {}
    count = int.from_bytes(index[:2])
    if len(index) != 2 + count * _ENTRY.size:
        raise ProtocolError("OpenIGTLink: the index of the metadata has a wrong length")
    found, at = {}, 0
    for key_bytes, _, value_bytes in _ENTRY.iter_unpack(index[2:]):
        middle, end = at + key_bytes, at + key_bytes + value_bytes
        if end > len(texts):
            raise ProtocolError("OpenIGTLink: the metadata are truncated")
        found[texts[at:middle].decode("utf-8", "replace")] = texts[middle:end].decode("utf-8", "replace")
        at = end
    return found


_LONGEST_POSE = 1 << 16  # largest accepted body (bytes) of the kinds in `_POSES` and of queries
_POSES = frozenset({"TRANSFORM", "POSITION", "TDATA", "QTDATA", "STATUS", "SENSOR"})
_QUERIES = ("GET_", "STT_", "STP_", "RTS_")


class MessageReader:
    """Extracts messages from a stream of bytes that may be damaged, truncated, or begin in the middle of a message.

    Only messages with a correct checksum are returned; if not `needs_crc`, also those with the checksum 0. After a
    damaged message, the search continues at its second byte, so that a correct message behind it is found. A body of
    more than `longest` bytes counts as damaged. Messages whose kind is not in `wanted` are skipped; None means that all
    kinds are wanted. Memory is allocated only for received bytes, never for an announced length.
    """

    wanted: Collection[str] | None
    longest: int

    def __init__(
        self, wanted: Collection[str] | None = None, longest: int = 1 << 24, *, needs_crc: bool = True
    ) -> None:
        self.wanted, self.longest, self._needs_crc = wanted, longest, needs_crc
        self.damaged_bytes: int = 0
        """Number of discarded bytes, which belong to no correct message."""

        self.damaged: int = 0
        """Number of messages with a plausible header but a damaged or too long body."""

        self.skipped: int = 0
        """Number of skipped messages of unwanted kinds; their checksums are not verified."""

        self._buffer = bytearray()
        self._at = 0
        self._header: Header | None = None
        self._to_skip = 0

    @property
    def pending(self) -> int:
        """Number of received bytes that are not yet extracted."""
        return len(self._buffer) - self._at

    def feed(self, data: bytes) -> None:
        """Append received bytes to the stream."""
        del self._buffer[: self._at]
        self._at = 0
        passed_over = min(self._to_skip, len(data))
        self._to_skip -= passed_over
        self._buffer += data[passed_over:]

    def clear(self) -> None:
        """Discard all received bytes that are not yet extracted."""
        self.damaged_bytes += self.pending
        self._buffer.clear()
        self._at = self._to_skip = 0
        self._header = None

    def next(self) -> IgtlMessage | None:
        """Return the next complete message, or None if more bytes must be received first."""
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
                body = bytes(self._buffer[begin : begin + header.body_bytes])
                message = decode_body(header, body, needs_crc=self._needs_crc)
            except ProtocolError:
                self.damaged += 1
                self._drop()
                continue
            self._at = begin + header.body_bytes
            return message
        return None

    def _find_header(self) -> bool:
        """Advance to the next plausible header and store it; return False if none is found in the received bytes."""
        while self.pending >= HEADER_BYTES:
            # The version is checked before the header is decoded, so that noise is skipped quickly.
            if self._buffer[self._at] or self._buffer[self._at + 1] not in (1, 2, 3):
                self._drop()
                continue
            try:
                header = decode_header(bytes(self._buffer[self._at : self._at + HEADER_BYTES]))
            except ProtocolError:
                self._drop()
                continue
            if header.body_bytes <= self._longest_body(header.kind):
                self._header = header
                return True
            self.damaged += 1
            self._drop()
        return False

    def _longest_body(self, kind: str) -> int:
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
