"""Faults 28 to 33 of robot and link through the guard: its state, its cause, and whether the needle stands."""

from collections.abc import Callable

import pytest

from needleplan.control.safety import Cause, Order
from needleplan.devices.robot import Fault, RobotState
from needleplan.devices.robot.messages import Head, RobotCommand, RobotKind, encode
from needleplan.errors import DeviceFault, MotionRefused
from tests.control.faults.robot_faults import BORNE, SERIOUS, drive
from tests.control.faults.robot_rig import RobotRig


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


@pytest.mark.parametrize(("name", "inject"), BORNE, ids=[each[0] for each in BORNE])
def test_what_a_link_bears_stops_nothing(name: str, inject: Callable[[RobotRig], None]) -> None:
    rig = RobotRig()
    rig.begin()
    inject(rig)
    rig.turns(0.3)
    assert rig.state == "ENABLED", name
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


def test_32_34_what_comes_late_for_good_is_not_taken_for_fresh() -> None:
    """The statuses come again, a moment older each than it seems; the robot's clock is 77 s ahead of ours."""
    rig = RobotRig()
    rig.begin()
    rig.bench.network.from_robot.delay_s = 0.08
    rig.turns(0.5)
    assert rig.state in ("FAULT", "DISABLED")
    rig.start_again()
    rig.turns(0.5)
    assert Cause.STAGE_STALE in rig.guard.state.present
    assert rig.state == "FAULT"
    rig.bench.network.from_robot.delay_s = 0.0
    rig.start_again()
    rig.turns(0.5)
    assert rig.state == "DISABLED"
    assert not rig.guard.state.present


@pytest.mark.parametrize("moves", [True, False])
def test_a_stop_by_a_stranger_is_noticed_with_the_next_sample(moves: bool) -> None:
    rig = RobotRig()
    rig.begin()
    if not moves:
        rig.guard.insert(rig.bench.truth[0], 10.0)
        rig.turns(0.2)
        assert (rig.moving, rig.state) == (False, "ENABLED")
    began_ns = rig.bench.clock.now_ns()
    stop = encode(RobotCommand(Head(0, 1, 1, number=1), RobotKind.STOP))
    rig.bench.machine.receive(stop, ("stranger", 9), began_ns + rig.bench.network.ahead_ns)
    rig.turn()
    state, causes, left_ns = rig.left_enabled()
    assert (state, causes) == ("FAULT", {Cause.STAGE_FAULT})
    assert (left_ns - began_ns) * 1e-9 <= 0.002
    assert any("another sender ordered a stop" in each.text for each in rig.events)
    with pytest.raises(MotionRefused):
        rig.guard.insert(100.0, 10.0)
    assert not rig.moving
