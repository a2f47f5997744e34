"""Seeded insertions in the lab twin: their results, statistics and repeatability."""

import math
from dataclasses import replace

import numpy as np
import pytest

from needleplan.control import ScenarioGeometry
from needleplan.models import arc_step
from needleplan.planning import plan
from needleplan.simulation import Effects, Setup, Simulation
from needleplan_thesis.steering import (
    Guidance,
    SteeringCase,
    SteeringTask,
    SteeringTrial,
    gap_closed,
    planned_moves,
    run_all,
    run_trial,
    summarized,
)
from tests.control.scenes import NOISY, SLOW_SERVO, small_table

pytestmark = pytest.mark.study


def case(effects: Effects) -> SteeringCase:
    lab = Simulation(Setup(1 / 40, effects=effects, robot=SLOW_SERVO), ())
    return SteeringCase("small", small_table().scenario, lab, velocity_rad_s=10.0)


QUIET = Effects(coil_offset_mm=2.0)


@pytest.fixture(scope="module")
def closed() -> SteeringTrial:
    return run_trial(SteeringTask(case(NOISY), Guidance.REPLANNED, 3))


def test_the_same_seed_is_the_same_insertion(closed: SteeringTrial) -> None:
    again = run_trial(SteeringTask(case(NOISY), Guidance.REPLANNED, 3))
    assert np.array_equal(again.path_mm, closed.path_mm)
    assert run_trial(SteeringTask(case(NOISY), Guidance.REPLANNED, 4)).error_mm != closed.error_mm


def test_feedback_reaches_the_target(closed: SteeringTrial) -> None:
    assert closed.success
    assert closed.outcome == "target"
    assert closed.turns >= 1
    assert closed.error_mm == pytest.approx(math.dist(closed.path_mm[-1, :2], (50.0, 26.0)))
    assert closed.seen_error_mm == pytest.approx(closed.error_mm, abs=1.0)


def test_without_disturbances_the_planned_moves_follow_the_plan() -> None:
    open_loop = run_trial(SteeringTask(case(QUIET), Guidance.OPEN, 0))
    assert open_loop.success
    assert open_loop.deviation_mm < 0.02
    assert open_loop.turns == planned_moves(small_table(), open_loop.task.case.pose).turns > 0
    off = run_trial(SteeringTask(case(QUIET), Guidance.OPEN, 0, curvature_error=0.3))
    assert off.deviation_mm > 1.0
    assert run_trial(SteeringTask(case(QUIET), Guidance.ONE_TABLE, 0, curvature_error=0.3)).success


@pytest.mark.parametrize("radius_mm", [60.0, 62.5, 72.5, 82.5, 115.0, 140.0])
def test_planned_moves_end_at_the_point_closest_to_the_target(radius_mm: float) -> None:
    scenario = small_table().scenario
    scenario = replace(scenario, needle=replace(scenario.needle, curvature_radius_mm=radius_mm))
    table, scene = plan(scenario), ScenarioGeometry(scenario)
    start = table.best_entry().pose
    moves = planned_moves(table, start)

    def error_mm(further_mm: float) -> float:
        x, y, heading = start[:3]
        *before, last = moves.lengths_mm
        for length, bevel in zip([*before, last + further_mm], moves.bevels, strict=True):
            x, y, heading = map(float, arc_step(x, y, heading, bevel / radius_mm, length))
        return scene.target_distance_mm(x, y)

    assert error_mm(0.0) < min(error_mm(-0.2), error_mm(0.2))


def test_a_plan_that_knows_the_curvature_needs_no_new_one() -> None:
    known = run_trial(SteeringTask(case(QUIET), Guidance.KNOWN, 0, curvature_error=0.3))
    assert known.success
    assert known.replans == 0
    assert known.task.case.pose[:3] == case(QUIET).pose[:3]
    assert known.task.case.scenario.needle.curvature_radius_mm == case(QUIET).scenario.needle.curvature_radius_mm / 1.3


def test_a_needle_that_is_not_steered() -> None:
    straight = run_trial(SteeringTask(case(QUIET), Guidance.STRAIGHT, 0))
    begin, end = straight.path_mm[0, :2], straight.path_mm[-1, :2]
    along = (end - begin) / np.linalg.norm(end - begin)
    across = (straight.path_mm[:, :2] - begin) @ np.array([-along[1], along[0]])
    assert abs(across).max() < 1e-6
    assert straight.error_mm < 0.01
    aimed = run_trial(SteeringTask(case(QUIET), Guidance.AIMED, 0))
    # On a circle of 40 mm, tangent to the line to the target: as long as the line, so the end is off by the sagitta.
    turn = np.linalg.norm(np.array([50.0, 26.0]) - begin) / 40
    off = 40 * math.hypot(math.sin(turn) - turn, 1 - math.cos(turn))
    assert aimed.error_mm == pytest.approx(off, abs=0.1)
    assert not aimed.success


def test_what_touches_an_obstacle_has_failed() -> None:
    trial = run_trial(SteeringTask(case(QUIET), Guidance.OPEN, 0))
    assert trial.success
    assert not replace(trial, touched="vessel").success
    assert not replace(trial, left=True).success
    assert not replace(trial, error_mm=1.6, aside_mm=0.0).success
    assert replace(trial, error_mm=1.6, aside_mm=0.0).beyond_rim_mm == pytest.approx(0.1)


def test_summary_counts(closed: SteeringTrial) -> None:
    failed = replace(closed, error_mm=9.0, aside_mm=0.0, outcome="missed"), replace(closed, touched="vessel")
    summary = summarized([closed, closed, *failed])
    assert summary.success == 0.5
    assert summary.failures == {"missed": 1, "an obstacle": 1}
    assert summary.seeds == (3, 3)
    assert summary.success_interval[0] < 0.5 < summary.success_interval[1]
    assert summary.error_mm == pytest.approx((3 * closed.error_mm + 9) / 4)
    assert summary.error_interval_mm[0] <= summary.error_mm <= summary.error_interval_mm[1]


def test_processes_give_what_one_gives() -> None:
    tasks = [SteeringTask(case(QUIET), guidance, 3) for guidance in (Guidance.OPEN, Guidance.STRAIGHT)]
    one, two = list(run_all(tasks)), list(run_all(tasks, processes=2))
    assert [each.error_mm for each in one] == [each.error_mm for each in two]


def test_share_of_a_gap() -> None:
    assert gap_closed(0.9, 0.5, 0.8) == pytest.approx(0.75)
    assert gap_closed(0.9, 0.5, 0.4) == pytest.approx(-0.25)
    assert gap_closed(0.9, 0.95, 1.0) is None
