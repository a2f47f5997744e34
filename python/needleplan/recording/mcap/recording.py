"""Reading a recording back: what it says of the run, and its messages in the order of time."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Header, Schema
from mcap.writer import MCAP0_MAGIC

from needleplan.errors import DataError, InputError, Mistake
from needleplan.recording.files import PathLike
from needleplan.recording.mcap.journal import PROFILE, SESSION
from needleplan.recording.mcap.kinds import Json, Kind, Packed
from needleplan.recording.mcap.session import Session

__all__ = ["Message", "Recording"]

_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_BLOCK = 2**20
_RECOVER = "needleplan recording recover {path} -o NEW.mcap"


@dataclass(frozen=True)
class Message:
    """One message: `time_ns` is on the monotonic clock of the recording machine, `sequence` counts its topic from 1."""

    topic: str
    time_ns: int
    sequence: int
    values: dict[str, Any]


@dataclass(frozen=True)
class Recording:
    """A finished recording; every byte of it has been checked."""

    path: Path
    session: Session
    counts: Mapping[str, int]
    """Messages by topic."""

    kinds: Mapping[str, Kind] = field(repr=False)
    start_ns: int
    """Of the first message, on the monotonic clock."""

    end_ns: int
    recovery: Mapping[str, str] | None = None
    """What recovering it had to say; None where its recorder closed it."""

    @classmethod
    def read(cls, path: PathLike) -> Recording:
        """Open a recording. Raises DataError for one that is cut, damaged, still being written, or somebody else's."""
        source = os.fspath(path)
        try:
            with Path(path).open("rb") as stream:
                _check(stream, source)
                stream.seek(0)
                reader = SeekingReader(stream, validate_crcs=True)
                summary = reader.get_summary()
                if summary is None or summary.statistics is None:
                    raise DataError("has no summary", source)
                metadata = {each.name: each.metadata for each in reader.iter_metadata()}
                (session,) = [each.data for _, _, each in reader.iter_messages("/session")][:1] or [b"{}"]
                statistics = summary.statistics
                counts = {
                    each.topic: statistics.channel_message_counts.get(number, 0)
                    for number, each in summary.channels.items()
                    if each.topic != "/session"
                }
                kinds = {
                    each.topic: _kind(each, summary.schemas[each.schema_id], source)
                    for each in summary.channels.values()
                }
        except InputError:
            raise
        except OSError as error:
            raise DataError(f"cannot be read: {error.strerror}", source) from error
        except Exception as error:  # the checksums agree, but somebody else may have made them
            raise DataError(f"is not a recording of needleplan: {error!r}", source) from error
        its = Session.from_dict(SESSION.decode(session), source)
        start_ns = its.monotonic_of(statistics.message_start_time)
        end_ns = its.monotonic_of(statistics.message_end_time)
        return cls(Path(path), its, counts, kinds, start_ns, end_ns, metadata.get("needleplan.recovery"))

    @property
    def duration_s(self) -> float:
        """From the first message to the last."""
        return (self.end_ns - self.start_ns) * 1e-9

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Message]:
        """Yield the messages in the order of time, and those of one moment in the order in which they were written.

        Raises DataError for a topic that the recording does not have, and for a message that cannot be decoded.
        """
        chosen = list(self.counts) if topics is None else list(topics)
        missing = [Mistake("topic", each, f"must be one of {', '.join(sorted(self.counts))}") for each in chosen
                   if each not in self.counts]  # fmt: skip
        if missing:
            raise DataError(missing, str(self.path))
        return self._messages(chosen)

    def _messages(self, topics: list[str]) -> Iterator[Message]:
        if not topics:
            return
        with self.path.open("rb") as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            for _, channel, each in reader.iter_messages(topics, log_time_order=True):
                values = self.kinds[channel.topic].decode(each.data)
                yield Message(channel.topic, self.session.monotonic_of(each.log_time), each.sequence, values)


def _check(stream: BinaryIO, source: str) -> None:
    """Raise DataError unless every byte is what was written."""
    start = stream.read(256)
    if not start.startswith(MCAP0_MAGIC):
        raise DataError("is not a recording: it does not begin as an MCAP file", source)
    advice = _RECOVER.format(path=source)
    try:
        _, length = _HEAD.unpack_from(start, len(MCAP0_MAGIC))
        body = start[len(MCAP0_MAGIC) + _HEAD.size :][:length]
        profile = Header.read(ReadDataStream(BytesIO(body))).profile
    except Exception as error:  # the library raises whatever a damaged header leads it to
        raise DataError(f"is damaged at its beginning; {advice}", source) from error
    if profile != PROFILE:
        raise DataError(Mistake("profile", profile, f"must be {PROFILE}: it is an MCAP file of something else"), source)
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


def _checksum(stream: BinaryIO, length: int) -> int:
    checksum = 0
    while length > 0:
        block = stream.read(min(length, _BLOCK))
        if not block:
            break
        checksum = zlib.crc32(block, checksum)
        length -= len(block)
    return checksum


def _kind(channel: Channel, schema: Schema, source: str) -> Kind:
    if channel.message_encoding == "cdr" and schema.encoding == "ros2msg":
        return Packed.from_schema(schema.name, schema.data)
    if channel.message_encoding == "json":
        return Json(schema.name)
    raise DataError(Mistake(channel.topic, channel.message_encoding, "must be cdr or json"), source)
