"""The file while it is written: nothing but short chunks, each of which can be read without the others.

A chunk carries its length and the CRC32 of its records. The session and the definitions of the channels are repeated in
chunks of their own, so that no single damage can make the rest unreadable. There is no index: the memory that it takes
would grow with the run. It is made once, when the file is finished (recovery.py).
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import Any

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from needleplan.artifacts import version
from needleplan.recording.mcap.kinds import Json, Kind
from needleplan.recording.mcap.session import FORMAT, Session

__all__ = ["PROFILE", "SESSION", "Journal"]

PROFILE = FORMAT
SESSION = Json("needleplan.Session")
_SESSION_ID = 1

_MESSAGE = struct.Struct("<BQHIQQ")
_BESIDES = 22
"""Bytes of a message besides its data, as its length counts them."""

_REPEAT_NS = 10_000_000_000


class Journal:
    """Writes chunks to a file descriptor; not for several threads.

    After a failed write the file is cut back to the last whole chunk, and the next `flush` tries again with everything
    that is not there yet.
    """

    def __init__(self, descriptor: int, session: Session) -> None:
        self._descriptor = descriptor
        self._session = session
        self._kinds: dict[int, tuple[str, Kind]] = {_SESSION_ID: ("/session", SESSION)}
        self._chunk = bytearray()
        self._span = (0, 0)
        self._length = 0
        self._repeat_ns = 0
        self.unwritten = 0
        """Messages in the chunk that is not on its way to the disk yet."""
        header = RecordBuilder()
        records.Header(PROFILE, f"needleplan {version()}").write(header)
        self._write(MCAP0_MAGIC + header.end())

    @property
    def size(self) -> int:
        """Bytes of the chunk in progress."""
        return len(self._chunk)

    def define(self, topic: str, kind: Kind) -> int:
        """Add a channel and return its number; it is in the next definitions."""
        number = len(self._kinds) + 1
        self._kinds[number] = (topic, kind)
        self._repeat_ns = 0
        return number

    def add(self, channel: int, sequence: int, wall_ns: int, data: bytes) -> None:
        """Add a message to the chunk in progress."""
        if wall_ns >= self._repeat_ns:
            self._add_definitions(wall_ns)
            self._repeat_ns = wall_ns + _REPEAT_NS
        self._add(channel, sequence, wall_ns, data)
        self.unwritten += 1

    def flush(self) -> None:
        """Hand the chunk in progress to the operating system. Raises OSError, and keeps it, where that fails."""
        if not self._chunk:
            return
        builder = RecordBuilder()
        records.Chunk(
            compression="",
            data=bytes(self._chunk),
            message_start_time=self._span[0],
            message_end_time=self._span[1],
            uncompressed_crc=zlib.crc32(self._chunk),
            uncompressed_size=len(self._chunk),
        ).write(builder)
        self._write(builder.end())
        self._chunk.clear()
        self.unwritten = 0

    def _add(self, channel: int, sequence: int, wall_ns: int, data: bytes) -> None:
        low, high = self._span if self._chunk else (wall_ns, wall_ns)
        self._span = (min(low, wall_ns), max(high, wall_ns))
        length = _BESIDES + len(data)
        self._chunk += _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence & 0xFFFFFFFF, wall_ns, wall_ns)
        self._chunk += data

    def _add_definitions(self, wall_ns: int) -> None:
        builder = RecordBuilder()
        for number, (topic, kind) in self._kinds.items():
            records.Schema(id=number, name=kind.name, encoding=kind.schema_encoding, data=kind.schema).write(builder)
            records.Channel(
                id=number, topic=topic, message_encoding=kind.encoding, metadata={}, schema_id=number
            ).write(builder)
        if not self._chunk:
            self._span = (wall_ns, wall_ns)
        self._chunk += builder.end()
        self._add(_SESSION_ID, 0, wall_ns, SESSION.encode(self._session.to_dict()))

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            self._cut()
            raise
        self._length += len(data)

    def _cut(self) -> Any:
        os.ftruncate(self._descriptor, self._length)
        os.lseek(self._descriptor, self._length, os.SEEK_SET)
