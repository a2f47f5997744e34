"""The description of a run (session), and the unfinished file of a recording.

The file consists of short chunks that can be read independently. Each chunk stores its length and a CRC32 checksum.
The session and the definitions of the channels are repeated every 10 s, so that a damaged chunk does not make the rest
unreadable. The file has no index until it is finished (`_recovery.py`), because an index would use more and more memory
during the run.

A metadata record of fixed size, `Counts`, stands before the first chunk and is overwritten in place. It states how many
messages were put, so that a recovery can state how many are missing at the end. A full disk does not prevent this.
"""

from __future__ import annotations

import contextlib
import json
import os
import struct
import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from types import MappingProxyType
from typing import Any, Self

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from needleplan.artifacts import CallRepr, version
from needleplan.errors import DataError, Mistake
from needleplan.recording._message_kinds import Json, MessageKind

__all__ = ["FORMAT", "PROFILE", "SESSION", "Counts", "Journal", "Session"]

FORMAT = "needleplan.recording/1"


@dataclass(frozen=True)
class Session(CallRepr):
    """The description of a run.

    The times of messages are measured on the monotonic clock, which nobody can set, and are stored as times of day;
    `monotonic_ns` and `wall_ns` convert between both clocks.

    Attributes
    ----------
    title : str
        Title of the run.
    digests : mapping of str to str
        Digests of the files that the run used, such as scenario, table, model and registration, by name.
    texts : mapping of str to str
        Contents of text files, such as the configuration, by file name; stored as attachments.
    force_axis : tuple of float
        Unit vector in the frame of the force sensor along which a force that resists the insertion is positive.
    monotonic_ns, wall_ns : int
        The same moment on the monotonic clock (ns) and as time of day (ns since 1970).
    made_by : str
        Program that wrote the recording, and its version.

    Examples
    --------
    >>> from needleplan.recording import Session
    >>> session = Session("phantom 3", monotonic_ns=5_000, wall_ns=1_700_000_000_000_005_000)
    >>> session.wall_of(6_000)
    1700000000000006000

    """

    title: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    force_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    monotonic_ns: int = field(default_factory=time.monotonic_ns)
    wall_ns: int = field(default_factory=time.time_ns)
    made_by: str = field(default_factory=lambda: f"needleplan {version()}")

    def __post_init__(self) -> None:
        for name in ("digests", "texts"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def wall_of(self, monotonic_ns: int) -> int:
        """Return the time of day of a moment on the monotonic clock.

        Parameters
        ----------
        monotonic_ns : int
            Time on the monotonic clock, ns.

        Returns
        -------
        int
            Time of day, ns since 1970; at least 0.

        """
        return max(monotonic_ns - self.monotonic_ns + self.wall_ns, 0)

    def monotonic_of(self, wall_ns: int) -> int:
        """Convert a time of day in the recording to the time on the monotonic clock.

        Parameters
        ----------
        wall_ns : int
            Time of day, ns since 1970.

        Returns
        -------
        int
            Time on the monotonic clock, ns.

        """
        return wall_ns - self.wall_ns + self.monotonic_ns

    def to_dict(self) -> dict[str, Any]:
        """Return the session as JSON values, as stored in the file.

        Returns
        -------
        dict
            All attributes, and the format of the recording.

        """
        return {
            "format": FORMAT,
            "made_by": self.made_by,
            "title": self.title,
            "digests": dict(self.digests),
            "texts": dict(self.texts),
            "force_axis": list(self.force_axis),
            "monotonic_ns": str(self.monotonic_ns),  # as text: JSON readers round numbers of this size
            "wall_ns": str(self.wall_ns),
        }

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any], source: str = "") -> Self:
        """Return the session from the JSON values of `to_dict`.

        Parameters
        ----------
        stored : mapping
            The stored values.
        source : str
            The file, for error messages.

        Returns
        -------
        Session
            The session.

        Raises
        ------
        DataError
            The recording has another format, or a value is missing or wrong.

        """
        if stored.get("format") != FORMAT:
            raise DataError(Mistake("format", str(stored.get("format")), f"must be {FORMAT}"), source)
        try:
            x, y, z = (float(each) for each in stored["force_axis"])
            return cls(
                str(stored["title"]),
                {str(name): str(text) for name, text in stored["digests"].items()},
                {str(name): str(text) for name, text in stored["texts"].items()},
                (x, y, z),
                int(stored["monotonic_ns"]),
                int(stored["wall_ns"]),
                str(stored["made_by"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DataError(Mistake("session", "", f"is damaged: {error!r}"), source) from error


@dataclass(frozen=True)
class Counts:
    """Numbers of the messages that a recorder had received at a moment.

    Parameters
    ----------
    put : mapping of str to int
        Number of messages put by topic, including those that were lost.
    overflowed : mapping of str to int
        Number of messages by topic that the recorder itself counted as lost.
    last_ns : int
        Latest time of a message, ns since 1970.
    """

    put: Mapping[str, int] = field(default_factory=dict)
    overflowed: Mapping[str, int] = field(default_factory=dict)
    last_ns: int = 0

    def metadata(self) -> dict[str, str]:
        """Return the counts as MCAP metadata with a CRC32, because a partial file has no checksum outside of chunks."""
        text = json.dumps({"put": dict(self.put), "overflowed": dict(self.overflowed), "last_ns": str(self.last_ns)})
        return {"counts": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}

    @classmethod
    def of_metadata(cls, body: bytes) -> Counts | None:
        """Return the counts in the body of a metadata record; None if it holds others, or is damaged."""
        try:
            record = records.Metadata.read(ReadDataStream(BytesIO(body)))
            text = record.metadata["counts"].rstrip(" ")
            if record.name != COUNTS or int(record.metadata["crc32"], 16) != zlib.crc32(text.encode()):
                return None
            stored = json.loads(text)
            put, overflowed = ({str(topic): int(count) for topic, count in stored[name].items()}
                               for name in ("put", "overflowed"))  # fmt: skip
            return cls(put, overflowed, int(stored["last_ns"]))
        except Exception:  # the MCAP library raises many types of exceptions for a damaged record
            return None


PROFILE = FORMAT
COUNTS = "needleplan.counts"
_COUNTS_BYTES = 2048  # size of the text of the counts, padded with spaces; enough for about 50 topics
SESSION = Json("needleplan.Session")
_SESSION_ID = 1

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEADER_BYTES = 22  # bytes of a message record before its data, included in its length
_REPEAT_NS = 10_000_000_000  # time (ns) after which session and channel definitions are written again


class Journal:
    """Writes messages in chunks to a file descriptor; not thread-safe.

    If writing a chunk fails, the file is truncated to the earlier chunks, and the next `flush` writes the chunk again.
    """

    def __init__(self, descriptor: int, session: Session) -> None:
        self._descriptor = descriptor
        self._session = session
        self._kinds: dict[int, tuple[str, MessageKind]] = {_SESSION_ID: ("/session", SESSION)}
        self._chunk = bytearray()
        self._span = (0, 0)
        self._length = 0
        self._repeat_ns = 0
        self.unwritten = 0
        """Number of messages in the present chunk, which `flush` will write."""
        header = RecordBuilder()
        records.Header(PROFILE, f"needleplan {version()}").write(header)
        head = MCAP0_MAGIC + header.end()
        self._counts_at = len(head)
        self._counts = Counts()
        self._write(head + _counts_record(self._counts))

    @property
    def size(self) -> int:
        """Size of the present chunk, which `flush` will write, in bytes."""
        return len(self._chunk)

    def define(self, topic: str, kind: MessageKind) -> int:
        """Add a channel and return its number; all definitions are written before the next message."""
        number = len(self._kinds) + 1
        self._kinds[number] = (topic, kind)
        self._repeat_ns = 0
        return number

    def add(self, channel: int, sequence: int, wall_ns: int, data: bytes) -> None:
        """Add a message to the present chunk.

        Session and definitions are added before the message if a channel is new or the last definitions are 10 s old.
        """
        if wall_ns >= self._repeat_ns:
            self._add_definitions(wall_ns)
            self._repeat_ns = wall_ns + _REPEAT_NS
        self._add(channel, sequence, wall_ns, data)
        self.unwritten += 1

    def flush(self) -> None:
        """Write the present chunk to the file (not to the disk), and begin a new chunk.

        If writing fails, raises OSError and keeps the chunk.
        """
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

    def count(self, counts: Counts) -> None:
        """Overwrite the counts in the file; does nothing if they are unchanged, too long or cannot be written."""
        record = _counts_record(counts)
        if counts != self._counts and record:
            with contextlib.suppress(OSError):
                os.lseek(self._descriptor, self._counts_at, os.SEEK_SET)
                os.write(self._descriptor, record)
                self._counts = counts
            os.lseek(self._descriptor, self._length, os.SEEK_SET)

    def _add(self, channel: int, sequence: int, wall_ns: int, data: bytes) -> None:
        low, high = self._span if self._chunk else (wall_ns, wall_ns)
        self._span = (min(low, wall_ns), max(high, wall_ns))
        length = _MESSAGE_HEADER_BYTES + len(data)
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


def _counts_record(counts: Counts) -> bytes:
    """Return the counts as a metadata record, whose size is always the same; empty if they are too long."""
    metadata = counts.metadata()
    if len(metadata["counts"]) > _COUNTS_BYTES:
        return b""
    metadata["counts"] = metadata["counts"].ljust(_COUNTS_BYTES)
    builder = RecordBuilder()
    records.Metadata(COUNTS, metadata).write(builder)
    return bytes(builder.end())
