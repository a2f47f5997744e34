"""Recording of a run: samples, tip estimates, commands, decisions, events and guard events, by topic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from needleplan.control._events import CommandKind, ExecutedStep, Listener, RunCommand, RunEvent
from needleplan.control._options import RunSetup
from needleplan.control.safety import SafetyEvent
from needleplan.devices import (
    Clock,
    Closing,
    FibreSample,
    ForceSample,
    ImageSample,
    PoseSample,
    Sample,
    StageSample,
    VirtualClock,
)
from needleplan.estimation.tip import TipEstimate, TipStatus
from needleplan.planning import Action, Table
from needleplan.recording import (
    EVENT,
    FIBRE,
    FORCE,
    IMAGE,
    POSE,
    STAGE,
    Field,
    Json,
    Packed,
    PathLike,
    Recorder,
    RecorderStatus,
    Session,
    WhenFull,
)

__all__ = ["COMMAND", "DECISION", "TIP", "TOPICS", "RunRecorder", "decision_of"]

_TIP_NUMBERS = (
    "x_mm", "y_mm", "z_mm", "heading_rad", "elevation_rad", "roll_rad", "curvature_per_mm", "x_sd_mm", "y_sd_mm",
    "z_sd_mm", "heading_sd_rad", "elevation_sd_rad", "roll_sd_rad", "curvature_sd_per_mm", "depth_mm", "pose_age_s",
)  # fmt: skip


def _tip_row(tip: TipEstimate) -> tuple[Any, ...]:
    return (tip.time_ns, *(getattr(tip, name) for name in _TIP_NUMBERS), str(tip.status))


def _command_row(command: RunCommand) -> tuple[Any, ...]:
    return (command.time_ns, command.goal, command.speed, str(command.kind))


TIP = Packed(
    "needleplan_msgs/msg/Tip",
    (Field("time_ns", "int64"), *(Field(name) for name in _TIP_NUMBERS),
     Field("status", "uint8", tuple(map(str, TipStatus)))),
    _tip_row,
)  # fmt: skip
"""Format of the messages on the topic /tip: the estimated tip in the plan frame."""

COMMAND = Packed(
    "needleplan_msgs/msg/RunCommand",
    (Field("sent_ns", "int64"), Field("goal", comment="mm, or rad"), Field("speed", comment="mm/s, or rad/s"),
     Field("kind", "uint8", tuple(map(str, CommandKind)))),
    _command_row,
)  # fmt: skip
"""Format of the messages on the topic /command: the commands that the stage has accepted."""

DECISION = Json(
    "needleplan.Decision",
    {
        "number": {"type": "integer"},
        "action": {"type": "string"},
        "state": {"type": "array", "items": {"type": "integer"}},
        "value": {"type": "number"},
        "success": {"type": "number"},
    },
)
"""Format of the messages on the topic /decision; the entries of a message are those of `decision_of`."""

TOPICS = {"/stage": STAGE, "/force": FORCE, "/pose": POSE, "/tip": TIP, "/command": COMMAND, "/decision": DECISION,
          "/event": EVENT, "/safety": EVENT}  # fmt: skip


_SAMPLES = {"/stage": StageSample, "/force": ForceSample, "/pose": PoseSample, "/fibre": FibreSample,
            "/image": ImageSample}  # fmt: skip


def decision_of(step: ExecutedStep) -> dict[str, Any]:
    """Return a decision as a message for the topic /decision."""
    return {
        "number": step.number, "action": step.action.name.lower(), "state": list(step.state), "value": step.value,
        "success": step.success, "length_mm": step.length_mm, "path_mm": step.path_mm,
        "pose": [*step.pose], "table": step.table_digest, "latency_s": step.latency_s,
        "tip": asdict(step.estimate), "turn": step.action is Action.ROTATE,
    }  # fmt: skip


class RunRecorder(Listener, Closing):
    """Listener that writes a run to the file `path`. Raises OutputError if the file cannot be opened.

    Samples are stored in the order in which the loop received them; a replay depends on this order. On simulated time
    the recorder waits for the disk. On real time the recorder drops messages if the disk is too slow, and counts the
    dropped messages in its status.
    """

    def __init__(
        self,
        path: PathLike,
        table: Table,
        setup: RunSetup,
        clock: Clock,
        title: str = "",
        *,
        overwrite: bool = False,
    ) -> None:
        self._clock = clock
        self._simulated = isinstance(clock, VirtualClock)
        digests: Mapping[str, str] = {"scenario": table.scenario.digest, "table": table.digest} | setup.digests
        texts = table.scenario.texts()
        session = Session(
            title or table.scenario.title, digests, texts | setup.texts,
            setup.options.force_axis, monotonic_ns=clock.now_ns(),
        )  # fmt: skip
        when_full = WhenFull.WAIT if self._simulated else WhenFull.DROP
        self.recorder: Recorder = Recorder(path, session, when_full=when_full, overwrite=overwrite)
        self._topics = {topic: self.recorder.channel(topic, kind) for topic, kind in TOPICS.items()}
        self._last_ns = 0

    def sample(self, sample: Sample) -> None:
        """Record a sample, with a time that is not earlier than the time of the sample before."""
        topic = next(topic for topic, kind in _SAMPLES.items() if isinstance(sample, kind))
        if topic not in self._topics:
            self._topics[topic] = self.recorder.channel(topic, FIBRE if topic == "/fibre" else IMAGE)
        # A sample may have an earlier stamp than the sample of another device before it. A replay needs the order in
        # which the loop received them, so stored times must not decrease.
        self._last_ns = max(sample.stamp.received_ns, self._last_ns)
        self._topics[topic].put(self._last_ns, sample)

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Record a tip estimate."""
        self._topics["/tip"].put(time_ns, tip)

    def command(self, command: RunCommand) -> None:
        """Record a command."""
        self._topics["/command"].put(command.time_ns, command)

    def step(self, step: ExecutedStep) -> None:
        """Record a decision."""
        self._topics["/decision"].put(step.time_ns, decision_of(step))

    def event(self, event: RunEvent) -> None:
        """Record an event of the run."""
        entry = {"name": event.name, "cause": event.cause, "text": event.text, "step": event.step}
        self._topics["/event"].put(event.time_ns, entry | ({"digest": event.digest} if event.digest else {}))

    def safety(self, event: SafetyEvent) -> None:
        """Record an event of the guard; NaN and infinite values become null."""
        values = {name: value if not isinstance(value, float) or math.isfinite(value) else None
                  for name, value in event.entry().items()}  # fmt: skip
        self._topics["/safety"].put(event.time_ns, values)

    def status(self) -> RecorderStatus | None:
        """Return the status of the recorder; None on simulated time, where no message can be dropped."""
        return None if self._simulated else self.recorder.status

    def close(self) -> None:
        """Write the rest of the file and close it. Closing twice is harmless."""
        self.recorder.close()

    @property
    def missing(self) -> str:
        """List of a disk failure, lost and refused messages as one text; empty if the recording is complete."""
        return self.recorder.status.missing

    @property
    def file(self) -> Path | None:
        """The file that holds the recording, `*.partial` if it could not be finished; None if it does not exist."""
        return self.recorder.file
