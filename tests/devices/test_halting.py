"""A stop of a stage without a guard, until it is measured at rest."""

import pytest

from needleplan.bystander import StopOutcome
from needleplan.devices import halt
from needleplan.devices.robot import Fault, RobotState
from needleplan.stopping import Rest
from tests.devices.robot.bench import Bench, fault_of, moving


def test_it_ends_when_the_needle_rests() -> None:
    bench = Bench()
    stage = moving(bench)
    outcome = halt(stage, 2.0, clock=bench.clock)
    assert outcome.is_confirmed
    assert 0.25 <= outcome.took_s < 0.3  # the speed at the stop is unknown
    assert bench.truth[1] is False
    assert bench.machine.state is RobotState.ENABLED


@pytest.mark.parametrize("claims_rest", [False, True])
def test_a_stage_that_goes_on_is_told_of_and_gets_no_more_heartbeats(claims_rest: bool) -> None:
    bench, alarms = Bench(), list[StopOutcome]()
    stage = moving(bench)
    bench.drive.faults.missed_stops, bench.drive.faults.claims_rest = 10**9, claims_rest
    outcome = halt(stage, 1.0, alarms.append, clock=bench.clock)
    assert (outcome.result, outcome.rest) == (0, Rest.MOVES)
    assert [each.rest for each in alarms] == [Rest.MOVES]
    assert alarms[0].moved_mm < 1.2
    assert outcome.sent > 30
    assert "the needle still moves" in outcome.why_not("here")
    assert claims_rest or bench.machine.faults & Fault.WATCHDOG  # without heartbeats the watchdog of the robot acts


def test_it_is_measured_after_a_fault_of_the_robot_too() -> None:
    bench = Bench()
    stage = moving(bench)
    bench.drive.faults.reported = Fault.DRIVE
    bench.wait(0.02)
    fault_of(stage, "a drive reports a fault")
    assert halt(stage, 2.0, clock=bench.clock).is_confirmed


def test_a_stage_that_is_silent_is_told_of() -> None:
    bench, alarms = Bench(), list[StopOutcome]()
    stage = moving(bench)
    bench.network.from_robot.cut = True
    outcome = halt(stage, 0.5, alarms.append, clock=bench.clock)
    assert (outcome.result, outcome.is_confirmed) == (None, False)
    assert alarms[0].rest is Rest.UNKNOWN
    assert "no answer" in outcome.obstacle
