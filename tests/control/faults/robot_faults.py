"""Faults 28 to 33 and 36 of robot and link: how each is injected."""

from collections.abc import Callable

import pytest

from needleplan.control.safety import Cause
from needleplan.devices.robot import Fault, RobotDriveFaults, RobotMachine
from needleplan.errors import DeviceFault
from tests.control.faults.robot_rig import RobotRig

__all__ = ["BORNE", "SERIOUS", "drive"]


def drive(**faults: object) -> Callable[[RobotRig], None]:
    def inject(rig: RobotRig) -> None:
        rig.bench.drive.faults = RobotDriveFaults(**faults)  # type: ignore[arg-type]

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
    ("33 the loop hangs", hangs, Cause.LOOP_LATE, 0.05),
]  # fmt: skip
"""What ends in FAULT, for which cause, within what time in s."""

BORNE = [
    ("32 three datagrams lost, each way", lossy),
    ("32 fifty duplicates, each way", doubled),
    ("36 a second controller of the robot", stolen),
]
"""What stops nothing."""
