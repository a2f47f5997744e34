"""MCAP files as bytes: verification of a finished recording, and extraction of the readable chunks of a damaged one."""

from __future__ import annotations

import contextlib
import mmap
import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake, reading
from needleplan.recording._data_files import PathLike
from needleplan.recording._journal import PROFILE, SESSION, Counts

__all__ = [
    "Damage",
    "Definitions",
    "RawMessage",
    "chunks",
    "definitions_of",
    "mapped",
    "messages_of",
    "require_intact",
    "topic_chunks",
]

_LARGEST_CHUNK_BYTES = 256 * 2**20  # largest plausible size of a chunk; a larger size counts as damage
# Largest size of all unpacked chunks of a file: these bytes, and this multiple of the size of the file. Samples shrink
# to a fourth, equal events to a tenth; what expands farther is no recording, and counts as damage.
_UNPACKED_BYTES, _UNPACKED_RATIO = 2**22, 64
_BLOCK_BYTES = 2**20  # number of bytes that are read at once for a checksum
_RECOVER = "needleplan recording recover {path} -o NEW.mcap"
_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")
_CANDIDATE = re.compile(rb"\x06[\s\S]{5}\0\0\0")
_OPCODES = frozenset(Opcode)

RawMessage = tuple[int, int, int, bytes]
"""A message: channel number, sequence number, time (ns since 1970), and encoded data."""


@dataclass
class Damage:
    """Number of unreadable bytes, and number of separate damaged regions (`places`) in the file."""

    damaged_bytes: int = 0
    places: int = 0


@dataclass
class Definitions(CallRepr):
    """Schemas and channels by number; the session as stored and the counts, each None until it is found."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    session: dict[str, Any] | None = None
    counts: Counts | None = None


@contextlib.contextmanager
def mapped(path: PathLike) -> Iterator[Any]:
    """Yield the bytes of a file as a memory map. Raises DataError if it cannot be read."""
    with reading(path, DataError), Path(path).open("rb") as stream:
        if os.fstat(stream.fileno()).st_size == 0:
            yield b""
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


def require_intact(stream: BinaryIO, source: str) -> None:
    """Raise DataError if the file is not a finished recording, or if its bytes do not agree with the checksums."""
    start = stream.read(256)
    if not start.startswith(MCAP0_MAGIC):
        raise DataError("is not a recording: it does not begin as an MCAP file", source)
    advice = _RECOVER.format(path=source)
    try:
        _, length = _HEAD.unpack_from(start, len(MCAP0_MAGIC))
        body = start[len(MCAP0_MAGIC) + _HEAD.size :][:length]
        profile = records.Header.read(ReadDataStream(BytesIO(body))).profile
    except Exception as error:  # the MCAP library raises many types of exceptions for a damaged header
        raise DataError(f"is damaged at its beginning; {advice}", source) from error
    if profile != PROFILE:
        raise DataError(Mistake("profile", profile, f"must be {PROFILE}: it is a file of another program"), source)
    size = stream.seek(0, os.SEEK_END)
    tail = _FOOTER.size + len(MCAP0_MAGIC)
    stream.seek(max(size - tail, 0))
    end = stream.read()
    if not end.endswith(MCAP0_MAGIC) or len(end) < tail or end[0] != Opcode.FOOTER:
        raise DataError(f"was not finished, or is cut; {advice}", source)
    _, length, summary_start, _, summary_crc = _FOOTER.unpack_from(end)
    data_end = summary_start - _DATA_END.size
    damaged = DataError(f"is damaged: its checksums do not agree; {advice}", source)
    if length != _FOOTER.size - _HEAD.size or not len(MCAP0_MAGIC) <= data_end <= size - tail:
        raise damaged
    stream.seek(0)
    data_crc = _checksum(stream, data_end)
    mark, mark_length, expected = _DATA_END.unpack(stream.read(_DATA_END.size))
    summary = _checksum(stream, size - tail - summary_start)
    summary = zlib.crc32(end[: _FOOTER.size - 4], summary)
    if (mark, mark_length, expected) != (Opcode.DATA_END, 4, data_crc) or summary != summary_crc:
        raise damaged


def chunks(data: Any, damage: Damage) -> Iterator[bytes]:
    """Yield the records of each chunk with a correct checksum, and the definitions that are outside of chunks.

    `data` is bytes or a memory map. Unreadable bytes are skipped up to the next readable chunk and counted in `damage`.
    """
    size = len(data)
    room = _Room(_UNPACKED_BYTES + _UNPACKED_RATIO * size)
    at = len(MCAP0_MAGIC) if data[: len(MCAP0_MAGIC)] == MCAP0_MAGIC else 0
    while at < size:
        found = _chunk_at(data, at, room)
        if found:
            content, at = found
            yield content
            continue
        following = _skipped(data, at)
        if following:
            if data[at] in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):  # at the end, and the counts at the start
                yield bytes(data[at:following])
            at = following
            continue
        damaged_from = at
        at = _next_chunk(data, at + 1, room)
        damage.damaged_bytes += at - damaged_from
        damage.places += 1


def definitions_of(content: bytes, known: Definitions) -> None:
    """Add the schemas, channels, session and counts in the records of a chunk to `known`, unless already known.

    A topic has one channel. A second channel of the same topic is ignored, because its number may be damaged: the
    definitions at the end of the file have no checksum.
    """
    for opcode, body in _records(content):
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(ReadDataStream(BytesIO(body)))
            known.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = records.Channel.read(ReadDataStream(BytesIO(body)))
            if channel.topic not in {each.topic for each in known.channels.values()}:
                known.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.METADATA:
            known.counts = known.counts or Counts.of_metadata(body)
        elif opcode == Opcode.MESSAGE and known.session is None:
            number = _MESSAGE.unpack_from(body)[0]
            channel_of = known.channels.get(number)
            if channel_of is not None and channel_of.topic == "/session":
                known.session = SESSION.decode(body[_MESSAGE.size :])


def messages_of(content: bytes) -> Iterator[RawMessage]:
    """Yield the messages in `content`, the records of a chunk."""
    for opcode, body in _records(content):
        if opcode == Opcode.MESSAGE:
            number, sequence, time_ns, _ = _MESSAGE.unpack_from(body)
            yield number, sequence, time_ns, body[_MESSAGE.size :]


def topic_chunks(data: Any, topic: str, source: str) -> Iterator[tuple[list[int], list[bytes]]]:
    """Yield, chunk by chunk, the times (ns since 1970) and the encoded data of the messages of a topic.

    `data` is a finished recording, bytes or a memory map. Raises DataError if it has been damaged since it was opened.
    """
    damage, number = Damage(), -1
    for content in chunks(data, damage):
        times_ns, bodies, at = list[int](), list[bytes](), 0
        while at < len(content):
            opcode, length = _HEAD.unpack_from(content, at)
            at += _HEAD.size
            if opcode == Opcode.MESSAGE:
                channel, _, time_ns, _ = _MESSAGE.unpack_from(content, at)
                if channel == number:
                    times_ns.append(time_ns)
                    bodies.append(content[at + _MESSAGE.size : at + length])
            elif opcode == Opcode.CHANNEL and number < 0:
                found = records.Channel.read(ReadDataStream(BytesIO(content[at : at + length])))
                number = found.id if found.topic == topic else number
            at += length
        if bodies:
            yield times_ns, bodies
    if damage.places:
        raise DataError(f"is damaged: its checksums do not agree; {_RECOVER.format(path=source)}", source)


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the records of a chunk up to the first one that a chunk cannot have."""
    at = 0
    while at < len(content):
        opcode, length = _HEAD.unpack_from(content, at)
        if opcode not in _OPCODES:
            return
        at += _HEAD.size
        yield opcode, content[at : at + length]
        at += length


