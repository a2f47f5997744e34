"""An insertion in the lab twin with a known error of the registration ends as the promise's execution with it."""

import math
from functools import cache

import numpy as np
import pytest

from needleplan.control import Insertion
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipSettings
from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Grid, Needle, Obstacle, Scenario, Target, TipMotion, Workspace
from needleplan.simulation import SimulatedEntry
from tests.control.scenes import FAST, WIDE, a_lab, station_of

START = (0.0, 20.0, 0.1)


@cache
def quiet_table() -> PolicyTable:
    """A plan without tip noise, whose path leads past an obstacle."""
    obstacle = Obstacle(((22.0, 26.0), (30.0, 26.0), (30.0, 32.0), (22.0, 32.0)), "vessel")
    motion = TipMotion(headings=72, step_mm=3.5, tip_noise=(1.0,))
    parts = Workspace(60.0, 40.0), Target((50.0, 26.0), 1.5), Needle(40.0)
    return plan(Scenario(*parts, obstacles=(obstacle,), motion=motion, grid=Grid((0.5, 0.5))))


@pytest.mark.slow
@pytest.mark.parametrize(("offset_mm", "is_reached"), [(-2.0, True), (-1.0, False), (1.0, True), (3.0, False)])
def test_the_true_tip_ends_in_the_target_or_beside_it(offset_mm: float, is_reached: bool) -> None:
    table, lab = quiet_table(), a_lab(entry=SimulatedEntry(*START))
    # What the tracker measures is true; the registration moves it along y.
    registration = Registration(translation_mm=(0.0, offset_mm, 0.0), coil_offset_mm=0.0)
    report = Insertion(
        table, station_of(lab), FAST, registration=registration, limits=WIDE, accepted_limits="a fast lab",
        tip_settings=TipSettings(),
    ).run()  # fmt: skip
    believed = table.start((START[0], START[1] + offset_mm, START[2]))
    truth = np.array([[0.0, 0.0, -offset_mm, 0.0, 1.0, 0.0]])
    reached = table._execution(nearest=False).reached(np.array([believed]), truth, 0)
    apart = math.dist(lab.plant.tip().position_mm, (*table.scenario.target.center_mm, 0.0))
    assert report.outcome == "target", report.cause  # the controller believes so
    assert (apart <= table.scenario.target.radius_mm) == reached[0] == is_reached
