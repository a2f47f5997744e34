"""What the insertion loop asks a plan: where the needle may be, and what to do next. One class each in plane and space.

The loop knows devices, motions, pauses and the end of a run. A `PlanGuidance` knows one policy table, the geometry that
was planned in, and how a decision of the table becomes rolls of the base and lengths of insertion.

**Straight steps** of the length L leave a share q of the curvature k: (1 + q) L/4 as the bevel is, (1 - q) L/2 with the
bevel turned by half a turn, and (1 + q) L/4 as at first. The turns add up to q k L. For q = 0 the slope rises to kL/4,
falls to -kL/4 and returns to 0, and its integral is 0; in between, the path is at most k L^2 / 16 off a straight line.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from needleplan.control._needle import NeedleState
from needleplan.control._report import InsertionOutcome, TipErrors
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipEstimate, TipFilter, TipSettings
from needleplan.planning import Action, Pose, SpacePose, SpaceTask, Table
from needleplan.scenario import Scenario
from needleplan.signals import Array

__all__ = ["PlanGuidance", "RunEnd", "RunStart", "Segment", "StepChoice", "straight_arcs"]

RunEnd = tuple[InsertionOutcome, str]
"""Outcome of a run, and its cause as a text."""

Position = Sequence[float]


class Segment(NamedTuple):
    """Part of a step: a rotation of the base to a roll (rad; None: no rotation), then an insertion by a length (mm)."""

    roll_rad: float | None
    length_mm: float


def straight_arcs(
    length_mm: float, there_rad: float, back_rad: float, share: float = 0.0, first_rad: float | None = None
) -> tuple[Segment, ...]:
    """Return a nearly straight step as three arcs with alternating bevel; a share (0 to 1) of the curvature remains.

    `back_rad` is the roll of the base for the present bevel, `there_rad` the roll for the bevel rotated by half a turn,
    and `first_rad` the roll before the step; None: the present roll.
    """
    ends_mm = (1 + share) / 4 * length_mm
    if 2 * ends_mm >= length_mm:
        return (Segment(first_rad, length_mm),)
    return Segment(first_rad, ends_mm), Segment(there_rad, length_mm - 2 * ends_mm), Segment(back_rad, ends_mm)


class RunStart(NamedTuple):
    """First answer of a plan: its path (mm), shape (n, 2) or (n, 3), the roll of the base, and a reason not to begin.

    `roll_rad` is None if the base need not roll at the entry, `refused` is None if the run may begin.
    """

    planned_mm: Array
    roll_rad: float | None = None
    refused: RunEnd | None = None


@dataclass(frozen=True)
class StepChoice:
    """Decision at a predicted pose of the tip.

    - `needs_rest`: the decision must be made again for a needle at rest.
    - `end`: the insertion ends here.
    - `action`, `value`, `success`, `state`: as in `ExecutedStep`.
    - `segments`: the step; `last`: the step is the last one.
    """

    pose: Pose | SpacePose
    needs_rest: bool = False
    end: RunEnd | None = None
    action: Action = Action.INSERT
    value: float = 0.0
    success: float = 1.0
    state: tuple[int, ...] = ()
    segments: tuple[Segment, ...] = ()
    last: bool = False

    @property
    def length_mm(self) -> float:
        """Length of the step."""
        return sum(segment.length_mm for segment in self.segments)


class PlanGuidance(ABC):
    """Turns the decisions of a policy table into motions for the insertion loop; abstract.

    Positions are in the frame of the plan (mm).
    """

    @property
    @abstractmethod
    def table(self) -> Table:
        """The policy table."""

    @abstractmethod
    def follow(self, table: Table) -> Self:
        """Return a guidance that uses a new table of the same kind and continues the present run."""

    @abstractmethod
    def tip_filter(
        self, registration: Registration, entry: tuple[float, ...], settings: TipSettings, *sensors: Any
    ) -> TipFilter:
        """Return a tip filter with the planned curvature; `entry` is x_mm, y_mm, heading_rad, z_mm, elevation_rad.

        `sensors` are curvature sensors and image plane, or None, as in `TipFilter`.
        """

    @abstractmethod
    def begin(self, entry: tuple[float, ...], needle: NeedleState) -> RunStart:
        """Return the planned path from the measured entry. Raises PoseError if the plan does not contain the entry."""

    @abstractmethod
    def choose(self, needle: NeedleState, left_mm: float, room_mm: float) -> StepChoice:
        """Return the decision for the pose at the end of the present insertion.

        `left_mm` is the remaining length of the present insertion. The next step has at most the length `room_mm`.
        """

    @abstractmethod
    def outside(self, position_mm: Position) -> bool:
        """Return whether a position is outside of the workspace."""

    @abstractmethod
    def touches(self, position_mm: Position) -> str:
        """Return the name of the obstacle at a position; empty if there is none."""

    @abstractmethod
    def place(self, position_mm: Position) -> str:
        """Return a text that states a position, for messages."""

    @abstractmethod
    def off_plan_mm(self, tip: TipEstimate) -> float:
        """Return the distance of the tip from the plane of the plan; 0 in 3D."""

    @abstractmethod
    def mismatch(self, needle: NeedleState, pose: Pose | SpacePose) -> tuple[float, float, float]:
        """Return the expected mean curvature up to the target, its standard deviation, and the planned one (1/mm)."""

    @abstractmethod
    def rescaled(self, factor: float, pose: Pose | SpacePose) -> Scenario | SpaceTask:
        """Return the planning problem from `pose` to the target, with all planned curvatures multiplied by `factor`.

        Raises ScenarioError if the changed scenario breaks a rule.
        """

    @abstractmethod
    def errors(self, tip: TipEstimate | None, planned_mm: Array) -> TipErrors:
        """Return the errors of the last tip estimate; NaN if there is no estimate."""
