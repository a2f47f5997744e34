"""CiA-402 drives on a CAN bus (CANopen) as a stage; needs the extra `canopen`."""

from needleplan.devices.cia402.setup import AxisSetup, DrivesSetup, InsertionSetup, RollSetup, VelocityUnit
from needleplan.devices.cia402.simulator import DriveFaults, SimulatedDrive, SimulatedDrives
from needleplan.devices.cia402.stage import CanopenStage, DriveTiming

__all__ = [
    "AxisSetup",
    "CanopenStage",
    "DriveFaults",
    "DriveTiming",
    "DrivesSetup",
    "InsertionSetup",
    "RollSetup",
    "SimulatedDrive",
    "SimulatedDrives",
    "VelocityUnit",
]
