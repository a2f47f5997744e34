"""Settings and status of a recorder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from needleplan.artifacts import CallRepr

__all__ = ["RecorderState", "RecorderStatus", "WhenFull"]


class RecorderState(StrEnum):
    """State of the writer.

    Examples
    --------
    >>> from needleplan.recording import RecorderState
    >>> RecorderState("stalled") is RecorderState.STALLED
    True
    """

    RECORDING = "recording"
    STALLED = "stalled"
    """Writing fails, for example on a full disk, and is retried; messages that exceed the queue are lost."""

    FAILED = "failed"
    """The writer has stopped, or the file could not be finished; the partial file holds the messages written so far."""

    CLOSED = "closed"


class WhenFull(StrEnum):
    """Behaviour of `RecordingChannel.put` if the queue is full.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import Recorder, WhenFull
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Recorder(Path(folder) / "run.mcap", when_full=WhenFull.WAIT).close().ok
    True
    """

    DROP = "drop"
    """Count the message as lost and return at once; for runs in real time."""

    WAIT = "wait"
    """Wait until the queue has space, or until writing fails (then the message is lost); for simulated runs, which
    produce messages faster than a disk can write them."""


@dataclass(frozen=True)
class RecorderStatus(CallRepr):
    """Status of a recorder.

    Attributes
    ----------
    state : RecorderState
        State of the writer.
    cause : str
        Reason of the state `STALLED` or `FAILED`.
    written : int
        Number of messages written to the file (they may not yet be on the disk).
    queued : int
        Number of messages in the queue.
    behind_s : float
        Upper bound on the age of the oldest unwritten message, s; about 0.02 in normal operation, 0 when closed.
    overflowed : mapping of str to int
        Number of messages lost by topic, because the queue was full or the writer had failed.
    refused : int
        Number of messages that could not be encoded or had an impossible time.
    refusal : str
        Reason why the first of these messages was refused.

    Examples
    --------
    >>> from needleplan.recording import RecorderState, RecorderStatus
    >>> RecorderStatus(RecorderState.RECORDING, "", 100, 2, 0.01).ok
    True
    >>> RecorderStatus(RecorderState.RECORDING, "", 100, 2, 0.01, overflowed={"/force": 3}).ok
    False
    """

    state: RecorderState
    cause: str
    written: int
    queued: int
    behind_s: float
    overflowed: Mapping[str, int] = field(default_factory=dict)
    refused: int = 0
    refusal: str = ""

    @property
    def missing(self) -> str:
        """What is missing in the recording and why, as one text; empty if nothing is missing."""
        lost = [f"{count:,} messages of {topic} were lost" for topic, count in self.overflowed.items()]
        refused = [f"{self.refused:,} messages were refused: {self.refusal}"] if self.refused else []
        return "; ".join([*([self.cause] if self.cause else []), *lost, *refused])

    @property
    def ok(self) -> bool:
        """Whether the recorder works and no message was lost or refused so far."""
        good = self.state in (RecorderState.RECORDING, RecorderState.CLOSED)
        return good and not self.overflowed and not self.refused
