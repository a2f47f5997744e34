"""Straight steps: three arcs by the same devices, in the plane as in 3D."""

import math
from functools import cache

import numpy as np
import pytest

from needleplan.control import CommandKind, Insertion, InsertionOutcome, InsertionReport, Listener, RunCommand
from needleplan.control._guidance import straight_arcs
from needleplan.estimation.tip import TipSettings
from needleplan.models import arc_step
from needleplan.planning import Action, PolicyTable, plan
from needleplan.scenario import Grid, Needle, Objective, Obstacle, Scenario, Target, TipMotion, Workspace
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry
from tests.control.scenes import FAST, NOISY, SLOW_SERVO, WIDE, coil_of, station_of

RADIUS_MM, START = 40.0, (0.0, 20.0, 0.0, 1)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("length_mm", [2.0, 4.0, 8.0])
def test_three_arcs_leave_the_share_of_the_curvature_and_no_offset(share: float, length_mm: float) -> None:
    arcs = straight_arcs(length_mm, math.pi, 0.0, share)
    assert sum(each.length_mm for each in arcs) == pytest.approx(length_mm)
    assert [each.roll_rad for each in arcs] == [None, math.pi, 0.0]
    x, y, heading = 0.0, 0.0, 0.0
    for side, arc in zip((1, -1, 1), arcs, strict=True):
        x, y, heading = (float(each) for each in arc_step(x, y, heading, side / RADIUS_MM, arc.length_mm))
    assert heading == pytest.approx(share * length_mm / RADIUS_MM)
    there = arc_step(0.0, 0.0, 0.0, share / RADIUS_MM, length_mm)
    assert math.hypot(x - there[0], y - there[1]) < length_mm**3 / (10 * RADIUS_MM**2)


def test_with_all_of_the_curvature_a_straight_step_is_an_arc() -> None:
    (only,) = straight_arcs(4.0, math.pi, 0.0, 1.0)
    assert only == (None, 4.0)


@cache
def corridor(share: float, price: float) -> PolicyTable:
    """A target straight ahead, between two obstacles. `price` is that of a straight millimetre; others cost 1."""
    return plan(
        Scenario(
            Workspace(60, 40), Target((42, 20), 2), Needle(RADIUS_MM),
            [Obstacle(center_mm=(25, 8), radius_mm=8), Obstacle(center_mm=(25, 34), radius_mm=8)],
            TipMotion(60, (1.0,), step_mm=4.0, straight_curvature_share=share), Grid((1.0, 1.0), "interpolated"),
            Objective(straight_per_mm=price),
        )
    )  # fmt: skip


class Turns(Listener):
    """Counts the rotations of the base."""

    def __init__(self) -> None:
        self.count = 0

    def command(self, command: RunCommand) -> None:
        self.count += command.kind is CommandKind.ROTATE


def executed(
    table: PolicyTable, effects: Effects | None = None, seed: int = 0
) -> tuple[InsertionReport, tuple[float, float, float], int]:
    """Return the report, the true tip (mm) and the number of rotations."""
    setup = Setup(1 / RADIUS_MM, entry=SimulatedEntry(*START[:3]), effects=effects or Effects(), robot=SLOW_SERVO)
    lab, turns = Lab(setup, seed), Turns()
    run = Insertion(
        table, station_of(lab), FAST, registration=coil_of(lab), listeners=[turns], limits=WIDE,
        accepted_limits="a fast lab", tip_settings=TipSettings(),
    )  # fmt: skip
    return run.run(), lab.plant.tip().position_mm, turns.count


def actions(report: InsertionReport) -> list[Action]:
    return [each.action for each in report.steps]


@pytest.mark.slow
def test_a_plan_of_straight_steps_alone_goes_straight() -> None:
    table = corridor(0.0, 0.75)
    planned = table.path(START)
    assert planned.straight_mm == planned.length_mm == pytest.approx(40)
    report, tip, turns = executed(table)
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    assert report.inserted_mm == pytest.approx(42, abs=0.5)
    assert math.dist(tip, (42, 20, 0)) < 0.3
    done = actions(report)
    assert set(done[:-1]) == {Action.STRAIGHT}
    assert len(done) in (10, 11)
    assert turns == 2 * done.count(Action.STRAIGHT)
    # Between the turns the path is at most k L^2 / 16 beside the line.
    assert np.abs(report.executed_mm[:, 1] - 20).max() < 4**2 / 16 / RADIUS_MM + 0.02


@pytest.mark.slow
def test_the_share_of_the_curvature_that_is_left_is_executed_too() -> None:
    table = corridor(0.1, 0.75)
    planned = table.path(START)
    report, tip, _ = executed(table)
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    assert Action.STRAIGHT in actions(report)
    assert report.inserted_mm == pytest.approx(planned.length_mm, abs=4.0)
    assert math.dist(tip, (42, 20, 0)) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_needle_with_noise_arrives(seed: int) -> None:
    report, tip, _ = executed(corridor(0.0, 1.3), NOISY, seed)
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    assert Action.STRAIGHT in actions(report)
    assert math.dist(tip, (42, 20, 0)) < 2.5
