"""Insertions in the lab twin with their true results, which no sensor measures, and statistics of many insertions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.control import Insertion, Listener, Options, path_distances_mm, planned_tip_settings
from needleplan.control.safety import SafetyLimits
from needleplan.estimation.tip import TipEstimate, TipSettings
from needleplan.planning import Action, PolicyTable, wilson
from needleplan.signals import Array
from needleplan.simulation import Plant
from needleplan_thesis.processes import map_in_processes
from needleplan_thesis.steering._case import Guidance, SteeringTask
from needleplan_thesis.steering._unguided import aimed_at_target, execute_moves, path_end, planned_moves

__all__ = ["SteeringSummary", "SteeringTrial", "gap_closed", "run_all", "run_trial", "summarized"]


@dataclass(frozen=True, eq=False)
class SteeringTrial:
    """Result of an insertion; lengths in mm, positions in the plane of the plan.

    - `path_mm`, `planned_mm`: true path of the tip, shape (n, 3), and path of the plan
    - `turns_mm`: positions of the rotations, shape (turns, 2); empty without feedback
    - `error_mm`, `aside_mm`: distance of the end of the true path from the true centre of the target in the plane, and
      across the plane; without feedback, from the centre in the plan
    - `out_of_plane_mm`: largest distance of the true path from the plane of the plan
    - `deviation_mm`: largest distance of the true path from the planned path, up to the length of the planned path
    - `seen_error_mm`, `seen_deviation_mm`: error and deviation by the tip filter; NaN without feedback
    - `touched`: name of the first obstacle on the true path, or empty
    - `left`: whether the true path left the workspace
    - `turns`, `replans`: number of rotations and of replans
    - `predicted`: success probability of the plan
    - `outcome`, `cause`: as reported by the control loop; empty without feedback
    """

    task: SteeringTask
    path_mm: Array
    planned_mm: Array
    turns_mm: Array
    error_mm: float
    aside_mm: float
    out_of_plane_mm: float
    deviation_mm: float
    seen_error_mm: float
    seen_deviation_mm: float
    touched: str
    left: bool
    turns: int
    replans: int
    predicted: float
    outcome: str
    cause: str

    @property
    def success(self) -> bool:
        """Whether the tip reached the target in 3D without touching an obstacle or leaving the workspace."""
        return not (self.touched or self.left or self.beyond_rim_mm)

    @property
    def in_space_mm(self) -> float:
        """Distance (mm) of the end of the path from the centre of the target in 3D."""
        return math.hypot(self.error_mm, self.aside_mm)

    @property
    def beyond_rim_mm(self) -> float:
        """Distance (mm) in 3D of the end of the path from the rim of the target; 0 inside the target."""
        return max(self.in_space_mm - self.task.case.scenario.target.radius_mm, 0.0)


def run_trial(task: SteeringTask) -> SteeringTrial:
    """Simulate an insertion and return its result; equal tasks give equal results."""
    if task.guidance is Guidance.KNOWN:
        task = replace(task, case=task.case.with_curvature(task.curvature_error), curvature_error=0.0)
    return _with_feedback(task) if task.guidance.has_feedback else _without(task)


class _Truth(Listener):
    """Records the true position of the tip at every tip estimate of the control loop."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.path: list[tuple[float, float, float]] = []

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Record the true position if the tip is in the tissue. The estimated tip is not used."""
        if path_mm >= 0:
            self.path.append(self._plant.tip().position_mm)


def _with_feedback(task: SteeringTask) -> SteeringTrial:
    case = task.case
    table, station = case.table, case.station(task.seed, task.curvature_error)
    options = Options(
        velocity_mm_s=case.velocity_mm_s, velocity_rad_s=case.velocity_rad_s, torsion=station.torsion,
        needle_length_mm=station.needle_length_mm,
        replan=task.guidance is Guidance.REPLANNED, push=case.push,
    )  # fmt: skip
    limits = SafetyLimits(insertion_velocity_mm_s=max(case.velocity_mm_s, SafetyLimits().insertion_velocity_mm_s))
    truth = _Truth(station.lab.plant)
    insertion = Insertion(
        table, station, options, registration=station.registration, limits=limits, listeners=[truth],
        accepted_limits="the speed of the study",
        tip_settings=replace(
            planned_tip_settings(table) if case.planned_noise else TipSettings(),
            image_latency_s=station.lab.plant.setup.effects.ultrasound_delay_s,
        ),
    )  # fmt: skip
    with station, insertion:
        report = insertion.run()
    # The plan of the loop starts at the measured entry; the study compares with the plan from the nominal entry.
    planned = table.path(case.pose).points_mm
    seen_mm = _deviation_mm(planned, report.executed_mm[report.path_mm >= 0])
    truth.path.append(station.lab.plant.tip().position_mm)
    turned = [step.pose[:2] for step in report.steps if step.action is not Action.INSERT]
    return _trial(
        task, table, np.array(truth.path), planned, np.array(turned, float).reshape(-1, 2),
        seen=(report.error_mm, seen_mm), counts=(report.turns, report.replans),
        outcome=(report.outcome, report.cause), target_mm=station.true_target_mm(table.scenario.target.center_mm),
    )  # fmt: skip


def _without(task: SteeringTask) -> SteeringTrial:
    case, guidance = task.case, task.guidance
    table, start, station = case.table, case.pose, case.station(task.seed, task.curvature_error)
    setup = station.lab.plant.setup
    if guidance is Guidance.OPEN:
        moves = planned_moves(table, start)
    else:
        setup, moves = aimed_at_target(setup, table, bending=guidance is Guidance.AIMED)
    path = execute_moves(Plant(setup, task.seed), moves, case.velocity_mm_s, case.velocity_rad_s, station.torsion)
    planned = table.path(start).points_mm
    nothing = math.nan, math.nan
    return _trial(task, table, path, planned, np.empty((0, 2)), seen=nothing, counts=(moves.turns, 0), outcome=("", ""))


def _trial(
    task: SteeringTask, table: PolicyTable, path: Array, planned: Array, turns_mm: Array, *, seen: tuple[float, float],
    counts: tuple[int, int], outcome: tuple[str, str], target_mm: tuple[float, float, float] | None = None,
) -> SteeringTrial:  # fmt: skip
    end = path_end(table.scenario, path, target_mm)
    return SteeringTrial(
        task, path, planned, turns_mm, end.error_mm, end.aside_mm, float(np.abs(path[:, 2]).max()),
        _deviation_mm(planned, path),
        *seen, end.touched, end.left, *counts, table.lookup(*task.case.pose).success, *outcome,
    )  # fmt: skip


def _deviation_mm(planned: Array, path: Array) -> float:
    """Return the largest distance (mm) of a path from the planned path, up to the length of the planned path.

    The planned path ends on the rim of the target, or earlier if the plan fails.
    """
    lengths = [np.linalg.norm(np.diff(each[:, :2], axis=0), axis=1) for each in (planned, path)]
    along = np.concatenate([[0.0], np.cumsum(lengths[1])])
    within = path[along <= lengths[0].sum(), :2]
    return float(path_distances_mm(planned, within).max(initial=0.0))


def run_all(tasks: Sequence[SteeringTask], processes: int = 1) -> Iterator[SteeringTrial]:
    """Yield the result of each task, in the order of the tasks."""
    return map_in_processes(run_trial, tasks, processes, chunk=4)


# Number of bootstrap samples for the interval of a mean.
_RESAMPLED = 2000


@dataclass(frozen=True)
class SteeringSummary:
    """Statistics of many insertions of one kind; lengths in mm, intervals of 95 %.

    `success` has a Wilson interval, the mean error in the plane `error_mm` a bootstrap interval. `error_95_mm` is the
    95th percentile of this error; `aside_mm` and `in_space_mm` are the mean errors out of the plane and in 3D.
    `deviation_mm`, `turns` and `replans` are means. `failures` counts the failed insertions by reason; `seeds` lists
    the seeds of the failed insertions.
    """

    runs: int
    predicted: float
    success: float
    success_interval: tuple[float, float]
    error_mm: float
    error_interval_mm: tuple[float, float]
    error_median_mm: float
    error_95_mm: float
    aside_mm: float
    in_space_mm: float
    deviation_mm: float
    turns: float
    replans: float
    failures: Mapping[str, int]
    seeds: tuple[int, ...]


def summarized(trials: Sequence[SteeringTrial]) -> SteeringSummary:
    """Return the statistics of at least one insertion. All insertions must have the same plan."""
    errors = np.array([trial.error_mm for trial in trials])
    failed = [trial for trial in trials if not trial.success]
    return SteeringSummary(
        runs=len(trials),
        predicted=trials[0].predicted,
        success=1 - len(failed) / len(trials),
        success_interval=wilson(len(trials) - len(failed), len(trials)),
        error_mm=float(errors.mean()),
        error_interval_mm=_mean_interval(errors),
        error_median_mm=float(np.median(errors)),
        error_95_mm=float(np.percentile(errors, 95)),
        aside_mm=float(np.mean([trial.aside_mm for trial in trials])),
        in_space_mm=float(np.mean([trial.in_space_mm for trial in trials])),
        deviation_mm=float(np.mean([trial.deviation_mm for trial in trials])),
        turns=float(np.mean([trial.turns for trial in trials])),
        replans=float(np.mean([trial.replans for trial in trials])),
        failures=dict(Counter(map(_failure, failed)).most_common()),
        seeds=tuple(each.task.seed for each in failed),
    )


def gap_closed(predicted: float, one_table: float, replanned: float) -> float | None:
    """Return the share of the gap between predicted and realised success that replanning closes.

    `one_table` and `replanned` are the realised success without and with replanning. Returns None if there is no gap
    without replanning.
    """
    gap = predicted - one_table
    return None if gap <= 0 else (replanned - one_table) / gap


def _failure(trial: SteeringTrial) -> str:
    if trial.touched:
        return "an obstacle"
    if trial.left:
        return "out of the workspace"
    if trial.outcome in ("", "target"):
        return "beside the target"
    return trial.outcome


def _mean_interval(values: np.ndarray) -> tuple[float, float]:
    drawn = np.random.default_rng(1).choice(values, (_RESAMPLED, len(values))).mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5]).tolist()
    return low, high
