"""Reads whatever can be read of a recording, whole or not: chunk by chunk, each by its own checksum."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from needleplan.recording.mcap.journal import SESSION

__all__ = ["Damage", "Definitions", "RawMessage", "chunks", "definitions_of", "messages_of"]

LARGEST_CHUNK = 256 * 2**20
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")
_CANDIDATE = re.compile(rb"\x06[\s\S]{5}\0\0\0")
_OPCODES = frozenset(Opcode)

RawMessage = tuple[int, int, int, bytes]
"""Number of the channel, sequence, time (ns), data."""


@dataclass
class Damage:
    """What could not be read."""

    damaged_bytes: int = 0
    places: int = 0


@dataclass
class Definitions:
    """What is said about the channels, and the session."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    session: dict[str, Any] | None = None


def chunks(data: Any, damage: Damage) -> Iterator[bytes]:
    """Yield the records of every chunk that agrees with its checksum, and definitions outside of chunks.

    `data` is bytes or a memory map. Bytes that belong to nothing are counted in `damage`, and the next chunk
    is searched for.
    """
    size = len(data)
    at = len(MCAP0_MAGIC) if data[: len(MCAP0_MAGIC)] == MCAP0_MAGIC else 0
    while at < size:
        found = _chunk_at(data, at)
        if found:
            content, at = found
            yield content
            continue
        following = _skipped(data, at)
        if following:
            if data[at] in (Opcode.SCHEMA, Opcode.CHANNEL):  # a finished recording repeats them at its end
                yield bytes(data[at:following])
            at = following
            continue
        lost_from = at
        at = _next_chunk(data, at + 1)
        damage.damaged_bytes += at - lost_from
        damage.places += 1


def definitions_of(content: bytes, known: Definitions) -> None:
    """Add what the records of a chunk define; what came first holds.

    A topic has one channel: what repeats it under another number at the end, where no checksum is, was damaged.
    """
    for opcode, body in _records(content):
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(ReadDataStream(BytesIO(body)))
            known.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = records.Channel.read(ReadDataStream(BytesIO(body)))
            if channel.topic not in {each.topic for each in known.channels.values()}:
                known.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.MESSAGE and known.session is None:
            number = _MESSAGE.unpack_from(body)[0]
            channel_of = known.channels.get(number)
            if channel_of is not None and channel_of.topic == "/session":
                known.session = SESSION.decode(body[_MESSAGE.size :])


def messages_of(content: bytes) -> Iterator[RawMessage]:
    """Yield the messages of the records of a chunk."""
    for opcode, body in _records(content):
        if opcode == Opcode.MESSAGE:
            number, sequence, time_ns, _ = _MESSAGE.unpack_from(body)
            yield number, sequence, time_ns, body[_MESSAGE.size :]


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(content):
        opcode, length = _HEAD.unpack_from(content, at)
        at += _HEAD.size
        yield opcode, content[at : at + length]
        at += length


def _chunk_at(data: Any, at: int) -> tuple[bytes, int] | None:
    """Return the records of the chunk at a place and where it ends, or None where there is no whole chunk."""
    body = at + _HEAD.size
    if body + _CHUNK.size + 8 > len(data):
        return None
    opcode, length = _HEAD.unpack_from(data, at)
    end = body + length
    if opcode != Opcode.CHUNK or end > len(data) or length > LARGEST_CHUNK:
        return None
    _, _, size, checksum, name_length = _CHUNK.unpack_from(data, body)
    start = body + _CHUNK.size + name_length + 8
    if name_length > 4 or start > end or size > LARGEST_CHUNK:
        return None
    if struct.unpack_from("<Q", data, start - 8)[0] != end - start:
        return None
    content = _unpacked(bytes(data[start - 8 - name_length : start - 8]), bytes(data[start:end]), size)
    if content is None or zlib.crc32(content) != checksum:
        return None
    return content, end


def _unpacked(compression: bytes, stored: bytes, size: int) -> bytes | None:
    if compression == b"":
        return stored
    if compression != b"zstd":
        return None
    import zstandard

    try:
        if zstandard.frame_content_size(stored) != size:
            return None
        return bytes(zstandard.decompress(stored, size))
    except (zstandard.ZstdError, MemoryError):
        return None


def _skipped(data: Any, at: int) -> int | None:
    """Return where the record at a place ends if it is none of a chunk and something plausible follows, or None."""
    if data[at : at + len(MCAP0_MAGIC) + 1] == MCAP0_MAGIC:
        return len(data)
    if at + _HEAD.size > len(data):
        return None
    opcode, length = _HEAD.unpack_from(data, at)
    end = at + _HEAD.size + length
    if opcode not in _OPCODES or opcode == Opcode.CHUNK or end > len(data):
        return None
    plausible = end == len(data) or data[end] in _OPCODES or data[end : end + len(MCAP0_MAGIC)] == MCAP0_MAGIC
    return int(end) if plausible else None


def _next_chunk(data: Any, at: int) -> int:
    for match in _CANDIDATE.finditer(data, at):
        if _chunk_at(data, match.start()):
            return match.start()
    return len(data)
