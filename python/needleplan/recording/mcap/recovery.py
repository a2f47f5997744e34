"""From the chunks of a partial, cut or damaged recording to a whole one, with index and checksums.

Closing a recorder and recovering a killed one are the same thing: what can be read is written again, in large
compressed chunks, and takes the name of the recording once it is on the disk.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import secrets
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import CompressionType, Writer

from needleplan.artifacts import require_writable, version
from needleplan.errors import DataError, InputError, Mistake, OutputError
from needleplan.recording.files import PathLike
from needleplan.recording.mcap.journal import PROFILE
from needleplan.recording.mcap.kinds import STATUS
from needleplan.recording.mcap.salvage import Damage, Definitions, RawMessage, chunks, definitions_of, messages_of
from needleplan.recording.mcap.session import Session

__all__ = ["Recovery", "finish", "recover"]

_LARGE_CHUNK = 2**17
"""About a second of a run: what one damaged byte can cost a finished recording."""

_SESSION = "/session"


@dataclass(frozen=True)
class Recovery:
    """What was found, and what is known to be missing."""

    messages: int
    by_topic: Mapping[str, int] = field(default_factory=dict)
    damaged_bytes: int = 0
    places: int = 0
    """At how many places of the file something could not be read."""

    missing: Mapping[str, int] = field(default_factory=dict)
    """Messages missing between others, by topic, as their numbers tell; not those that the recorder says it lost."""

    overflowed: Mapping[str, int] = field(default_factory=dict)
    """Messages that the recorder says it lost while it ran, by topic."""

    complete: bool = False
    """Whether the recorder closed it; otherwise what was not on its way to the disk when it ended is missing too."""


def recover(path: PathLike, target: PathLike) -> Recovery:
    """Write all that can be read of a recording at `path`, however it ended, to `target`, and say what is missing.

    Raises DataError where nothing of it is a recording of needleplan, OutputError where `target` is there already or
    cannot be written.
    """
    require_writable(target)
    if Path(target).exists():
        raise OutputError("is there already: a recording is never overwritten", os.fspath(target))
    with _mapped(path) as data:
        return _rewrite(data, os.fspath(path), Path(target), recovered=True)


def finish(partial: Path, target: Path, expected: int) -> Recovery:
    """Make the recording of a partial file that was closed, and remove that. Raises InputError, and keeps it.

    `expected` messages must be in it.
    """
    with _mapped(partial) as data:
        done = _rewrite(data, str(partial), target, recovered=False, expected=expected)
    with contextlib.suppress(OSError):
        partial.unlink()
    return done


@contextlib.contextmanager
def _mapped(path: PathLike) -> Iterator[Any]:
    try:
        with Path(path).open("rb") as stream:
            if os.fstat(stream.fileno()).st_size == 0:
                yield b""
                return
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield data
    except InputError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot be read: {reason}", os.fspath(path)) from error


def _rewrite(data: Any, source: str, target: Path, *, recovered: bool, expected: int | None = None) -> Recovery:
    known = Definitions()
    for _ in range(2):  # where the first chunk is damaged, the session stands before the definition of its channel
        for content in chunks(data, Damage()):
            with contextlib.suppress(Exception):  # the checksum agrees, but somebody else may have made it
                definitions_of(content, known)
        if known.session is not None:
            break
    if known.session is None:
        raise DataError("is not a recording of needleplan, or nothing of it can be read", source)
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
            new.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                new.unlink()
            raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(Mistake("", "", f"cannot be written: {reason}"), str(target)) from error
    return done


def _write(stream: BinaryIO, data: Any, known: Definitions, session: Session, recovered: bool) -> Recovery:
    writer = Writer(stream, _LARGE_CHUNK, CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(PROFILE, f"needleplan {version()}")
    flat = {name: str(each) for name, each in session.to_dict().items() if name not in ("texts", "digests")}
    flat |= {f"digest.{name}": each for name, each in session.digests.items()}
    writer.add_metadata("needleplan.session", flat)
    for name, text in session.texts.items():
        writer.add_attachment(session.wall_ns, session.wall_ns, name, _media_type(name), text.encode())
    numbers = _register(writer, known)
    damage = Damage()
    last: dict[int, int] = {}
    missing: Counter[int] = Counter()
    counts: Counter[int] = Counter()
    status: dict[str, Any] = {}
    again: tuple[int, int, bytes] | None = None
    for content in chunks(data, damage):
        for number, sequence, time_ns, body in _readable(content):
            topic = known.channels[number].topic if number in numbers else ""
            if not topic:
                continue
            if topic == _SESSION:
                again = (numbers[number], time_ns, body)
            else:
                missing[number] += max(sequence - last.get(number, 0) - 1, 0)
            last[number] = max(sequence, last.get(number, 0))
            if topic == "/recorder":
                with contextlib.suppress(DataError):
                    status = STATUS.decode(body)
            writer.add_message(numbers[number], time_ns, body, time_ns, sequence)
            counts[number] += 1
    if again:  # in the first chunk and in the last, so that one damage leaves one of them
        writer.add_message(again[0], again[1], again[2], again[1])
    done = _summed(known, counts, missing, status, damage)
    if recovered:
        writer.add_metadata("needleplan.recovery", {
            "damaged_bytes": str(done.damaged_bytes), "places": str(done.places),
            "complete": str(done.complete).lower(),
            **{f"missing{topic}": str(count) for topic, count in done.missing.items()},
        })  # fmt: skip
    writer.finish()
    return done


def _readable(content: bytes) -> Iterator[RawMessage]:
    """Yield the messages of a chunk as far as they can be read: its checksum agrees, but anybody may have made it."""
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
    """Return the numbers that the channels have in the new file."""
    schemas = {old: writer.register_schema(each.name, each.encoding, each.data) for old, each in known.schemas.items()}
    return {
        old: writer.register_channel(each.topic, each.message_encoding, schemas[each.schema_id])
        for old, each in known.channels.items()
        if each.schema_id in schemas
    }


def _summed(
    known: Definitions, counts: Counter[int], missing: Counter[int], status: Mapping[str, Any], damage: Damage
) -> Recovery:
    topics = {number: each.topic for number, each in known.channels.items()}
    stored = status.get("overflowed")
    overflowed = {str(topic): int(count) for topic, count in stored.items()} if isinstance(stored, dict) else {}
    gaps = {topics[number]: count - overflowed.get(topics[number], 0) for number, count in missing.items()}
    return Recovery(
        sum(count for number, count in counts.items() if topics[number] != _SESSION),
        {topics[number]: count for number, count in counts.items() if topics[number] != _SESSION},
        damage.damaged_bytes,
        damage.places,
        {topic: count for topic, count in gaps.items() if count > 0},
        overflowed,
        status.get("state") == "closed" and not damage.damaged_bytes,
    )


def _media_type(name: str) -> str:
    endings = {".toml": "application/toml", ".json": "application/json", ".md": "text/markdown"}
    return endings.get(Path(name).suffix, "text/plain")
