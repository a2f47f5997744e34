"""Result of an insertion: its outcome and cause, the planned path and the executed path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.control._events import ExecutedStep, Listener, RunEvent, RunEventName
from needleplan.devices import ForceSample, Sample
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import Action
from needleplan.signals import Array
from needleplan.stopping import Rest

__all__ = [
    "InsertionOutcome",
    "InsertionReport",
    "InsertionTrace",
    "SpaceErrors",
    "TipErrors",
    "path_distances_mm",
]


class InsertionOutcome(StrEnum):
    """Outcome of an insertion. The guard has sent a stop; `InsertionReport.rest` tells whether the needle rests."""

    TARGET = "target"
    MISSED = "missed"
    """The tip is beside the target, less than two steps away, and cannot get nearer."""

    UNREACHABLE = "unreachable"
    """The table's success probability at the pose of the tip is below `least_success`."""

    OUTSIDE = "outside"
    """The tip is outside the workspace of the table."""

    COLLISION = "collision"
    """The tip is in an obstacle."""

    TOO_LONG = "too_long"
    """The path has reached the length `longest_mm`."""

    STOPPED = "stopped"
    """The operator stopped the run."""

    FAULT = "fault"
    """The run ended with an error after the first motion command."""

    REFUSED = "refused"
    """The run ended with an error before the first motion command."""


@dataclass(frozen=True)
class SpaceErrors:
    """Errors of the tip in 3D, relative to the end of the planned path.

    - `lateral_mm`: vector from the centre of the target to the tip, its part across the planned direction, in RAS
    - `along_mm`: part of this vector along the planned direction, positive if the tip is too deep
    - `direction_rad`: angle between the directions of the tip and of the end of the planned path
    """

    lateral_mm: tuple[float, float, float]
    along_mm: float
    direction_rad: float


@dataclass(frozen=True)
class TipErrors:
    """Errors of the last estimate of the tip (mm); NaN without an estimate.

    - `target_reach_mm`: largest distance of a point of the target from its centre
    - `error_mm`: distance from the centre of the target, in the plane; in 3D, across the planned direction
    - `error_in_space_mm`, `beyond_rim_mm`: distance from the centre, and from the rim of the target (0 inside)
    - `out_of_plane_mm`: distance from the plane of the plan; NaN in 3D
    - `space`: the errors in 3D; None in the plane
    """

    target_reach_mm: float
    error_mm: float = math.nan
    error_in_space_mm: float = math.nan
    beyond_rim_mm: float = math.nan
    out_of_plane_mm: float = math.nan
    space: SpaceErrors | None = None


@dataclass(frozen=True, eq=False)
class InsertionReport(ShortRepr):
    """Result of an insertion; lengths in mm.

    Attributes
    ----------
    outcome, cause
        How the insertion ended, and why.
    steps, events
        Decisions and events in their order.
    planned_mm
        Points on the path that the first table plans from the start: [n, 2] in the plane, [n, 3] in 3D.
    executed_mm
        [m, 3] estimated tip at every frame of the tracker: x, y, and z, which is the distance from the plane of a plan
        in the plane.
    path_mm, deviations_mm
        [m] path length, and distance of the tip from the planned path (0 before the entry), at the frames of
        `executed_mm`. For the distance, the planned path is extended straight into the target.
    forces
        [m, 2] path length (mm) and axial force (N) at the frames of `executed_mm`.
    tip, error_mm, error_out_of_plane_mm, error_in_space_mm, beyond_rim_mm
        Last estimate of the tip; distance of this tip from the centre of the target in the plane, distance from the
        plane, distance from the centre in 3D; and distance in 3D from the rim of the target (0 inside). After a
        run in 3D, the first is the distance across the planned direction, and the second is NaN.
    deviation_mm, out_of_plane_mm
        Largest distance of the tip from the planned path, and from the plane of the plan (NaN in 3D).
    space
        Errors of this tip relative to the end of the planned path, after a run in 3D; None in the plane.
    rest
        RESTS if the needle was measured at rest at the end; after MOVES and UNKNOWN, treat it as moving.
    inserted_mm
        Path length at the end.
    turns, replans
        Numbers of steps that began with a rotation, and of tables that replaced the first table.
    largest_force_n
        Largest magnitude of the axial force (N).
    duration_s
        Time from the first to the last sample.
    predicted_success
        Success probability of the table at the first decision; NaN without a decision.
    table_digest
        Digest of the first table.

    """

    outcome: InsertionOutcome
    cause: str
    steps: tuple[ExecutedStep, ...]
    events: tuple[RunEvent, ...]
    planned_mm: Array
    executed_mm: Array
    path_mm: Array
    deviations_mm: Array
    forces: Array
    tip: TipEstimate | None
    error_mm: float
    error_out_of_plane_mm: float
    error_in_space_mm: float
    beyond_rim_mm: float
    deviation_mm: float
    out_of_plane_mm: float
    inserted_mm: float
    turns: int
    replans: int
    largest_force_n: float
    duration_s: float
    predicted_success: float
    table_digest: str
    space: SpaceErrors | None = None
    rest: Rest = Rest.UNKNOWN

    def record(self) -> dict[str, Any]:
        """Return the report as a JSON object, without paths and events, and with only the number of steps."""
        tip = self.tip
        return {
            "ending": self.outcome, "cause": self.cause, "rest": self.rest, "error_mm": self.error_mm,
            "error_out_of_plane_mm": self.error_out_of_plane_mm, "error_in_space_mm": self.error_in_space_mm,
            "beyond_rim_mm": self.beyond_rim_mm, "deviation_mm": self.deviation_mm,
            "out_of_plane_mm": self.out_of_plane_mm, "inserted_mm": self.inserted_mm, "steps": len(self.steps),
            "turns": self.turns, "replans": self.replans, "largest_force_n": self.largest_force_n,
            "duration_s": self.duration_s, "predicted_success": self.predicted_success,
            "tip": None if tip is None else vars(tip), "table": self.table_digest,
            "slowest_decision_s": max((step.latency_s for step in self.steps), default=math.nan),
            **({} if self.space is None else {"space": vars(self.space)}),
        }  # fmt: skip


