"""Records a run without ever delaying it.

`Channel.put` appends to a bounded queue and returns; a thread of its own encodes and writes, and hands every chunk to
the operating system after at most 20 ms, so that killing the process costs no more than that. (A power cut may cost
more: nothing is forced to the disk before the end.) What a loop must know, it reads from `Recorder.status`: a slow
disk, a full one, a dead writer are states, never exceptions.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from needleplan.artifacts import require_writable
from needleplan.errors import InputError, Mistake, OutputError
from needleplan.recording.files import PathLike
from needleplan.recording.mcap.journal import Journal
from needleplan.recording.mcap.kinds import STATUS, Kind
from needleplan.recording.mcap.recovery import finish
from needleplan.recording.mcap.session import Session

__all__ = ["PARTIAL", "Channel", "Recorder", "RecorderState", "RecorderStatus", "WhenFull"]

PARTIAL = ".partial"
_PERIOD_S = 0.015
_RETRY_S = 0.1
_CHUNK_BYTES = 16_384
_BURST = 512
"""Messages after which a chunk is written although more wait, so that a backlog does not become one huge chunk."""

_CAPACITY = 16_384
_NANO = 1e-9
_LATEST_NS = 2**63


class RecorderState(StrEnum):
    """Whether what is put arrives in the file."""

    RECORDING = "recording"
    STALLED = "stalled"
    """Writing fails, for a full disk for example, and is tried again; what does not fit into the queue is lost."""

    FAILED = "failed"
    """Nothing is recorded any more, or the file could not be finished; what was written is in the partial file."""

    CLOSED = "closed"


class WhenFull(StrEnum):
    """What `put` does where the queue is full."""

    DROP = "drop"
    """Count the message as lost, at once: for real time."""

    WAIT = "wait"
    """Wait for the writer: for simulated time, which is faster than any disk."""


@dataclass(frozen=True)
class RecorderStatus:
    """What a loop needs to know of its recorder."""

    state: RecorderState
    cause: str
    written: int
    """Messages handed to the operating system."""

    queued: int
    behind_s: float
    """Time since everything that had been put was written; about 0.02 s where all is well."""

    overflowed: Mapping[str, int] = field(default_factory=dict)
    """Messages lost because the queue was full or the writer dead, by topic."""

    refused: int = 0
    """Messages that could not be encoded; the first cause is in `refusal`."""

    refusal: str = ""

    @property
    def ok(self) -> bool:
        """Whether the recorder works and nothing is lost so far."""
        good = self.state in (RecorderState.RECORDING, RecorderState.CLOSED)
        return good and not self.overflowed and not self.refused


class Channel:
    """One topic of a recording; only one thread may put into it."""

    def __init__(self, recorder: Recorder, topic: str, kind: Kind, number: int) -> None:
        self.topic = topic
        self.kind = kind
        self.number = number
        self._recorder = recorder
        self._count = 0

    def put(self, time_ns: int, value: Any) -> bool:
        """Record a value at a moment on the monotonic clock; False where it is lost. Never raises, and does not block.

        The value is encoded later, by another thread: do not change it afterwards.
        """
        self._count += 1
        return self._recorder._accept((self, self._count, time_ns, value))


class Recorder:
    """Writes `path`; until it is closed, `path` with `.partial` at its end. Close it, or use it in a `with` statement.

    Raises OutputError where the file cannot be written or one of the two is there already.
    """

    def __init__(
        self,
        path: PathLike,
        session: Session | None = None,
        *,
        capacity: int = _CAPACITY,
        when_full: WhenFull = WhenFull.DROP,
    ) -> None:
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + PARTIAL)
        self.session = session or Session()
        self._capacity = capacity
        self._wait = when_full is WhenFull.WAIT
        self._queue: deque[tuple[Channel, int, int, Any]] = deque()
        self._overflowed: Counter[str] = Counter()
        self._refused, self._refusal = 0, ""
        self._written = 0
        self._state, self._cause = RecorderState.RECORDING, ""
        self._told: tuple[object, ...] = ()
        self._told_count = 0
        self._settled_ns = time.monotonic_ns()
        self._latest_ns = self.session.wall_ns
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self._descriptor = self._create()
        try:
            self._journal = Journal(self._descriptor, self.session)
        except OSError as error:
            os.close(self._descriptor)
            self.partial.unlink(missing_ok=True)
            raise OutputError(Mistake("", "", f"cannot be written: {error.strerror}"), str(self.partial)) from error
        self._own = Channel(self, "/recorder", STATUS, self._journal.define("/recorder", STATUS))
        self._channels: dict[str, Channel] = {"/recorder": self._own}
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def channel(self, topic: str, kind: Kind) -> Channel:
        """Return a new channel, such as `/force`. Raises OutputError for a topic that is there already."""
        with self._lock:
            if not topic.startswith("/") or topic in self._channels or topic == "/session":
                rule = "must begin with / and be new: /session and /recorder are the recorder's own"
                raise OutputError(Mistake("topic", topic, rule), str(self.path))
            kind.schema  # noqa: B018  a wrong kind is refused here, not in the thread
            channel = Channel(self, topic, kind, self._journal.define(topic, kind))
            self._channels[topic] = channel
            return channel

    @property
    def status(self) -> RecorderStatus:
        """What the recorder is doing; cheap enough for every turn of a loop."""
        behind_ns = 0 if self._state is RecorderState.CLOSED else time.monotonic_ns() - self._settled_ns
        return RecorderStatus(
            self._state, self._cause, self._written, len(self._queue), behind_ns * _NANO,
            dict(self._overflowed), self._refused, self._refusal,
        )  # fmt: skip

    def close(self, timeout_s: float = 60.0) -> RecorderStatus:
        """Write what is queued, finish the file under its own name, and say how that went. Closing twice is harmless.

        Where the disk does not recover, or does not answer for `timeout_s`, the partial file stays where it is.
        """
        self._ending.set()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self._fail(f"the disk has not answered for {timeout_s:g} s")
        elif self._state is RecorderState.RECORDING:
            try:
                finish(self.partial, self.path, self._written)
                self._state = RecorderState.CLOSED
            except InputError as error:
                self._fail(str(error))
        return self.status

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _create(self) -> int:
        require_writable(self.path)
        for there, rule in (
            (self.path, "is there already: a recording is never overwritten"),
            (self.partial, "is there already: recover it with `needleplan recording recover`, or remove it"),
        ):
            if there.exists():
                raise OutputError(rule, str(there))
        try:
            return os.open(self.partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"cannot be written: {reason}", str(self.partial)) from error

    def _accept(self, entry: tuple[Channel, int, int, Any]) -> bool:
        while len(self._queue) >= self._capacity or self._ending.is_set() or self._state is RecorderState.FAILED:
            if not self._wait or self._ending.is_set() or self._state is not RecorderState.RECORDING:
                self._overflowed[entry[0].topic] += 1
                return False
            time.sleep(0.001)
        self._queue.append(entry)
        return True

    def _run(self) -> None:
        try:
            ending = False
            while not ending:
                ending = self._ending.wait(_RETRY_S if self._state is RecorderState.STALLED else _PERIOD_S)
                self._turn(ending)
        except BaseException as error:  # whatever it was, the loop that puts must only see it in the status
            self._fail(f"the writer ended: {error!r}")
        finally:
            with contextlib.suppress(OSError):
                os.close(self._descriptor)

    def _turn(self, ending: bool) -> None:
        """Write all that is queued now; on a failing disk only what is in the chunk in progress."""
        began_ns = time.monotonic_ns()
        try:
            if self._state is RecorderState.STALLED:
                self._flush()
                self._state, self._cause = RecorderState.RECORDING, ""
            with self._lock:
                self._tell()
            left = len(self._queue)
            while left:
                with self._lock:
                    for _ in range(min(left, _BURST)):
                        self._add(*self._queue.popleft())
                        left -= 1
                        if self._journal.size >= _CHUNK_BYTES:
                            break
                self._flush()
                if not left and ending:
                    left = len(self._queue)
            if ending:
                self._tell(RecorderState.CLOSED)
            self._flush()
            self._settled_ns = began_ns
        except OSError as error:
            self._state, self._cause = RecorderState.STALLED, error.strerror or str(error)
            if ending:
                self._fail(f"{self._cause}; {len(self._queue) + self._journal.unwritten} messages were not written")

    def _flush(self) -> None:
        count = self._journal.unwritten
        self._journal.flush()
        self._written += count

    def _add(self, channel: Channel, sequence: int, time_ns: int, value: Any) -> None:
        try:
            wall_ns = self.session.wall_of(int(time_ns))
            if wall_ns >= _LATEST_NS:
                raise ValueError(f"{time_ns} ns is no time")
            data = channel.kind.encode(value)
        except Exception as error:  # a value that cannot be encoded must not end the recording of the others
            self._refused += 1
            self._refusal = self._refusal or f"{channel.topic}: {error!r}"
            return
        self._latest_ns = max(self._latest_ns, wall_ns)
        self._journal.add(channel.number, sequence, wall_ns, data)

    def _tell(self, state: RecorderState | None = None) -> None:
        """Put a message of its own into the chunk where something has changed."""
        state = state or self._state
        now = (state, self._cause, sum(self._overflowed.values()), self._refused)
        if now == self._told:
            return
        self._told = now
        self._told_count += 1
        message = {
            "state": state, "cause": self._cause, "written": self._written,
            "overflowed": dict(self._overflowed), "refused": self._refused, "refusal": self._refusal,
        }  # fmt: skip
        self._journal.add(self._own.number, self._told_count, self._latest_ns, STATUS.encode(message))

    def _fail(self, cause: str) -> None:
        self._state, self._cause = RecorderState.FAILED, cause
