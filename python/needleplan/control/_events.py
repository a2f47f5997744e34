"""Events of a run, and the interface of their listeners: the recorder, the live view and the report."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.control.safety import SafetyEvent
from needleplan.devices import Sample
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import Action, Pose, SpacePose
from needleplan.recording import RecorderStatus

__all__ = [
    "CommandKind",
    "ExecutedStep",
    "Listener",
    "RunCommand",
    "RunEvent",
    "RunEventName",
]


class RunEventName(StrEnum):
    """Kind of an event of a run. Decisions are not events; see `ExecutedStep`."""

    BEGIN = "begin"
    BIAS = "bias"
    """The force sensor was biased."""

    REPLAN_ASKED = "replan_asked"
    REPLAN_REFUSED = "replan_refused"
    """The new scenario is invalid, or planning has failed; the present table stays."""

    TABLE_SWAPPED = "table_swapped"
    PAUSED = "paused"
    RESUMED = "resumed"
    RETRACTED = "retracted"
    """A person has retracted the needle and resumed the run; the loop has given up its old goal and decides anew."""

    WAITING = "waiting"
    """The needle waits for its gate: breathing has moved the tissue."""

    FAULT = "fault"
    """The run ends with the outcome FAULT or REFUSED; END follows."""

    STOP = "stop"
    """The run ends with the outcome STOPPED; END follows."""

    END = "end"


@dataclass(frozen=True)
class RunEvent(CallRepr):
    """One event of a run with its cause and a text for the user. `step` is the number of the next decision.

    In the events FAULT, STOP and END, `cause` is the outcome of the run and `text` the reason. `digest` is the digest
    of the policy table; only BEGIN and TABLE_SWAPPED have one.
    """

    time_ns: int
    name: RunEventName
    cause: str
    text: str
    step: int
    digest: str = ""


class CommandKind(StrEnum):
    """Kind of a command to the stage."""

    INSERT = "insert"
    ROTATE = "rotate"
    STOP = "stop"


@dataclass(frozen=True)
class RunCommand:
    """Command to the stage: goal (mm or rad) and speed (mm/s or rad/s); both are NaN for a stop."""

    time_ns: int
    kind: CommandKind
    goal: float
    speed: float


@dataclass(frozen=True)
class ExecutedStep(ShortRepr):
    """One decision of the loop and the step that the needle then makes.

    - `path_mm`, `pose`: path length and predicted pose of the tip at the start of the step.
    - `state`: indices (x, y, heading, bevel) of the table state that is looked up for `pose`; in 3D, (x, y, z) of
      the grid point and the number of the roll angle.
    - `action`: ROTATE if the needle turns before the insertion by `length_mm`, STRAIGHT for a straight step,
      else INSERT.
    - `value`, `success`: expected cost and success probability of `state`; 0 and 1 if the table is not looked up,
      because the tip is in the target or outside the workspace.
    - `estimate`: tip estimate at the time of the decision.
    - `latency_s`: time from the arrival of the last tracker frame to the decision; NaN without a frame.
    """

    number: int
    time_ns: int
    path_mm: float
    pose: Pose | SpacePose
    state: tuple[int, ...]
    action: Action
    value: float
    success: float
    length_mm: float
    estimate: TipEstimate
    table_digest: str
    latency_s: float


class Listener:
    """Base class of listeners. Every method does nothing; subclasses override the methods that they need.

    Methods must return at once and must not raise. Any thread may call `safety`; the loop calls all other methods.
    """

    def sample(self, sample: Sample) -> None:
        """Receive a sample of a device."""

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:
        """Receive the tip estimate after a tracker frame.

        Parameters
        ----------
        time_ns : int
            Time of the frame (ns).
        path_mm : float
            Path length (mm).
        tip : TipEstimate
            Estimated tip in the frame of the plan.
        """

    def command(self, command: RunCommand) -> None:
        """Receive a motion command that the stage has accepted, or a stop that the loop has ordered."""

    def step(self, step: ExecutedStep) -> None:
        """Receive a decision, before the needle makes the step."""

    def event(self, event: RunEvent) -> None:
        """Receive an event of the run."""

    def safety(self, event: SafetyEvent) -> None:
        """Receive an event of the guard."""

    def status(self) -> RecorderStatus | None:
        """Return the status of a recording without which the run must stop; None if there is no such recording."""
        return None