class InsertionTrace(Listener):
    """Listener that collects estimates, forces, decisions and events for the report.

    `force_axis` is the unit vector, in the frame of the sensor, in the direction of a positive axial force.
    """

    def __init__(self, force_axis: tuple[float, float, float]) -> None:
        self.steps: list[ExecutedStep] = []
        self.events: list[RunEvent] = []
        self.tips: list[tuple[float, float, float]] = []
        self.paths_mm: list[float] = []
        self.forces: list[tuple[float, float]] = []
        self._force_n = math.nan
        self.last: TipEstimate | None = None
        self.largest_force_n = 0.0
        self._axis = force_axis
        self._span_ns: tuple[int, int] | None = None

    def sample(self, sample: Sample) -> None:
        """Update the largest force and the duration."""
        now = sample.stamp.received_ns
        self._span_ns = (self._span_ns[0] if self._span_ns else now, now)
        if isinstance(sample, ForceSample):
            along = sum(component * axis for component, axis in zip(sample.force_n, self._axis, strict=True))
            self._force_n = along
            self.largest_force_n = max(self.largest_force_n, abs(along))

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Append a tip estimate, its path length and the last axial force."""
        self.last = tip
        self.paths_mm.append(path_mm)
        self.forces.append((path_mm, self._force_n))
        self.tips.append((tip.x_mm, tip.y_mm, tip.z_mm))

    def step(self, step: ExecutedStep) -> None:
        """Append a decision."""
        self.steps.append(step)

    def event(self, event: RunEvent) -> None:
        """Append an event of the run."""
        self.events.append(event)

    def report(
        self, outcome: InsertionOutcome, cause: str, errors: TipErrors, planned_mm: Array, inserted_mm: float,
        digest: str,
    ) -> InsertionReport:  # fmt: skip
        """Return the report; `planned_mm` is the first planned path, `digest` that of the first table."""
        executed = np.array(self.tips, float).reshape(-1, 3)
        along = np.array(self.paths_mm, float)
        line = _prolonged(planned_mm, 2 * errors.target_reach_mm)
        off = np.where(along < 0, 0.0, path_distances_mm(line, executed[:, : line.shape[1]]))
        begin, end = self._span_ns or (0, 0)
        aside = math.nan if errors.space else float(np.abs(executed[:, 2]).max(initial=0.0))
        return InsertionReport(
            outcome, cause, tuple(self.steps), tuple(self.events), planned_mm, executed,
            along, off, np.array(self.forces, float).reshape(-1, 2), self.last, errors.error_mm,
            errors.out_of_plane_mm, errors.error_in_space_mm, errors.beyond_rim_mm,
            float(off.max(initial=0.0)), aside, inserted_mm,
            sum(step.action is Action.ROTATE for step in self.steps),
            sum(event.name is RunEventName.TABLE_SWAPPED for event in self.events), self.largest_force_n,
            (end - begin) * 1e-9, self.steps[0].success if self.steps else math.nan, digest, errors.space,
        )  # fmt: skip


def path_distances_mm(line_mm: Array, points_mm: Array) -> Array:
    """Return the distances of points from a polyline.

    Parameters
    ----------
    line_mm : numpy.ndarray
        Corners of the polyline (mm), shape (n, d).
    points_mm : numpy.ndarray
        Points (mm), shape (m, d).

    Returns
    -------
    numpy.ndarray
        Distances (mm), shape (m,); zeros if the line has no segment.
    """
    if len(line_mm) < 2 or not len(points_mm):
        return np.zeros(len(points_mm))
    begin, way = line_mm[:-1], np.diff(line_mm, axis=0)
    squares = np.maximum((way**2).sum(axis=1), 1e-300)
    nearest_mm = np.empty(len(points_mm))
    for number, point in enumerate(points_mm):
        share = np.clip(((point - begin) * way).sum(axis=1) / squares, 0.0, 1.0)
        nearest_mm[number] = np.linalg.norm(begin + share[:, None] * way - point, axis=1).min()
    return nearest_mm


def _prolonged(line_mm: Array, length_mm: float) -> Array:
    """Return a polyline with a straight extension of `length_mm` at its end; unchanged without a segment.

    The planned path ends at the rim of the target, but the executed path ends inside the target.
    """
    if len(line_mm) < 2:
        return line_mm
    ahead = line_mm[-1] - line_mm[-2]
    return np.concatenate([line_mm, [line_mm[-1] + ahead * length_mm / np.linalg.norm(ahead)]])
