"""Faults 28, 30 and 31 of the device layer: what is wrong with a drive stops the robot and comes back with its cause.

The clock is virtual. Fault 29 is that of CANopen drives.
"""

import pytest

from needleplan.devices.robot import Fault, RobotDriveFaults, RobotState
from needleplan.devices.robot.messages import Result, RobotKind
from needleplan.errors import DeviceFault
from tests.devices.robot.bench import Bench, fault_of, moving, next_of, raw, result_of, stands_still

MS = 1e-3


@pytest.mark.parametrize(
    ("injected", "cause", "within_s"),
    [(RobotDriveFaults(reported=Fault.DRIVE), "a drive reports a fault", 1 * MS),
     (RobotDriveFaults(reported=Fault.LIMIT), "a limit switch was reached", 1 * MS),
     (RobotDriveFaults(reported=Fault.ESTOP), "the emergency stop was pressed", 1 * MS),
     (RobotDriveFaults(jump_mm=0.5), "an encoder has jumped", 1 * MS),
     (RobotDriveFaults(stuck=True), "an axis does not move", 22 * MS),
     (RobotDriveFaults(reversed=True), "counts in the wrong direction", 12 * MS),
     (RobotDriveFaults(slow=0.5), "an axis does not follow", 42 * MS)],
)  # fmt: skip
def test_28_30_what_is_wrong_with_a_drive_stops_it_and_is_told(
    bench: Bench, injected: RobotDriveFaults, cause: str, within_s: float
) -> None:
    """At 10 mm/s. What needs time to be seen has gone, or should have gone, 0.2 mm."""
    stage = moving(bench)
    bench.drive.faults = injected
    began_ns = bench.clock.now_ns()
    fault_of(stage, cause)
    assert bench.clock.now_ns() - began_ns <= within_s * 1e9 + 1
    assert bench.machine.state is RobotState.FAULT
    stands_still(bench)
    bench.drive.faults = RobotDriveFaults()
    stage.start()
    assert not next_of(stage).moving
    stands_still(bench, 0.02)


def test_30_from_a_limit_switch_there_is_only_one_way(bench: Bench) -> None:
    stage = moving(bench)
    bench.drive.faults.reported = Fault.LIMIT
    fault_of(stage, "a limit switch")
    stage.start()
    with pytest.raises(DeviceFault, match="does not accept this target"):
        stage.insert(100.0, 5.0)
    stage.insert(-10.0, 5.0)
    assert next_of(stage).moving
    bench.drive.faults.reported = Fault(0)
    next_of(stage)
    stage.insert(20.0, 5.0)
    assert next_of(stage).moving


def test_31_an_emergency_stop_that_is_released_does_not_restart(bench: Bench) -> None:
    stage = moving(bench)
    bench.drive.faults.reported = Fault.ESTOP
    fault_of(stage, "the emergency stop")
    with pytest.raises(DeviceFault, match="reset: the robot is in a fault: the emergency stop was pressed"):
        stage.start()
    bench.drive.faults.reported = Fault(0)
    stands_still(bench)
    assert bench.machine.state is RobotState.FAULT
    assert result_of(raw(bench, RobotKind.INSERT)) is Result.IN_FAULT
    assert result_of(raw(bench, RobotKind.ENABLE)) is Result.IN_FAULT
    assert result_of(raw(bench, RobotKind.STOP)) is Result.ACCEPTED
    assert result_of(raw(bench, RobotKind.RESET)) is Result.ACCEPTED
    assert bench.machine.state is RobotState.DISABLED
    assert result_of(raw(bench, RobotKind.INSERT)) is Result.NOT_ENABLED
    stands_still(bench, 0.02)
