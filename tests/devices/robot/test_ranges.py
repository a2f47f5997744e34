"""Measured positions against the limits of the session, whatever was commanded: the robot stops by itself."""

import math
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.devices.robot import Fault, MotionLimits, RobotDriveState, RobotLimits, RobotStage, RobotState
from needleplan.devices.robot._drives import RangeWatch
from needleplan.devices.robot.messages import RobotKind
from tests.devices.robot.bench import Bench, fault_of, next_of, raw, stands_still
from tests.devices.robot.test_bytes import compiled

LIMITS = MotionLimits(-5.0, 30.0, 8.0, 4.0, 2.0, 100_000)
TOLERANCE = 0.2


def until_fault(bench: Bench, stage: RobotStage) -> RobotDriveState:
    """Let the robot run, with a controller that does not listen, until a fault; return what it measured then."""
    for _ in range(3000):
        stage.heartbeat()
        bench.wait(0.001)
        if bench.machine.faults:
            state = bench.machine._last
            assert state is not None
            return state
    raise AssertionError


@pytest.mark.parametrize(("runaway", "position"), [
    ((20.0, 0.0), 30.2), ((-20.0, 0.0), -5.2), ((0.0, 5.0), 4.05), ((0.0, -5.0), -4.05),
])  # fmt: skip
def test_an_axis_that_leaves_the_limits_of_the_session_by_itself_is_stopped(
    bench: Bench, runaway: tuple[float, float], position: float
) -> None:
    stage = bench.stage(limits=LIMITS)
    bench.drive.faults.runaway = runaway
    stopped = until_fault(bench, stage)
    assert bench.machine.faults == Fault.BEYOND
    assert bench.machine.state is RobotState.FAULT
    measured = stopped.depth_mm if runaway[0] else stopped.roll_rad
    assert measured == pytest.approx(position, abs=0.0201)  # one tick


def test_the_controller_is_told_and_a_motion_is_refused_until_a_reset(bench: Bench) -> None:
    stage = bench.stage(limits=LIMITS)
    bench.drive.faults.runaway = (50.0, 0.0)
    fault_of(stage, "the measured depth or roll is beyond the limits of the session")
    bench.drive.faults.runaway = (0.0, 0.0)
    stands_still(bench)
    stage.start()
    assert bench.machine.faults == Fault(0)
    before_mm, _ = bench.truth
    stage.insert(20.0, 8.0)
    assert all(next_of(stage).moving for _ in range(200))
    assert bench.truth[0] == pytest.approx(before_mm - 1.6, abs=0.02)
    assert bench.machine.state is RobotState.ENABLED


def test_a_needle_that_lies_beyond_the_limits_of_a_session_can_be_pulled_out_and_not_pushed_in(bench: Bench) -> None:
    first = bench.stage()
    first.insert(60.0, 50.0)
    while next_of(first).moving:
        pass
    first.close()
    stage = bench.stage(limits=LIMITS)
    stage.insert(0.0, 8.0)
    while (depth_mm := next_of(stage).depth_mm) > 50.0:
        assert bench.machine.faults == Fault(0)
    bench.drive.faults.runaway = (100.0, 0.0)
    assert until_fault(bench, stage).depth_mm == pytest.approx(depth_mm + TOLERANCE, abs=0.3)
    fault_of(stage, "beyond the limits")


def test_without_a_session_the_limits_of_the_robot_hold() -> None:
    bench = Bench(RobotLimits(least_mm=-1.0, most_mm=40.0))
    bench.drive.faults.runaway = (100.0, 0.0)
    bench.wait(0.3)
    assert bench.machine.faults == Fault(0)
    bench.wait(0.2)
    assert bench.machine.faults == Fault.BEYOND


def test_a_motion_to_the_very_limit_is_no_fault(bench: Bench) -> None:
    stage = bench.stage(limits=LIMITS)
    for depth_mm in (15.0, 30.0, 15.0, 0.0, -5.0):
        stage.insert(depth_mm, 8.0)
        while next_of(stage).moving:
            pass
        assert bench.truth[0] == pytest.approx(depth_mm)
    assert raw(bench, RobotKind.ROTATE, target=4.0, speed=2.0) is not None
    bench.wait(0.01)
    assert bench.machine.faults == Fault(0)


@given(st.lists(st.floats(-60, 60), min_size=1, max_size=40))
def test_an_axis_is_stopped_exactly_where_it_is_farther_out_than_it_has_been(positions: list[float]) -> None:
    """The model: the nearest distance so far plus the tolerance; the first position is always allowed."""
    watch = RangeWatch(TOLERANCE)
    beyond = [max(-5.0 - each, each - 30.0, 0.0) for each in positions]
    for at, position in enumerate(positions):
        expected = at > 0 and beyond[at] > min(beyond[:at]) + TOLERANCE
        assert watch.beyond(position, -5.0, 30.0) == expected


def test_a_position_that_is_no_number_is_not_within() -> None:
    watch = RangeWatch(TOLERANCE)
    assert all(watch.beyond(each, -5.0, 30.0) for each in (math.nan, math.inf, -math.inf))
    assert not watch.beyond(0.0, -5.0, 30.0)


PROGRAM = r"""
#include <stdio.h>
#include "needleplan_robot.h"
int main(void) {
    npl_range range;
    double measured;
    npl_range_begin(&range, -5, 30);
    while (fread(&measured, sizeof measured, 1, stdin) == 1)
        putchar('0' + npl_range_beyond(&range, measured, 0.2));
    return 0;
}
"""


def test_the_rule_of_the_c_header_is_that_of_the_machine(tmp_path: Path) -> None:
    positions = [40.0 * math.sin(1.7 * at) + 3e-3 * at for at in range(2000)] + [math.nan, 90.0, math.inf, 30.1]
    program = compiled(PROGRAM, tmp_path)
    for begin in (0, 3, 7):
        raw_positions = struct.pack(f"<{len(positions) - begin}d", *positions[begin:])
        done = subprocess.run([program], input=raw_positions, capture_output=True, check=True, timeout=60)
        watch = RangeWatch(TOLERANCE)
        assert done.stdout.decode() == "".join(str(int(watch.beyond(each, -5.0, 30.0))) for each in positions[begin:])
        assert b"01" in done.stdout
