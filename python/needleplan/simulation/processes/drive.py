"""The plant as the drives of a robot, and as what the sensors measure."""

from __future__ import annotations

from collections.abc import Callable

from needleplan.devices import ForceSample, PoseSample
from needleplan.devices.robot import DriveLimits, RobotDrive, RobotDriveState
from needleplan.simulation.lab import Lab

__all__ = ["PlantDrive", "limits_of"]

_MOST_S = 0.05
"""A servo that stood still for longer does not make up for it."""


class PlantDrive(RobotDrive):
    """The two axes of `lab`; `measured` is told the samples of force sensor and tracker as time goes on."""

    def __init__(self, lab: Lab, measured: Callable[[ForceSample | PoseSample], None]) -> None:
        self._lab, self._measured = lab, measured
        self._time_s: float | None = None

    def advance(self, time_s: float) -> RobotDriveState:
        """Go on to a time, and say where the axes are."""
        lab, plant = self._lab, self._lab.plant
        passed_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        lab.advance(min(passed_s, _MOST_S))
        lab.stage.waiting()
        for force in lab.force_sensor.waiting():
            self._measured(force)
        for pose in lab.tracker.waiting():
            self._measured(pose)
        insertion, roll = plant.insertion, plant.roll
        return RobotDriveState(
            insertion.measured, insertion.measured_velocity, roll.measured, roll.measured_velocity,
            insertion.reference, roll.reference, plant.moving,
        )  # fmt: skip

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth. Raises DeviceFault for what the robot of the setup cannot do."""
        self._lab.plant.insert(depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn to a roll. Raises DeviceFault for what the robot of the setup cannot do."""
        self._lab.plant.rotate(roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Stop both axes as fast as their profiles may."""
        self._lab.plant.stop()


def limits_of(lab: Lab) -> DriveLimits:
    """Return what is a fault of an axis: the usual, and a tick of the servo, by which the wanted place is behind."""
    robot, usual = lab.plant.setup.robot, DriveLimits()
    return DriveLimits(
        usual.following_mm + robot.top_velocity_mm_s / robot.servo_hz,
        usual.following_rad + robot.top_velocity_rad_s / robot.servo_hz,
        4 * robot.top_velocity_mm_s,
        4 * robot.top_velocity_rad_s,
    )
