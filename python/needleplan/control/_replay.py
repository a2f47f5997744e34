"""Replay: the loop runs on recorded samples, and the new decisions and commands are compared with the recorded ones.

The devices return the recorded samples on a virtual clock, in the order in which the loop received them. The stage
accepts every command and compares it with the recorded command. Decisions are compared in the same way.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from needleplan.artifacts import ShortRepr
from needleplan.control._events import CommandKind, ExecutedStep, Listener, RunEventName
from needleplan.control._insertion import Insertion
from needleplan.control._options import RunSetup
from needleplan.control._recorder import decision_of
from needleplan.control._replanning import FROM_TABLE_SET, Replanner, ThreadReplanner
from needleplan.control._report import InsertionOutcome, InsertionReport
from needleplan.control._table_set_replanning import TableSetReplanner
from needleplan.devices import (
    Feed,
    FibreSample,
    ForceSample,
    ForceSensor,
    Health,
    ImageSample,
    PoseSample,
    ReadDevice,
    Sample,
    Source,
    Stage,
    StageSample,
    Stamp,
    Station,
    Tracker,
    VirtualClock,
    read_directly,
)
from needleplan.errors import DataError, DeviceFault, Mistake
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.planning import Table
from needleplan.recording import Recording
from needleplan.signals import FIBRE_COLUMNS, IMAGE_COLUMNS
from needleplan.sweep import CurvatureLookup, TableSet

__all__ = [
    "RecordedForceSensor",
    "RecordedStage",
    "RecordedStation",
    "RecordedTracker",
    "ReplayComparison",
    "recorded_samples",
    "replay",
]

# relative and absolute difference up to which a replayed number equals the recorded number
_TOLERANCE = 1e-9
_NANO = 1_000_000_000
# entries of a decision that are compared
_COMPARED = ("action", "state", "value", "success", "length_mm", "path_mm", "pose", "table")

_Sample = TypeVar("_Sample", StageSample, ForceSample, PoseSample, FibreSample, ImageSample)


class _Tape(Generic[_Sample]):
    """Queue of the unread recorded samples of one device."""

    def __init__(self, clock: VirtualClock, samples: list[tuple[int, _Sample]]) -> None:
        self._clock = clock
        self._left: deque[tuple[int, _Sample]] = deque(samples)

    def read(self, timeout_s: float) -> _Sample | None:
        """Advance the clock to the arrival of the next sample, and return the sample.

        If the sample arrives after `timeout_s`, advance the clock by `timeout_s` and return None. Raises DeviceFault at
        the end of the recording.
        """
        if not self._left:
            raise DeviceFault(f"{type(self).__name__}: the recording is at its end")
        due_s = (self._left[0][0] - self._clock.now_ns()) / _NANO
        self._clock.advance(min(due_s, timeout_s))
        return self._left.popleft()[1] if due_s <= timeout_s else None

    def close(self) -> None:
        """Discard the remaining samples."""
        self._left.clear()


class RecordedStage(_Tape[StageSample], Stage):
    """Stage that returns the recorded samples, and adds a text to `differences` for each command that differs."""

    def __init__(
        self, clock: VirtualClock, samples: list[tuple[int, StageSample]], commands: list[dict[str, Any]]
    ) -> None:
        super().__init__(clock, samples)
        self._commands = deque(commands)
        self.differences: list[str] = []

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Compare the command with the next recorded command."""
        self._compare(CommandKind.INSERT, depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Compare the command with the next recorded command."""
        self._compare(CommandKind.ROTATE, roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Do nothing. The number of stops depends on the timing, so stops are not compared."""

    def _compare(self, kind: CommandKind, goal: float, speed: float) -> None:
        command = f"{kind} to {goal:.9g} at {speed:.9g}"
        if not self._commands:
            self.differences.append(f"{command}, but the recording has no further command")
            return
        its = self._commands.popleft()
        if (its["kind"], its["goal"], its["speed"]) != (str(kind), goal, speed):
            self.differences.append(
                f"{command}, but {its['kind']} to {its['goal']:.9g} at {its['speed']:.9g} in the recording"
            )


class RecordedForceSensor(_Tape[ForceSample], ForceSensor):
    """Force sensor that returns the recorded samples."""

    def bias(self) -> None:
        """Do nothing, because the bias has already been subtracted from the recorded samples."""


class RecordedTracker(_Tape[PoseSample], Tracker):
    """Tracker that returns the recorded poses."""


class _OrderedFeed(Feed):
    """Feed that reads the devices in the order in which the recorded loop received their samples."""

    def __init__(self, station: Station, order: list[Source], read: ReadDevice) -> None:
        self._devices, self._read = station.devices, read
        self._order = deque(order)

    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises DeviceFault at the end of the recording."""
        if not self._order:
            raise DeviceFault("the recording is at its end")
        source = self._order[0]
        sample = self._read(source, self._devices[source], timeout_s)
        if sample is not None:
            self._order.popleft()
        return sample

    def close(self) -> None:
        """Discard the remaining samples."""
        self._order.clear()


def recorded_samples(recording: Recording) -> Iterator[tuple[int, Sample]]:
    """Yield the samples of a recording with the times (ns) of their arrival, in the order of their arrival."""
    made: dict[str, Callable[[dict[str, Any]], Sample]] = {
        "/stage": _stage, "/force": _force, "/pose": _pose, "/fibre": _fibre, "/image": _image,
    }  # fmt: skip
    for message in recording.messages([topic for topic in made if topic in recording.counts]):
        yield message.time_ns, made[message.topic](message.values)


class RecordedStation(Station):
    """Station whose devices return the samples of a recording on a virtual clock.

    Raises DataError if the topic /stage, /force, /pose or /command is missing.
    """

    def __init__(
        self, recording: Recording, fibre: FibreSensors | None = None, plane: ImagePlane | None = None
    ) -> None:
        missing = [Mistake("topic", topic, "is missing") for topic in ("/stage", "/force", "/pose", "/command")
                   if topic not in recording.counts]  # fmt: skip
        if missing:
            raise DataError(missing, str(recording.path))
        clock = VirtualClock(recording.start_ns)
        stage: list[tuple[int, StageSample]] = []
        forces: list[tuple[int, ForceSample]] = []
        poses: list[tuple[int, PoseSample]] = []
        more: dict[Source, list[tuple[int, Any]]] = {}
        self._order: list[Source] = []
        for time_ns, sample in recorded_samples(recording):
            if isinstance(sample, StageSample):
                stage.append((time_ns, sample))
                self._order.append(Source.STAGE)
            elif isinstance(sample, ForceSample):
                forces.append((time_ns, sample))
                self._order.append(Source.FORCE)
            elif isinstance(sample, PoseSample):
                poses.append((time_ns, sample))
                self._order.append(Source.POSE)
            elif isinstance(sample, FibreSample) and fibre:
                seen = sample.curvatures_per_mm[: len(fibre.from_tip_mm)]
                more.setdefault(Source.FIBRE, []).append((time_ns, replace(sample, curvatures_per_mm=seen)))
                self._order.append(Source.FIBRE)
            elif isinstance(sample, ImageSample) and plane:
                more.setdefault(Source.IMAGE, []).append((time_ns, sample))
                self._order.append(Source.IMAGE)
        commands = [
            message.values for message in recording.messages(["/command"]) if message.values["kind"] != CommandKind.STOP
        ]
        self.recorded_stage: RecordedStage = RecordedStage(clock, stage, commands)
        super().__init__(
            self.recorded_stage, RecordedForceSensor(clock, forces), RecordedTracker(clock, poses), clock,
            more={source: _Tape(clock, samples) for source, samples in more.items()}, fibre=fibre, plane=plane,
        )  # fmt: skip

    def feed(self, read: ReadDevice = read_directly) -> Feed:
        """Return the feed of the samples, in the order in which the recorded loop received them."""
        return _OrderedFeed(self, self._order, read)


@dataclass(frozen=True)
class ReplayComparison(ShortRepr):
    """Result of a replay: report, number of `decisions` made, number of decisions `recorded`, and all differences.

    The differences are texts: first those of decisions, then of commands, then of the outcome.
    """

    report: InsertionReport
    decisions: int
    recorded: int
    differences: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether there are no differences, and the replay made as many decisions as the recorded run."""
        return not self.differences and self.decisions == self.recorded


class _Comparing(Listener):
    def __init__(self, recorded: list[dict[str, Any]]) -> None:
        self.recorded = recorded
        self.differences: list[str] = []

    def step(self, step: ExecutedStep) -> None:
        """Compare a decision with the recorded decision of the same number."""
        if step.number >= len(self.recorded):
            self.differences.append(f"decision {step.number}: the recording has none")
            return
        its, now = self.recorded[step.number], decision_of(step)
        for name in _COMPARED:
            if not _alike(now[name], its[name]):
                self.differences.append(f"decision {step.number}: {name} {now[name]}, in the recording {its[name]}")


def replay(recording: Recording, table: Table, table_set: TableSet | None = None) -> ReplayComparison:
    """Run the loop on recorded samples, and compare its decisions, commands and outcome with the recording.

    The outcome is not compared if the recorded run was stopped or failed, because its samples end too early. Recorded
    commands that the replay does not reach are not reported.

    Parameters
    ----------
    recording
        Recording of an insertion, written by `RunRecorder`.
    table
        The table that the insertion used.
    table_set
        The table set that the insertion used, if it used one.

    Returns
    -------
    ReplayComparison
        The report of the replay and all differences.

    Raises
    ------
    DataError
        If the recording is not from an insertion, lacks a topic or a setup text, was made with another table, or used
        a table set that is not given.

    """
    source = str(recording.path)
    setup = RunSetup.from_texts(recording.session.texts, source)
    if recording.session.digests.get("table") != table.digest:
        rule = f"must be equal to the digest of the table, {table.digest}"
        raise DataError(Mistake("digest.table", recording.session.digests.get("table", ""), rule), source)
    missing = [topic for topic in ("/decision", "/event") if topic not in recording.counts]
    if missing:
        raise DataError(Mistake("topic", ", ".join(missing), "is missing"), source)
    station = RecordedStation(recording, setup.fibre, setup.plane)
    listener = _Comparing([message.values for message in recording.messages(["/decision"])])
    events = [_renamed(message.values) for message in recording.messages(["/event"])]
    replanner = _replanner(events, table, table_set, source)
    insertion = Insertion(
        table, station, setup.options, registration=setup.registration, tip_settings=setup.tip_settings,
        limits=setup.limits, replanner=replanner, listeners=[listener],
        accepted_limits=setup.accepted or "the recorded run had them",
    )  # fmt: skip
    with insertion:
        report = insertion.run()
    differences = [*listener.differences, *station.recorded_stage.differences]
    ended = next((event["cause"] for event in events if event["name"] == RunEventName.END), "")
    # The recording of a stopped or failed run has no samples after its end, so the replay ends with a DeviceFault.
    cut = ended in (InsertionOutcome.STOPPED, InsertionOutcome.FAULT, InsertionOutcome.REFUSED, "")
    differences += _other_tables(report, events, cut=cut)
    if not cut and report.outcome != ended:
        differences.append(f"it ends with {report.outcome} ({report.cause}), in the recording with {ended}")
    if len(report.steps) < len(listener.recorded):
        differences.append(f"it made {len(report.steps)} decisions, in the recording {len(listener.recorded)}")
    return ReplayComparison(report, len(report.steps), len(listener.recorded), tuple(differences))


def _renamed(event: dict[str, Any]) -> dict[str, Any]:
    """Return an event with the present name of its cause: recordings of the first versions say "atlas"."""
    return event | {"cause": FROM_TABLE_SET} if event["cause"] == "atlas" else event


def _other_tables(report: InsertionReport, events: list[dict[str, Any]], *, cut: bool) -> list[str]:
    """Return a difference if the replay has followed other new tables than the recorded run, or at other decisions."""
    now = [
        (event.cause, event.step, event.digest) for event in report.events if event.name is RunEventName.TABLE_SWAPPED
    ]
    its = [
        (event["cause"], event["step"], event.get("digest", ""))
        for event in events if event["name"] == RunEventName.TABLE_SWAPPED
    ]  # fmt: skip
    if now == (its[: len(now)] if cut else its):
        return []

    def told(swaps: list[tuple[str, int, str]]) -> str:
        return ", ".join(f"{digest} ({cause}) before decision {step}" for cause, step, digest in swaps) or "none"

    return [f"it follows the new tables {told(now)}; in the recording {told(its)}"]


def _replanner(events: list[dict[str, Any]], table: Table, table_set: TableSet | None, source: str) -> Replanner:
    """Return a replanner that returns tables at the recorded decisions."""
    steps: dict[str, list[int]] = {"replan": [], FROM_TABLE_SET: []}
    for event in events:
        if event["name"] == RunEventName.TABLE_SWAPPED:
            steps[FROM_TABLE_SET if event["cause"] == FROM_TABLE_SET else "replan"].append(event["step"])
    fresh = ThreadReplanner(wait=True, at=steps["replan"])
    if not steps[FROM_TABLE_SET]:
        return fresh
    if table_set is None:
        raise DataError(Mistake("table set", "", "is missing: the insertion used its tables"), source)
    stored = CurvatureLookup(table_set, table.scenario)
    return TableSetReplanner(stored, table, fresh, wait=True, at=steps[FROM_TABLE_SET])


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and other is not None:
        return math.isclose(one, other, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    return bool(one == other)


def _stamp(values: dict[str, Any]) -> Stamp:
    device_time_s = values["device_time_s"]
    return Stamp(
        values["received_ns"], values["sequence"], values["lost"], None if math.isnan(device_time_s) else device_time_s
    )


def _end(values: dict[str, Any]) -> tuple[Health, tuple[str, ...]]:
    return Health(values["health"]), (values["notes"],) if values["notes"] else ()


def _stage(values: dict[str, Any]) -> StageSample:
    numbers = values["depth_mm"], values["velocity_mm_s"], values["roll_rad"]
    return StageSample(_stamp(values), *numbers, values["moving"], *_end(values))


def _force(values: dict[str, Any]) -> ForceSample:
    force = values["force_x_n"], values["force_y_n"], values["force_z_n"]
    torque = values["torque_x_n_mm"], values["torque_y_n_mm"], values["torque_z_n_mm"]
    return ForceSample(_stamp(values), force, torque, *_end(values))


def _fibre(values: dict[str, Any]) -> FibreSample:
    pairs = [(values[y], values[z]) for y, z in zip(FIBRE_COLUMNS[::2], FIBRE_COLUMNS[1::2], strict=True)]
    return FibreSample(_stamp(values), tuple(pairs), *_end(values))


def _image(values: dict[str, Any]) -> ImageSample:
    u, v = (values[name] for name in IMAGE_COLUMNS)
    return ImageSample(_stamp(values), u, v, *_end(values))


def _pose(values: dict[str, Any]) -> PoseSample:
    place = values["x_mm"], values["y_mm"], values["z_mm"]
    turn = values["qw"], values["qx"], values["qy"], values["qz"]
    return PoseSample(_stamp(values), place, turn, values["error_mm"], *_end(values))
