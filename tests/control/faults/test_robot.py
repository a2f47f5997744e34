"""Faults 28 to 33 of robot and link through the guard: its state, its cause, and whether the needle stands."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from needleplan.control.safety import Cause, Order
from needleplan.devices.robot import DriveFaults, Fault, RobotMachine, RobotState
from needleplan.errors import DeviceFault, MotionRefused
from tests.control.faults.robot_rig import RobotRig


def drive(**faults: object) -> Callable[[RobotRig], None]:
    def inject(rig: RobotRig) -> None:
        rig.bench.drive.faults = DriveFaults(**faults)  # type: ignore[arg-type]

    return inject


def cut(rig: RobotRig) -> None:
    rig.bench.network.to_robot.cut = rig.bench.network.from_robot.cut = True


def deaf(rig: RobotRig) -> None:
    rig.bench.network.to_robot.cut = True


def mute(rig: RobotRig) -> None:
    rig.bench.network.from_robot.cut = True


def slow(rig: RobotRig) -> None:
    rig.bench.network.to_robot.delay_s = rig.bench.network.from_robot.delay_s = 1.0


def forgets(rig: RobotRig) -> None:
    rig.bench.network.machine = rig.bench.machine = RobotMachine(rig.bench.drive)
    rig.bench.drive.stop()


def hangs(rig: RobotRig) -> None:
    rig.hangs = True


def stolen(rig: RobotRig) -> None:
    with pytest.raises(DeviceFault, match="another controller"):
        rig.bench.stage(name="another")


def lossy(rig: RobotRig) -> None:
    rig.bench.network.to_robot.lose = rig.bench.network.from_robot.lose = 3


def doubled(rig: RobotRig) -> None:
    rig.bench.network.to_robot.double = rig.bench.network.from_robot.double = 50


SERIOUS = [
    ("28 a drive reports a fault", drive(reported=Fault.DRIVE), Cause.STAGE_FAULT, 0.01),
    ("30 a limit switch", drive(reported=Fault.LIMIT), Cause.STAGE_FAULT, 0.01),
    ("30 an encoder jumps", drive(jump_mm=0.5), Cause.STAGE_FAULT, 0.01),
    ("30 an axis does not move", drive(stuck=True), Cause.STAGE_FAULT, 0.05),
    ("30 an encoder counts the wrong way", drive(reversed=True), Cause.STAGE_FAULT, 0.05),
    ("30 an axis does not follow", drive(slow=0.5), Cause.STAGE_FAULT, 0.05),
    ("31 the emergency stop is pressed", drive(reported=Fault.ESTOP), Cause.STAGE_FAULT, 0.01),
    ("32 the link is cut", cut, Cause.STAGE_STALE, 0.05),
    ("32 the robot does not hear us", deaf, Cause.STAGE_FAULT, 0.05),
    ("32 we do not hear the robot", mute, Cause.STAGE_STALE, 0.05),
    ("32 a delay of a second", slow, Cause.STAGE_STALE, 0.05),
    ("32 the robot has forgotten the session", forgets, Cause.STAGE_FAULT, 0.05),
    ("33 the loop hangs, the robot's watchdog is first", hangs, Cause.STAGE_FAULT, 0.05),
]  # fmt: skip


@pytest.mark.parametrize(("name", "inject", "cause", "within_s"), SERIOUS, ids=[each[0] for each in SERIOUS])
def test_it_is_a_fault_and_the_needle_stands(
    name: str, inject: Callable[[RobotRig], None], cause: Cause, within_s: float
) -> None:
    rig = RobotRig()
    rig.begin()
    began_ns = rig.bench.clock.now_ns()
    inject(rig)
    moved_mm = rig.bench.truth[0]
    stood_s = None
    while stood_s is None and rig.bench.clock.now_ns() - began_ns < 5e9:
        rig.turn()
        if not rig.moving:
            stood_s = (rig.bench.clock.now_ns() - began_ns) * 1e-9
    rig.turns(0.1)
    state, causes, left_ns = rig.left_enabled()
    # One thing may be seen in two ways at once: what does not answer is also what has refused.
    assert state == "FAULT", name
    assert cause in causes
    assert (left_ns - began_ns) * 1e-9 <= within_s
    assert stood_s is not None
    assert abs(rig.bench.truth[0] - moved_mm) < 10 * 0.06 + 0.5
    with pytest.raises(MotionRefused):
        rig.guard.insert(100.0, 10.0)
    assert not rig.moving


@pytest.mark.parametrize("inject", [lossy, doubled, stolen])
def test_32_36_what_a_link_bears_stops_nothing(inject: Callable[[RobotRig], None]) -> None:
    rig = RobotRig()
    rig.begin()
    inject(rig)
    rig.turns(0.3)
    assert rig.state == "ENABLED"
    assert rig.moving


def test_31_an_emergency_stop_that_is_released_does_not_restart() -> None:
    rig = RobotRig()
    rig.begin()
    drive(reported=Fault.ESTOP)(rig)
    rig.turns(0.1)
    assert any("emergency stop was pressed" in each.text for each in rig.events)
    drive()(rig)
    rig.turns(0.2)
    assert rig.state == "FAULT", "the robot has given up until somebody starts it again"
    rig.start_again()
    rig.turns(0.2)
    assert rig.bench.machine.state is RobotState.ENABLED
    assert rig.state == "DISABLED"
    with pytest.raises(MotionRefused, match="not_reset"):
        rig.guard.order(Order.ENABLE)
    rig.guard.order(Order.RESET, "anna")
    with pytest.raises(MotionRefused, match="not_homed"):
        rig.guard.order(Order.ENABLE, "anna")
    for order in (Order.HOME, Order.ENABLE):
        rig.guard.order(order, "anna")
    rig.turns(0.2)
    assert rig.state == "ENABLED"
    assert not rig.moving, "nothing is taken up again"
    rig.guard.insert(50.0, 10.0)
    rig.turns(0.05)
    assert rig.moving


def test_a_person_retracts_with_a_robot_that_was_in_fault() -> None:
    rig = RobotRig()
    rig.begin()
    drive(reported=Fault.DRIVE)(rig)
    rig.turns(0.1)
    drive()(rig)
    with pytest.raises(DeviceFault, match="a drive reports a fault"):
        rig.guard.retract(-100.0, 10.0, "anna")
    rig.start_again()
    rig.turns(0.05)
    assert rig.state == "DISABLED"
    rig.guard.retract(0.0, 10.0, "anna")
    rig.turns(0.5)
    assert rig.bench.truth[0] == pytest.approx(0.0, abs=0.01)
    assert rig.state == "DISABLED"
