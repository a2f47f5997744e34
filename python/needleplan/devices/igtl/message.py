"""OpenIGTLink messages as bytes: a header of 58 bytes, and from header version 2 on an extended header and metadata.

Numbers are big-endian, texts padded with zeros. Nothing here reads or writes anything.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from needleplan.devices.igtl.crc import crc64
from needleplan.errors import InputError, Mistake, ProtocolError

__all__ = [
    "HEADER_BYTES",
    "Header",
    "Message",
    "decode_body",
    "decode_header",
    "encode_message",
    "padded",
    "stamp_of",
    "text_of",
]

HEADER_BYTES = 58

_HEADER = struct.Struct(">H12s20sQQQ")
_EXTENDED = struct.Struct(">HHII")
_ENTRY = struct.Struct(">HHI")
_KIND = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_")
_ASCII, _UTF8 = 3, 106
_FRACTION = 1 << 32


@dataclass(frozen=True)
class Header:
    """What the first 58 bytes say. `timestamp` counts seconds since 1970 in units of 2**-32; 0 where there is none."""

    version: int
    kind: str
    device: str
    timestamp: int
    body_bytes: int
    crc: int


@dataclass(frozen=True)
class Message:
    """One message: `content` is what its `kind` (TRANSFORM, STATUS) defines. Metadata need `version` 2."""

    kind: str
    device: str
    content: bytes = b""
    timestamp: int = 0
    version: int = 1
    message_id: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def time_s(self) -> float | None:
        """The sender's time in seconds since 1970, where it gave one."""
        return self.timestamp / _FRACTION if self.timestamp else None


def stamp_of(time_s: float) -> int:
    """Return a time in seconds since 1970 as a timestamp."""
    return round(time_s * _FRACTION)


def encode_message(message: Message) -> bytes:
    """Return the bytes of `message`. Raises InputError where a name is too long, or metadata have no place."""
    if message.version < 2 and (message.metadata or message.message_id):
        raise InputError(Mistake("version", str(message.version), "must be 2 for metadata and message numbers"))
    body = message.content if message.version < 2 else _extended(message)
    kind, device = padded(message.kind, 12, "message type"), padded(message.device, 20, "device name")
    return _HEADER.pack(message.version, kind, device, message.timestamp, len(body), crc64(body)) + body


def decode_header(data: bytes) -> Header:
    """Return what a header says. Raises ProtocolError where these 58 bytes can be none."""
    version, kind, device, timestamp, body_bytes, crc = _HEADER.unpack(data)
    name = kind.rstrip(b"\0")
    if version not in (1, 2, 3) or not name or not _KIND.issuperset(name):
        raise ProtocolError("OpenIGTLink: not a header")
    return Header(version, name.decode("ascii"), text_of(device), timestamp, body_bytes, crc)


def decode_body(header: Header, body: bytes) -> Message:
    """Return the message of a header and its body. Raises ProtocolError for a wrong checksum or wrong lengths."""
    if len(body) != header.body_bytes or crc64(body) != header.crc:
        raise ProtocolError(f"OpenIGTLink: {header.kind} {header.device!r} with a wrong checksum")
    if header.version < 2:
        return Message(header.kind, header.device, body, header.timestamp, header.version)
    if len(body) < _EXTENDED.size:
        raise ProtocolError(f"OpenIGTLink: {header.kind} without its extended header")
    size, index_bytes, metadata_bytes, number = _EXTENDED.unpack_from(body)
    end = len(body) - index_bytes - metadata_bytes
    if not _EXTENDED.size <= size <= end:
        raise ProtocolError(f"OpenIGTLink: the extended header of {header.kind} names lengths that it does not have")
    metadata = _metadata(body[end : end + index_bytes], body[end + index_bytes :])
    return Message(header.kind, header.device, body[size:end], header.timestamp, header.version, number, metadata)


def padded(text: str, length: int, what: str) -> bytes:
    """Return `text` with zeros up to `length`. Raises InputError where it is longer."""
    data = text.encode()
    if len(data) > length or b"\0" in data:
        raise InputError(Mistake(what, text, f"must have at most {length} bytes, none of them zero"))
    return data.ljust(length, b"\0")


def text_of(data: bytes) -> str:
    """Return a padded text; bytes that are no text come as question marks in a diamond."""
    return data.split(b"\0", 1)[0].decode("utf-8", "replace")


def _extended(message: Message) -> bytes:
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
        raise ProtocolError("OpenIGTLink: the index of the metadata has another length than it says")
    found, at = {}, 0
    for key_bytes, _, value_bytes in _ENTRY.iter_unpack(index[2:]):
        middle, end = at + key_bytes, at + key_bytes + value_bytes
        if end > len(texts):
            raise ProtocolError("OpenIGTLink: metadata cut short")
        found[texts[at:middle].decode("utf-8", "replace")] = texts[middle:end].decode("utf-8", "replace")
        at = end
    return found
