"""What a run tells those who listen: the recorder, the live view, the report."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from needleplan.control.safety import SafetyEvent
from needleplan.devices import Sample
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import Action, Pose
from needleplan.recording import RecorderStatus

__all__ = ["Command", "CommandKind", "Event", "EventName", "Listener", "Step"]


class EventName(StrEnum):
    """What may happen besides steps."""

    BEGIN = "begin"
    BIAS = "bias"
    REPLAN_ASKED = "replan_asked"
    REPLAN_DONE = "replan_done"
    REPLAN_REFUSED = "replan_refused"
    TABLE_SWAPPED = "table_swapped"
    PAUSED = "paused"
    RESUMED = "resumed"
    FAULT = "fault"
    STOP = "stop"
    END = "end"


@dataclass(frozen=True)
class Event:
    """Something happened, why, and a sentence; `step` is the number of the decision before which it was."""

    time_ns: int
    name: EventName
    cause: str
    text: str
    step: int
    digest: str = ""


class CommandKind(StrEnum):
    """What the stage was told."""

    INSERT = "insert"
    ROTATE = "rotate"
    STOP = "stop"


@dataclass(frozen=True)
class Command:
    """A command to the stage: where to, and the speed; mm and mm/s, or rad and rad/s. NaN for a stop."""

    time_ns: int
    kind: CommandKind
    goal: float
    speed: float


@dataclass(frozen=True)
class Step:
    """A decision: number, where the tip will be when it is carried out, the state of the table nearest to that.

    `length_mm` is how far the needle goes in, `latency_s` the time from the arrival of the last tracker frame in it to
    the decision. `estimate` is the tip at the time of the decision.
    """

    number: int
    time_ns: int
    path_mm: float
    pose: Pose
    state: tuple[int, int, int, int]
    action: Action
    value: float
    success: float
    length_mm: float
    estimate: TipEstimate
    table_digest: str
    latency_s: float


class Listener:
    """Hears everything and does nothing; listeners must not raise and not delay."""

    def sample(self, sample: Sample) -> None:
        """Hear a sample of a device."""

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:
        """Hear where the tip is, after every good frame of the tracker."""

    def command(self, command: Command) -> None:
        """Hear a command that the stage has accepted."""

    def step(self, step: Step) -> None:
        """Hear a decision."""

    def event(self, event: Event) -> None:
        """Hear of an event."""

    def safety(self, event: SafetyEvent) -> None:
        """Hear of an event of the guard before the stage."""

    def status(self) -> RecorderStatus | None:
        """Return how the recording of the run fares, where this is one that must not be lost."""
