"""The needleplan robot protocol over UDP or a serial line.

A stage for the controller, and the robot side with simulated drives.
"""

from needleplan.devices.robot._drives import DriveLimits, RobotDrive, RobotDriveState, RobotLimits
from needleplan.devices.robot._machine import RobotMachine
from needleplan.devices.robot._relay import RobotRelay
from needleplan.devices.robot._simulator import RobotDriveFaults, RobotServer, SteadyDrive
from needleplan.devices.robot._stage import RobotStage, RobotTiming, read_key
from needleplan.devices.robot._way import LINE_BAUD, RobotWay, open_way, stop_robot
from needleplan.devices.robot.messages import Fault, MotionLimits, RobotState, RobotStatus

__all__ = [
    "LINE_BAUD",
    "DriveLimits",
    "Fault",
    "MotionLimits",
    "RobotDrive",
    "RobotDriveFaults",
    "RobotDriveState",
    "RobotLimits",
    "RobotMachine",
    "RobotRelay",
    "RobotServer",
    "RobotStage",
    "RobotState",
    "RobotStatus",
    "RobotTiming",
    "RobotWay",
    "SteadyDrive",
    "open_way",
    "read_key",
    "stop_robot",
]
