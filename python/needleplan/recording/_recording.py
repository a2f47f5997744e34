"""Reading a recording: the description of the run, and the messages in the order of their times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.reader import SeekingReader
from mcap.records import Channel as McapChannel
from mcap.records import Schema

from needleplan.artifacts import CallRepr, path_text, short_html
from needleplan.errors import DataError, InputError, Mistake
from needleplan.recording._align import align, trial_of_channels
from needleplan.recording._data_files import PathLike
from needleplan.recording._journal import SESSION, Session
from needleplan.recording._message_kinds import Json, MessageKind, Packed
from needleplan.recording._plot import plot_channels
from needleplan.recording._sample_kinds import FIBRE, FORCE, IMAGE, POSE, STAGE
from needleplan.recording.mcap_bytes import mapped, require_intact, topic_chunks
from needleplan.signals import Record, RecordFrame, Role

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["RecordedMessage", "Recording"]

# Number of messages that are decoded at once into columns
_BLOCK_MESSAGES = 65_536


@dataclass(frozen=True)
class RecordedMessage(CallRepr):
    """One message of a recording.

    Attributes
    ----------
    topic : str
        Name of the channel, such as `/force`.
    time_ns : int
        Time on the monotonic clock of the recording machine, ns.
    sequence : int
        Number of the message within its topic, counted from 1; a gap means lost or refused messages.
    values : dict
        The fields of the message by name.

    Examples
    --------
    >>> from needleplan.recording import RecordedMessage
    >>> RecordedMessage("/event", 5_000, 1, {"name": "begin"}).values["name"]
    'begin'
    """

    topic: str
    time_ns: int
    sequence: int
    values: dict[str, Any]


@dataclass(frozen=True, repr=False)
class Recording:
    """A finished recording; `Recording.read` opens it and verifies every byte.

    Attributes
    ----------
    path : Path
        The file.
    session : Session
        Description of the run: title, digests of the files that the run used, clocks.
    counts : mapping of str to int
        Number of messages by topic.
    kinds : mapping of str to MessageKind
        Encoding of the messages by topic.
    start_ns, end_ns : int
        Time of the first and of the last message on the monotonic clock, ns.
    recovery : mapping of str to str or None
        Result of the recovery; None if the recorder closed the recording itself.

    Examples
    --------
    Record an event and the samples of a force sensor and a stage:

    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.devices import ForceSample, PoseSample, StageSample, Stamp
    >>> from needleplan.recording import EVENT, FORCE, POSE, STAGE, Recorder, Recording
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "run.mcap"
    >>> with Recorder(path) as recorder:
    ...     start_ns = recorder.session.monotonic_ns
    ...     _ = recorder.channel("/event", EVENT).put(start_ns, {"name": "begin", "cause": "operator"})
    ...     force, stage = recorder.channel("/force", FORCE), recorder.channel("/stage", STAGE)
    ...     pose = recorder.channel("/pose", POSE)
    ...     for number in range(3):
    ...         stamp = Stamp(start_ns + number * 1_000_000_000, number)
    ...         _ = force.put(stamp.received_ns, ForceSample(stamp, (0.0, 0.0, 0.5 * number), (0.0, 0.0, 0.0)))
    ...         _ = stage.put(stamp.received_ns, StageSample(stamp, 5.0 * number, 5.0, 0.0, moving=True))
    ...         _ = pose.put(stamp.received_ns, PoseSample(stamp, (0.0, 0.0, number / 10), (1.0, 0.0, 0.0, 0.0), 0.0))

    Read the recording:

    >>> recording = Recording.read(path)
    >>> recording
    <Recording run.mcap: 5 topics, 12 messages, 2 s>
    >>> [message.values["cause"] for message in recording.messages(["/event"])]
    ['operator']
    >>> recording.is_table("/force"), recording.is_table("/event")
    (True, False)
    >>> recording.columns("/stage")["depth_mm"].tolist()
    [0.0, 5.0, 10.0]
    >>> recording.trial()["force_n"].tolist()
    [0.0, 0.5, 1.0]
    >>> recording.tracker_noise()["z_mm"].tolist()
    [0.0, 0.1, 0.2]
    >>> [axes.get_ylabel() for axes in recording.plot()]
    ['force (N)', 'depth (mm)', 'position (mm)', 'axial force (N)']
    >>> folder.cleanup()

    """

    path: Path
    session: Session
    counts: Mapping[str, int]
    kinds: Mapping[str, MessageKind] = field(repr=False)
    start_ns: int
    end_ns: int
    recovery: Mapping[str, str] | None = None

    _repr_html_ = short_html

    def __repr__(self) -> str:
        messages = sum(self.counts.values())
        return (
            f"<Recording {self.path.name}: {len(self.counts)} topics, {messages:,} messages, {self.duration_s:.4g} s>"
        )

    @classmethod
    def read(cls, path: PathLike) -> Recording:
        """Open a recording and verify its checksums.

        Parameters
        ----------
        path : str or path
            The MCAP file.

        Returns
        -------
        Recording
            The recording; its messages are read from the file on demand.

        Raises
        ------
        DataError
            The file cannot be read, is cut, is damaged, is still being written, or is not a recording of needleplan.

        """
        source = path_text(path, DataError)
        try:
            with Path(path).open("rb") as stream:
                require_intact(stream, source)
                stream.seek(0)
                reader = SeekingReader(stream, validate_crcs=True)
                summary = reader.get_summary()
                if summary is None or summary.statistics is None:
                    raise DataError("has no summary", source)
                metadata = {each.name: each.metadata for each in reader.iter_metadata()}
                (stored,) = [each.data for _, _, each in reader.iter_messages("/session")][:1] or [b"{}"]
                statistics = summary.statistics
                counts = {
                    each.topic: statistics.channel_message_counts.get(number, 0)
                    for number, each in summary.channels.items()
                    if each.topic != "/session"
                }
                kinds = {
                    channel.topic: _kind(channel, summary.schemas[channel.schema_id], source)
                    for channel in summary.channels.values()
                }
        except InputError:
            raise
        except OSError as error:
            raise DataError(f"cannot be read: {error.strerror}", source) from error
        except Exception as error:  # the checksums agree, but the file may come from another program
            raise DataError(f"is not a recording of needleplan: {error!r}", source) from error
        session = Session.from_dict(SESSION.decode(stored), source)
        start_ns = session.monotonic_of(statistics.message_start_time)
        end_ns = session.monotonic_of(statistics.message_end_time)
        return cls(Path(path), session, counts, kinds, start_ns, end_ns, metadata.get("needleplan.recovery"))

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last, s."""
        return (self.end_ns - self.start_ns) * 1e-9

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[RecordedMessage]:
        """Return an iterator over the messages in the order of their times.

        Messages with equal times keep the order in which they were written.

        Parameters
        ----------
        topics : iterable of str, optional
            The topics to read; by default all.

        Returns
        -------
        iterator of RecordedMessage
            The messages.

        Raises
        ------
        DataError
            The recording lacks a topic. The iterator raises it too, if a message cannot be decoded.

        """
        chosen = list(self.counts) if topics is None else list(topics)
        self._require_topics(chosen)
        return self._messages(chosen)

    def columns(self, topic: str) -> dict[str, Any]:
        """Return the messages of one topic as columns.

        Parameters
        ----------
        topic : str
            A topic with messages of the kind `Packed`, such as `/force`.

        Returns
        -------
        dict of str to ndarray
            One array of shape (messages,) for each field, and `time_s`, the time since the start of the recording.
            Without messages, only `time_s`.

        Raises
        ------
        DataError
            The recording lacks the topic, its messages are not `Packed`, or a message cannot be decoded.

        """
        self._require_topics([topic])
        if not self.is_table(topic):
            rule = "must be a topic of packed messages; read JSON messages with messages()"
            raise DataError(Mistake("topic", topic, rule), str(self.path))
        times, blocks, waiting = list[Any](), list[dict[str, Any]](), list[bytes]()
        kind = self.kinds[topic]
        assert isinstance(kind, Packed)
        with mapped(self.path) as data:
            for times_ns, bodies in topic_chunks(data, topic, str(self.path)):
                times.append(np.array(times_ns, np.int64))
                waiting += bodies
                if len(waiting) >= _BLOCK_MESSAGES:
                    blocks.append(kind.decode_block(waiting))
                    waiting = []
        if waiting:
            blocks.append(kind.decode_block(waiting))
        if sum(map(len, times)) != self.counts[topic]:
            raise DataError("has changed since it was opened", str(self.path))
        if not blocks:
            return {"time_s": np.zeros(0)}
        time_ns = np.concatenate(times)
        order = None if np.all(time_ns[1:] >= time_ns[:-1]) else np.argsort(time_ns, kind="stable")
        columns: dict[str, Any] = {"time_s": (time_ns - self.session.wall_of(self.start_ns)) * 1e-9}
        for name in list(blocks[0]):
            column = np.concatenate([block.pop(name) for block in blocks])  # so a block is freed column by column
            is_long = column.dtype == np.uint64 and column.max() <= np.iinfo(np.int64).max
            columns[name] = column.astype(np.int64) if is_long else column
        return columns if order is None else {name: column[order] for name, column in columns.items()}

    def is_table(self, topic: str) -> bool:
        """Return whether the messages of a topic are `Packed`, so that `columns` reads them.

        Parameters
        ----------
        topic : str
            A topic of the recording.

        Returns
        -------
        bool
            False for JSON messages.

        Raises
        ------
        KeyError
            The recording lacks the topic.

        """
        return isinstance(self.kinds[topic], Packed)

    def trial(self) -> Record:
        """Return the samples of force sensor, stage and tracker as one trial, in the columns of the data files.

        The trial has the times of the force sensor, else of the stage, else of the tracker; other columns are
        interpolated to these times. Force and torque are the components along and about the session's `force_axis`.
        Positions are in the frame of the tracker. If several topics have one kind, the first in alphabetical order is
        used. Topics with fewer than two samples are ignored.

        Returns
        -------
        Record
            The trial. The numbers of samples that are not good are NaN; samples with repeated or decreasing times are
            left out. The notes count both.

        Raises
        ------
        DataError
            The recording has no topic of the three kinds with two samples, or their times do not overlap.

        """
        kinds = (FORCE.name, STAGE.name, POSE.name, FIBRE.name, IMAGE.name)
        channels = [
            (topic, self.kinds[topic].name, self.columns(topic))
            for topic, count in self.counts.items()
            if self.kinds[topic].name in kinds and count > 1
        ]
        trial = trial_of_channels(channels, self.session.force_axis, str(self.path))
        return replace(trial, trial=self.session.title or self.path.stem)

    def tracker_noise(self) -> Record:
        """Return the positions of the tracker as a record of its noise, with the depth of the stage.

        Returns
        -------
        Record
            Positions (mm) in the frame of the tracker, of the good poses during samples of the stage.

        Raises
        ------
        DataError
            The recording has no topic /pose or /stage, or no two good poses during samples of the stage.

        """
        poses, stage = self.columns("/pose"), self.columns("/stage")
        good = poses["health"] == "good"
        tracked = Record({name: poses[name][good] for name in ("time_s", "x_mm", "y_mm", "z_mm")}, self.path.stem)
        depth = Record({name: stage[name] for name in ("time_s", "depth_mm")}, self.path.stem)
        return replace(align(tracked, depth), role=Role.NOISE, frame=RecordFrame())

    def plot(self, topics: Iterable[str] | None = None) -> list[Axes]:
        """Draw channels over time, and the force over the depth if the recording has both.

        Parameters
        ----------
        topics : iterable of str, optional
            The topics to draw, one panel each; by default the samples of force sensors, stages and trackers.

        Returns
        -------
        list of matplotlib.axes.Axes
            One axes for each topic in the given order, then the axes of the force along the session's `force_axis` over
            the depth. `axes[0].figure` is the figure.

        Raises
        ------
        DataError
            The recording lacks a topic, a topic has JSON messages, or there are no samples to draw.

        """
        kinds = (FORCE.name, STAGE.name, POSE.name)
        chosen = [count for count in self.counts if self.kinds[count].name in kinds] if topics is None else list(topics)
        self._require_topics(chosen)
        channels = [(topic, self.kinds[topic].name, self.columns(topic)) for topic in chosen if self.counts[topic]]
        if not channels:
            raise DataError("holds no samples to draw", str(self.path))
        trial = None
        if {FORCE.name, STAGE.name} <= {kind for _, kind, _ in channels}:
            drawn = [channel for channel in channels if channel[2]["time_s"].size > 1 and channel[1] in kinds]
            try:
                trial = trial_of_channels(drawn, self.session.force_axis, str(self.path))
            except DataError:  # force sensor and stage were not recorded at the same time
                trial = None
        return plot_channels(channels, trial, self.session.title or self.path.stem)

    def _require_topics(self, topics: Iterable[str]) -> None:
        missing = [Mistake("topic", topic, f"must be one of {', '.join(sorted(self.counts))}") for topic in topics
                   if topic not in self.counts]  # fmt: skip
        if missing:
            raise DataError(missing, str(self.path))

    def _messages(self, topics: list[str]) -> Iterator[RecordedMessage]:
        if not topics:
            return
        with self.path.open("rb") as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            for _, channel, each in reader.iter_messages(topics, log_time_order=True):
                values = self.kinds[channel.topic].decode(each.data)
                yield RecordedMessage(channel.topic, self.session.monotonic_of(each.log_time), each.sequence, values)


def _kind(channel: McapChannel, schema: Schema, source: str) -> MessageKind:
    if channel.message_encoding == "cdr" and schema.encoding == "ros2msg":
        return Packed.from_schema(schema.name, schema.data)
    if channel.message_encoding == "json":
        return Json(schema.name)
    raise DataError(Mistake(channel.topic, channel.message_encoding, "must be cdr or json"), source)
