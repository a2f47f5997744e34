"""The needleplan robot protocol over UDP: a stage for the controller, and the robot side with simulated drives."""

from needleplan.devices.robot._machine import DriveLimits, RobotDrive, RobotDriveState, RobotLimits, RobotMachine
from needleplan.devices.robot._simulator import RobotDriveFaults, RobotLink, RobotNetwork, RobotServer, SteadyDrive
from needleplan.devices.robot._stage import RobotStage, RobotTiming
from needleplan.devices.robot.messages import Fault, RobotState

__all__ = [
    "DriveLimits",
    "Fault",
    "RobotDrive",
    "RobotDriveFaults",
    "RobotDriveState",
    "RobotLimits",
    "RobotLink",
    "RobotMachine",
    "RobotNetwork",
    "RobotServer",
    "RobotStage",
    "RobotState",
    "RobotTiming",
    "SteadyDrive",
]
