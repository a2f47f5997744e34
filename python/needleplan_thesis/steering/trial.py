"""One insertion in the lab twin, and what came of it in truth, which no sensor tells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.control import Insertion, Listener, Options, drawn, path_distances_mm
from needleplan.control.safety import SafetyLimits
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import PolicyTable
from needleplan.signals import Array
from needleplan.simulation import Plant
from needleplan_thesis.steering.course import Guidance, Task
from needleplan_thesis.steering.ended import ended
from needleplan_thesis.steering.unguided import aimed_at_target, carried_out, planned_moves

__all__ = ["Trial", "run_trial"]


@dataclass(frozen=True, eq=False)
class Trial:
    """What came of an insertion; lengths in mm, places in the plane of the plan.

    `path_mm` [n, 3] is the true path of the tip. `error_mm` is the distance of its end from the centre of the target,
    `deviation_mm` its largest distance from the planned path; both once more as the tip filter has them (`seen_`; NaN
    without feedback). `touched` names the first obstacle on the true path, if any. `predicted` is the success that the
    plan promises, `ending` and `cause` say how the loop itself took it to end.
    """

    task: Task
    path_mm: Array
    planned_mm: Array
    turns_mm: Array
    error_mm: float
    out_of_plane_mm: float
    deviation_mm: float
    seen_error_mm: float
    seen_deviation_mm: float
    touched: str
    left: bool
    turns: int
    replans: int
    predicted: float
    ending: str
    cause: str

    @property
    def success(self) -> bool:
        """Whether the tip ended in the target, past all obstacles, within the workspace."""
        return not (self.touched or self.left or self.beyond_rim_mm)

    @property
    def beyond_rim_mm(self) -> float:
        """How far beyond the rim of the target it ended."""
        return max(self.error_mm - self.task.course.scenario.target.radius_mm, 0.0)


def run_trial(task: Task) -> Trial:
    """Carry out an insertion; the same task gives the same result."""
    return _with_feedback(task) if task.guidance.feels else _without(task)


class _Truth(Listener):
    """Notes where the tip really is whenever the loop says where it takes it to be."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.path: list[tuple[float, float, float]] = []

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Note where it is, once it is in the tissue."""
        if path_mm >= 0:
            self.path.append(self._plant.tip().position_mm)


def _with_feedback(task: Task) -> Trial:
    course = task.course
    table, station = course.table, course.station(task.seed, task.curvature_error)
    options = Options(
        velocity_mm_s=course.velocity_mm_s, velocity_rad_s=course.velocity_rad_s, torsion=station.torsion,
        needle_length_mm=station.needle_length_mm,
        replan=task.guidance is Guidance.REPLANNED,
    )  # fmt: skip
    limits = SafetyLimits(insertion_velocity_mm_s=max(course.velocity_mm_s, SafetyLimits().insertion_velocity_mm_s))
    truth = _Truth(station.lab.plant)
    insertion = Insertion(table, station, options, registration=station.registration, limits=limits, listeners=[truth])
    with station, insertion:
        report = insertion.run()
    # What the loop itself plans begins at the entry that it has measured.
    planned = drawn(table.path(course.pose), table)
    seen_mm = _deviation_mm(planned, report.executed_mm[report.path_mm >= 0])
    truth.path.append(station.lab.plant.tip().position_mm)
    turned = [step.pose[:2] for step in report.steps if step.action]
    return _judged(
        task, table, np.array(truth.path), planned, np.array(turned, float).reshape(-1, 2),
        seen=(report.error_mm, seen_mm), counts=(report.turns, report.replans),
        ending=(report.outcome, report.cause),
    )  # fmt: skip


def _without(task: Task) -> Trial:
    course, guidance = task.course, task.guidance
    table, start, station = course.table, course.pose, course.station(task.seed, task.curvature_error)
    setup = station.lab.plant.setup
    if guidance is Guidance.OPEN:
        moves = planned_moves(table, start)
    else:
        setup, moves = aimed_at_target(setup, table, bending=guidance is Guidance.AIMED)
    path = carried_out(Plant(setup, task.seed), moves, course.velocity_mm_s, course.velocity_rad_s, station.torsion)
    planned = drawn(table.path(start), table)
    nothing = math.nan, math.nan
    return _judged(task, table, path, planned, np.empty((0, 2)), seen=nothing, counts=(moves.turns, 0), ending=("", ""))


def _judged(
    task: Task, table: PolicyTable, path: Array, planned: Array, turns_mm: Array, *, seen: tuple[float, float],
    counts: tuple[int, int], ending: tuple[str, str],
) -> Trial:  # fmt: skip
    end = ended(table.scenario, path)
    return Trial(
        task, path, planned, turns_mm, end.error_mm, float(np.abs(path[:, 2]).max()), _deviation_mm(planned, path),
        *seen, end.touched, end.left, *counts, table.lookup(*task.course.pose).success, *ending,
    )  # fmt: skip


def _deviation_mm(planned: Array, path: Array) -> float:
    """Return the largest distance from the plan, as far as the plan goes: it ends on the rim of the target.

    The path of a plan that fails is the shorter one; beyond its end there is nothing to deviate from.
    """
    lengths = [np.linalg.norm(np.diff(each[:, :2], axis=0), axis=1) for each in (planned, path)]
    along = np.concatenate([[0.0], np.cumsum(lengths[1])])
    within = path[along <= lengths[0].sum(), :2]
    return float(path_distances_mm(planned, within).max(initial=0.0))
