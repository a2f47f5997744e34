"""Conversion of an unfinished, truncated or damaged recording to a complete one, with index and checksums.

This is done when a recorder is closed and when the recording of a killed run is recovered: all readable messages are
written again in large compressed chunks, and the new file gets the name of the recording after it is on the disk.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import CompressionType, Writer

from needleplan.artifacts import (
    ShortRepr,
    move_into_place,
    path_text,
    require_writable,
    version,
)
from needleplan.errors import DataError, Mistake, OutputError
from needleplan.recording._data_files import PathLike
from needleplan.recording._journal import COUNTS, PROFILE, Session
from needleplan.recording._sample_kinds import STATUS
from needleplan.recording.mcap_bytes import (
    Damage,
    Definitions,
    RawMessage,
    chunks,
    definitions_of,
    mapped,
    messages_of,
)

__all__ = ["Recovery", "finish", "recover"]

_CHUNK_BYTES = 2**17  # size of a chunk (bytes), about 1 s of a run; one damaged byte loses at most one chunk
# Least number of chunks: the session stands in the first and in the last one, so a short file has several, too.
_LEAST_CHUNKS = 8

_SESSION = "/session"
_THERE = "is there already: a recording is never overwritten"


@dataclass(frozen=True)
class Recovery(ShortRepr):
    """Result of a recovery.

    Attributes
    ----------
    messages : int
        Number of messages recovered.
    by_topic : mapping of str to int
        Number of messages recovered by topic.
    damaged_bytes, places : int
        Number of unreadable bytes, and number of separate damaged regions in the file.
    missing : mapping of str to int
        Number of missing messages by topic, without the messages in `overflowed`: gaps in the sequence numbers of the
        recovered messages, and the difference between the last one and the recorder's last count.
    overflowed : mapping of str to int
        Number of messages by topic that the recorder itself counted as lost.
    complete : bool
        Whether the recorder closed the recording and no byte is damaged.
    closed : bool
        Whether the recovered messages include the last one of a recorder that was closed.
    counted_s : float or None
        Time from the start of the recording to the last message in the recorder's last count, s. Messages put after
        this count are neither in the file nor in `missing`. None if the file has no readable count.
    missing_s : float
        Time between the last recovered message and the last counted message, s.

    Examples
    --------
    >>> from needleplan.recording import Recovery
    >>> Recovery(messages=100, missing={"/force": 2}).complete
    False
    """

    messages: int
    by_topic: Mapping[str, int] = field(default_factory=dict)
    damaged_bytes: int = 0
    places: int = 0
    missing: Mapping[str, int] = field(default_factory=dict)
    overflowed: Mapping[str, int] = field(default_factory=dict)
    complete: bool = False
    closed: bool = False
    counted_s: float | None = None
    missing_s: float = 0.0


def recover(path: PathLike, target: PathLike, *, overwrite: bool = False) -> Recovery:
    """Write all readable messages of an unfinished, truncated or damaged recording to a new recording.

    Parameters
    ----------
    path : str or path
        The unfinished, truncated or damaged recording; it is not changed.
    target : str or path
        The recording to write.
    overwrite : bool
        Whether `target` may replace a file that exists.

    Returns
    -------
    Recovery
        Counts of recovered and missing messages.

    Raises
    ------
    DataError
        The file contains no readable part of a needleplan recording.
    OutputError
        `target` exists and may not be replaced, or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import Recorder, recover
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "run.mcap"
    >>> Recorder(path).close().ok
    True
    >>> _ = path.write_bytes(path.read_bytes()[:-40])  # cut
    >>> recover(path, Path(folder.name) / "recovered.mcap").by_topic
    {'/recorder': 2}
    >>> folder.cleanup()

    """
    source = path_text(path, DataError)
    require_writable(path_text(target, OutputError))
    if Path(target).exists() and not overwrite:
        raise OutputError(_THERE, os.fspath(target))
    with mapped(path) as data:
        return _rewrite(data, source, Path(target), overwrite, recovered=True)


def finish(partial: Path, target: Path, expected: int, *, overwrite: bool = False) -> Recovery:
    """Convert a closed partial file to the recording `target`, and remove the partial file.

    Raises InputError and keeps the partial file if writing fails, not exactly `expected` messages can be read, or
    `target` exists and `overwrite` is false.
    """
    with mapped(partial) as data:
        done = _rewrite(data, str(partial), target, overwrite, recovered=False, expected=expected)
    with contextlib.suppress(OSError):
        partial.unlink()
    return done


def _rewrite(
    data: Any, source: str, target: Path, overwrite: bool, *, recovered: bool, expected: int | None = None
) -> Recovery:
    known = Definitions()
    for _ in range(2):  # two passes: after a damaged first chunk, the definition of a channel may follow its messages
        for content in chunks(data, Damage()):
            with contextlib.suppress(Exception):  # the checksum agrees, but the chunk may come from another program
                definitions_of(content, known)
        if known.session is not None:
            break
    if known.session is None:
        raise DataError("is not a recording of needleplan, or no part of it can be read", source)
    session = Session.from_dict(known.session, source)
    new = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}.partial")
    try:
        try:
            with new.open("xb") as stream:
                done = _write(stream, data, known, session, recovered)
                stream.flush()
                os.fsync(stream.fileno())
            if expected is not None and done.messages != expected:
                rule = f"{done.messages} of {expected} messages can be read back; the partial file is kept"
                raise DataError(rule, source)
            move_into_place(new, target, replace=overwrite)
        except BaseException:
            with contextlib.suppress(OSError):
                new.unlink()
            raise
    except FileExistsError as error:
        raise OutputError(_THERE, str(target)) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(Mistake("", "", f"cannot be written: {reason}"), str(target)) from error
    return done


def _write(stream: BinaryIO, data: Any, known: Definitions, session: Session, recovered: bool) -> Recovery:
    chunk_bytes = min(_CHUNK_BYTES, len(data) // _LEAST_CHUNKS)
    writer = Writer(stream, chunk_bytes, CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(PROFILE, f"needleplan {version()}")
    flat = {name: str(each) for name, each in session.to_dict().items() if name not in ("texts", "digests")}
    flat |= {f"digest.{name}": each for name, each in session.digests.items()}
    writer.add_metadata("needleplan.session", flat)
    for name, text in session.texts.items():
        writer.add_attachment(session.wall_ns, session.wall_ns, name, _media_type(name), text.encode())
    if known.counts:
        writer.add_metadata(COUNTS, known.counts.metadata())
    numbers = _register(writer, known)
    damage = Damage()
    last: dict[int, int] = {}
    missing: Counter[int] = Counter()
    counts: Counter[int] = Counter()
    status: dict[str, Any] = {}
    end_ns = 0
    session_message: tuple[int, int, bytes] | None = None
    for content in chunks(data, damage):
        for number, sequence, time_ns, body in _readable(content):
            topic = known.channels[number].topic if number in numbers else ""
            if not topic:
                continue
            if topic == _SESSION:
                session_message = (numbers[number], time_ns, body)
            else:
                missing[number] += max(sequence - last.get(number, 0) - 1, 0)
                end_ns = max(end_ns, time_ns) if topic != "/recorder" else end_ns
            last[number] = max(sequence, last.get(number, 0))
            if topic == "/recorder":
                with contextlib.suppress(DataError):
                    status = STATUS.decode(body)
            writer.add_message(numbers[number], time_ns, body, time_ns, sequence)
            counts[number] += 1
    # A second copy in the last chunk, so that damage to one chunk leaves one copy. A session longer than a chunk fills
    # its own; a shorter one is in a file of many chunks.
    if session_message:
        channel, session_ns, body = session_message
        writer.add_message(channel, session_ns, body, session_ns)
    absent = Counter({known.channels[number].topic: count for number, count in missing.items()})
    found = {known.channels[number].topic: sequence for number, sequence in last.items()}
    for topic, put in (known.counts.put if known.counts else {}).items():  # put after the last recovered message
        absent[topic] += max(put - found.get(topic, 0), 0)
    done = _summed(known, counts, absent, status, damage)
    if known.counts:
        last_ns = known.counts.last_ns
        done = replace(
            done,
            counted_s=max(last_ns - session.wall_ns, 0) * 1e-9,
            missing_s=max(last_ns - (end_ns or session.wall_ns), 0) * 1e-9,
        )
    if recovered:
        writer.add_metadata("needleplan.recovery", {
            "damaged_bytes": str(done.damaged_bytes), "places": str(done.places),
            "complete": str(done.complete).lower(),
            **{f"missing{topic}": str(count) for topic, count in done.missing.items()},
        })  # fmt: skip
    writer.finish()
    return done


def _readable(content: bytes) -> Iterator[RawMessage]:
    """Yield the messages of a chunk up to the first malformed one; another program may have written the chunk."""
    messages = messages_of(content)
    while True:
        try:
            message = next(messages, None)
        except struct.error:
            return
        if message is None:
            return
        yield message


def _register(writer: Writer, known: Definitions) -> dict[int, int]:
    """Register all schemas and channels in the new file; return the new number of each channel by its old number."""
    schemas = {old: writer.register_schema(each.name, each.encoding, each.data) for old, each in known.schemas.items()}
    return {
        old: writer.register_channel(each.topic, each.message_encoding, schemas[each.schema_id])
        for old, each in known.channels.items()
        if each.schema_id in schemas
    }


def _summed(
    known: Definitions, counts: Counter[int], absent: Counter[str], status: Mapping[str, Any], damage: Damage
) -> Recovery:
    topics = {number: each.topic for number, each in known.channels.items()}
    stored = status.get("overflowed")
    overflowed = {str(topic): int(count) for topic, count in stored.items()} if isinstance(stored, dict) else {}
    if known.counts:
        overflowed |= known.counts.overflowed
    gaps = {topic: count - overflowed.get(topic, 0) for topic, count in absent.items()}
    return Recovery(
        sum(count for number, count in counts.items() if topics[number] != _SESSION),
        {topics[number]: count for number, count in counts.items() if topics[number] != _SESSION},
        damage.damaged_bytes,
        damage.places,
        {topic: count for topic, count in gaps.items() if count > 0},
        overflowed,
        status.get("state") == "closed" and not damage.damaged_bytes,
        status.get("state") == "closed",
    )


def _media_type(name: str) -> str:
    endings = {".toml": "application/toml", ".json": "application/json", ".md": "text/markdown"}
    return endings.get(Path(name).suffix, "text/plain")
