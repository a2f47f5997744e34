"""The robot's own stop: the drives are stopped again until they stand."""

from __future__ import annotations

import pytest

from needleplan.devices.robot import Fault, RobotState
from needleplan.devices.robot.messages import RobotKind
from tests.devices.robot.test_machine import ENABLED, Told, in_state


def inserting() -> Told:
    told = in_state(ENABLED)
    told.tell(RobotKind.INSERT)
    for _ in range(20):
        told.tick()
        told.tell(RobotKind.ALIVE)
    return told


def depth_mm(told: Told) -> float:
    return told.drive.advance(told.now_ns / 1e9).depth_mm


@pytest.mark.parametrize("claims_rest", [False, True])
@pytest.mark.parametrize("how", [RobotKind.STOP, RobotKind.GOODBYE, "any", "fault"])
def test_a_drive_that_misses_a_stop_is_stopped_again(how: RobotKind | str, claims_rest: bool) -> None:
    told = inserting()
    told.drive.faults.missed_stops = 3
    told.drive.faults.claims_rest = claims_rest
    begin_mm = depth_mm(told)
    if how == "fault":
        told.drive.faults.reported = Fault.DRIVE
    else:
        told.tell(RobotKind.STOP if how == "any" else how, session=0 if how == "any" else 1)
    for _ in range(1000):
        told.tick()
    assert told.drive.faults.missed_stops == 0
    assert depth_mm(told) - begin_mm < 0.1


def test_a_stop_in_vain_does_not_feed_the_watchdog() -> None:
    told = inserting()
    told.drive.faults.missed_stops = 10**6
    for _ in range(60):
        told.tell(RobotKind.STOP)
        told.tick()
    assert told.machine.faults & Fault.WATCHDOG
    assert told.machine.state is RobotState.FAULT


def test_the_next_motion_is_not_stopped() -> None:
    told = inserting()
    told.tell(RobotKind.STOP)
    told.tick()
    told.tell(RobotKind.INSERT)
    begin_mm = depth_mm(told)
    for _ in range(100):
        told.tick()
        told.tell(RobotKind.ALIVE)
    assert depth_mm(told) - begin_mm == pytest.approx(0.5, abs=0.01)


def test_an_axis_brakes_with_its_deceleration() -> None:
    told = inserting()
    told.drive.faults.braking_mm_s2 = 50.0
    begin_mm = depth_mm(told)
    told.tell(RobotKind.STOP)
    for _ in range(200):
        told.tick()
        told.tell(RobotKind.ALIVE)
    assert depth_mm(told) - begin_mm == pytest.approx(0.25, abs=0.02)
    assert told.machine.state is RobotState.ENABLED
