"""The needleplan robot protocol over UDP: a stage on the control side, and a robot on the capture side."""

from needleplan.devices.robot.drive import Drive, DriveLimits, DriveState
from needleplan.devices.robot.in_process import RobotLink, RobotNetwork
from needleplan.devices.robot.machine import RobotLimits, RobotMachine
from needleplan.devices.robot.messages import Fault, RobotState
from needleplan.devices.robot.simulator import DriveFaults, RobotServer, SteadyDrive
from needleplan.devices.robot.stage import RobotStage, RobotTiming

__all__ = [
    "Drive",
    "DriveFaults",
    "DriveLimits",
    "DriveState",
    "Fault",
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