def _checksum(stream: BinaryIO, length: int) -> int:
    checksum = 0
    while length > 0:
        block = stream.read(min(length, _BLOCK_BYTES))
        if not block:
            break
        checksum = zlib.crc32(block, checksum)
        length -= len(block)
    return checksum


@dataclass
class _Room:
    """Number of bytes that may still be unpacked."""

    left: int


def _chunk_at(data: Any, at: int, room: _Room) -> tuple[bytes, int] | None:
    """Return the records of the chunk at the offset `at` and the offset of its end; None if no valid chunk is there.

    A chunk that does not fit into `room` is not valid.
    """
    body = at + _HEAD.size
    if body + _CHUNK.size + 8 > len(data):
        return None
    opcode, length = _HEAD.unpack_from(data, at)
    end = body + length
    if opcode != Opcode.CHUNK or end > len(data) or length > _LARGEST_CHUNK_BYTES:
        return None
    _, _, size, checksum, name_length = _CHUNK.unpack_from(data, body)
    start = body + _CHUNK.size + name_length + 8
    if name_length > 4 or start > end or size > min(_LARGEST_CHUNK_BYTES, room.left):
        return None
    if struct.unpack_from("<Q", data, start - 8)[0] != end - start:
        return None
    room.left -= size
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
    """Return the offset of the end of the record at the offset `at`; None if the record is a chunk or damaged."""
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


def _next_chunk(data: Any, at: int, room: _Room) -> int:
    for match in _CANDIDATE.finditer(data, at):
        left = room.left
        if _chunk_at(data, match.start(), room):
            room.left = left  # it is unpacked once more, where it is read
            return match.start()
    return len(data)
