"""Recording a run without delaying it.

`RecordingChannel.put` appends to a bounded queue and returns. The writer thread encodes the values and gives a chunk to
the operating system at least every 20 ms, so that a killed process loses the messages of at most 20 ms if the disk
responds. A power failure may lose more, because the file is flushed to the disk only at the end. With each chunk it
writes how many messages were put, so that a recovery can state how many are missing. A slow disk, a full disk and a
failed writer do not raise exceptions; `Recorder.status` reports them.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import Counter, deque
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from needleplan.artifacts import require_writable
from needleplan.errors import InputError, Mistake, OutputError
from needleplan.recording._data_files import PathLike
from needleplan.recording._journal import Counts, Journal, Session
from needleplan.recording._message_kinds import MessageKind
from needleplan.recording._recorder_status import RecorderState, RecorderStatus, WhenFull
from needleplan.recording._recovery import finish
from needleplan.recording._sample_kinds import STATUS

__all__ = ["PARTIAL", "Recorder", "RecordingChannel"]

PARTIAL = ".partial"
_PERIOD_S = 0.015  # time (s) between two writes of the queued messages
_RETRY_S = 0.1  # time (s) between two attempts to write while writing fails
_CHUNK_BYTES = 16_384  # size (bytes) at which a chunk is written
_BURST = 512  # number of messages after which a chunk is written, so that a long queue does not give a huge chunk
_CAPACITY = 16_384  # default capacity of the queue, in messages
_NANO = 1e-9
_LATEST_NS = 2**63  # time of day (ns) from which a message is refused: the file stores signed 64-bit integers


class RecordingChannel:
    """One topic of a recording, created by `Recorder.channel`; only one thread may call its `put`.

    Parameters
    ----------
    recorder : Recorder
        The recorder.
    topic : str
        Name, such as `/force`.
    kind : MessageKind
        Encoding of the values.
    number : int
        Number of the channel in the file.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import EVENT, Recorder
    >>> with tempfile.TemporaryDirectory() as folder, Recorder(Path(folder) / "run.mcap") as recorder:
    ...     channel = recorder.channel("/event", EVENT)
    ...     channel.put(recorder.session.monotonic_ns, {"name": "begin"})
    True
    """

    def __init__(self, recorder: Recorder, topic: str, kind: MessageKind, number: int) -> None:
        self.topic = topic
        self.kind = kind
        self.number = number
        self._recorder = recorder
        self.count: int = 0
        """Number of messages put so far, including lost ones."""
        self.last_ns: int = 0
        """Time of the last message put, on the monotonic clock, ns."""

    def put(self, time_ns: int, value: Any) -> bool:
        """Record a value; never raises, and waits only if the queue is full and the recorder has `WhenFull.WAIT`.

        Parameters
        ----------
        time_ns : int
            Time of the value on the monotonic clock, ns.
        value : object
            A value of the channel's kind. Another thread encodes it later, so do not change the value after the call.

        Returns
        -------
        bool
            False if the value is lost, because the queue is full, or the recorder is closed or has failed.

        """
        self.count += 1
        self.last_ns = time_ns
        return self._recorder._accept((self, self.count, time_ns, value))


class Recorder:
    """Writes a recording. Call `close` at the end, or use the recorder in a `with` statement.

    Until the recorder is closed, the file has the suffix `.partial`. If closing fails, it keeps this suffix.

    Parameters
    ----------
    path : str or path
        The recording to write.
    session : Session, optional
        Description of the run.
    capacity : int
        Capacity of the queue, messages.
    when_full : WhenFull
        Behaviour of `RecordingChannel.put` if the queue is full.
    overwrite : bool
        Whether closing may replace an existing recording at `path`.

    Raises
    ------
    OutputError
        The file cannot be written, `path` exists and may not be replaced, or a partial file of `path` exists.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import Field, Packed, Recorder
    >>> folder = tempfile.TemporaryDirectory()
    >>> tip = Packed("needleplan_msgs/msg/Tip", (Field("x_mm"), Field("y_mm")))
    >>> with Recorder(Path(folder.name) / "run.mcap") as recorder:
    ...     channel = recorder.channel("/tip", tip)
    ...     _ = channel.put(recorder.session.monotonic_ns, {"x_mm": 1.0, "y_mm": 0.0})
    >>> str(recorder.status.state), recorder.status.ok
    ('closed', True)
    >>> folder.cleanup()

    """

    def __init__(
        self,
        path: PathLike,
        session: Session | None = None,
        *,
        capacity: int = _CAPACITY,
        when_full: WhenFull = WhenFull.DROP,
        overwrite: bool = False,
    ) -> None:
        self.path: Path = Path(path)
        self.partial: Path = self.path.with_name(self.path.name + PARTIAL)
        self.session: Session = session or Session()
        self._capacity = capacity
        self._overwrite = overwrite
        self._wait = when_full is WhenFull.WAIT
        self._queue: deque[tuple[RecordingChannel, int, int, Any]] = deque()
        self._overflowed: Counter[str] = Counter()
        self._refused, self._refusal = 0, ""
        self._written = 0
        self._state, self._cause = RecorderState.RECORDING, ""
        self._recorded_status: tuple[object, ...] = ()
        self._recorded_statuses = 0
        self._up_to_date_ns = time.monotonic_ns()
        self._latest_ns = self.session.wall_ns
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._descriptor = self._create(overwrite)
        try:
            self._journal = Journal(self._descriptor, self.session)
        except OSError as error:
            os.close(self._descriptor)
            self.partial.unlink(missing_ok=True)
            raise OutputError(Mistake("", "", f"cannot be written: {error.strerror}"), str(self.partial)) from error
        self._own = RecordingChannel(self, "/recorder", STATUS, self._journal.define("/recorder", STATUS))
        self._channels: dict[str, RecordingChannel] = {"/recorder": self._own}
        self._write_queue(closing=False)  # a run that is killed at once can be recovered: the session is in the file
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def channel(self, topic: str, kind: MessageKind) -> RecordingChannel:
        """Add a topic to the recording.

        Parameters
        ----------
        topic : str
            Name, such as `/force`; must begin with `/`.
        kind : MessageKind
            Encoding of the values.

        Returns
        -------
        RecordingChannel
            The channel to put values into.

        Raises
        ------
        OutputError
            The topic exists already, or its name is wrong.

        """
        with self._lock:
            if not topic.startswith("/") or topic in self._channels or topic == "/session":
                rule = "must begin with / and be new: /session and /recorder are the recorder's own"
                raise OutputError(Mistake("topic", topic, rule), str(self.path))
            kind.schema  # noqa: B018  a wrong kind is refused here, not in the writer thread
            channel = RecordingChannel(self, topic, kind, self._journal.define(topic, kind))
            self._channels[topic] = channel
            return channel

    @property
    def status(self) -> RecorderStatus:
        """Present status of the recorder; fast enough to be read in every cycle of a control loop."""
        behind_ns = 0 if self._state is RecorderState.CLOSED else time.monotonic_ns() - self._up_to_date_ns
        return RecorderStatus(
            self._state, self._cause, self._written, len(self._queue), behind_ns * _NANO,
            dict(self._overflowed), self._refused, self._refusal,
        )  # fmt: skip

    def close(self, timeout_s: float = 60.0) -> RecorderStatus:
        """Write the queued messages and finish the file; closing again does nothing.

        If writing fails, does not end within `timeout_s`, or a file has appeared at `path`, the partial file is kept.

        Parameters
        ----------
        timeout_s : float
            Time to wait for the writer, s.

        Returns
        -------
        RecorderStatus
            The status; its state is `CLOSED` if the recording is complete, else `FAILED`.

        """
        self._closing.set()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self._fail(f"the disk has not responded for {timeout_s:g} s; {self._unwritten} messages were not written")
        elif self._state is RecorderState.RECORDING:
            try:
                finish(self.partial, self.path, self._written, overwrite=self._overwrite)
                self._state = RecorderState.CLOSED
            except InputError as error:
                self._fail(str(error))
        return self.status

    @property
    def file(self) -> Path | None:
        """The file that holds the recording: `path` if closed, else `partial`; None if the file does not exist."""
        file = self.path if self._state is RecorderState.CLOSED else self.partial
        return file if file.is_file() else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _create(self, overwrite: bool) -> int:
        require_writable(self.path)
        for there, rule in (
            (self.path, "is there already: a recording is never overwritten"),
            (self.partial, "is there already: recover it with `needleplan recording recover`, or remove it"),
        ):
            if there.exists() and not (overwrite and there == self.path):
                raise OutputError(rule, str(there))
        try:
            return os.open(self.partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"cannot be written: {reason}", str(self.partial)) from error

    def _accept(self, entry: tuple[RecordingChannel, int, int, Any]) -> bool:
        while len(self._queue) >= self._capacity or self._closing.is_set() or self._state is RecorderState.FAILED:
            if not self._wait or self._closing.is_set() or self._state is not RecorderState.RECORDING:
                self._overflowed[entry[0].topic] += 1
                return False
            time.sleep(0.001)
        self._queue.append(entry)
        return True

    def _run(self) -> None:
        try:
            closing = False
            while not closing:
                closing = self._closing.wait(_RETRY_S if self._state is RecorderState.STALLED else _PERIOD_S)
                self._write_queue(closing)
                self._count()
        except BaseException as error:  # any failure is reported by the status, not by an exception
            self._fail(f"the writer ended: {error!r}")
        finally:
            with contextlib.suppress(OSError):
                os.close(self._descriptor)

    def _write_queue(self, closing: bool) -> None:
        """Write all queued messages; if writing failed before, first write the present chunk again.

        A failure changes the state to STALLED, or to FAILED if `closing`.
        """
        began_ns = time.monotonic_ns()
        try:
            if self._state is RecorderState.STALLED:
                self._flush()
                self._state, self._cause = RecorderState.RECORDING, ""
            with self._lock:
                self._record_status()
            left = len(self._queue)
            while left:
                with self._lock:
                    for _ in range(min(left, _BURST)):
                        self._add(*self._queue.popleft())
                        left -= 1
                        if self._journal.size >= _CHUNK_BYTES:
                            break
                self._flush()
                if not left and closing:
                    left = len(self._queue)
            if closing:
                self._record_status(RecorderState.CLOSED)
            self._flush()
            self._up_to_date_ns = began_ns
        except OSError as error:
            self._state, self._cause = RecorderState.STALLED, error.strerror or str(error)
            if closing:
                self._fail(f"{self._cause}; {self._unwritten} messages were not written")

    def _count(self) -> None:
        with self._lock:
            channels = [each for each in self._channels.values() if each is not self._own]
        last_ns = 0
        for each in channels:
            with contextlib.suppress(TypeError):  # a time that is no number; such a message is refused
                wall_ns = self.session.wall_of(each.last_ns)
                last_ns = max(last_ns, wall_ns if each.count and wall_ns < _LATEST_NS else 0)
        self._journal.count(Counts({each.topic: each.count for each in channels}, dict(self._overflowed), last_ns))

    @property
    def _unwritten(self) -> int:
        return len(self._queue) + self._journal.unwritten

    def _flush(self) -> None:
        count = self._journal.unwritten
        self._journal.flush()
        self._written += count

    def _add(self, channel: RecordingChannel, sequence: int, time_ns: int, value: Any) -> None:
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

    def _record_status(self, state: RecorderState | None = None) -> None:
        """Add a message with the status to the topic `/recorder` if the status has changed."""
        state = state or self._state
        now = (state, self._cause, sum(self._overflowed.values()), self._refused)
        if now == self._recorded_status:
            return
        self._recorded_status = now
        self._recorded_statuses += 1
        message = {
            "state": state, "cause": self._cause, "written": self._written,
            "overflowed": dict(self._overflowed), "refused": self._refused, "refusal": self._refusal,
        }  # fmt: skip
        self._journal.add(self._own.number, self._recorded_statuses, self._latest_ns, STATUS.encode(message))

    def _fail(self, cause: str) -> None:
        self._state, self._cause = RecorderState.FAILED, cause
