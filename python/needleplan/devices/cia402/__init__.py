"""CiA-402 drives on a CAN bus (CANopen) as a stage; needs the extra `canopen`."""

from needleplan.devices.cia402.setup import AxisSetup, DrivesSetup, InsertionSetup, RollSetup, VelocityUnit
from needleplan.devices.cia402.simulated_drive import DriveFaults, SimulatedDrive
from needleplan.devices.cia402.simulator import SimulatedDrives
from needleplan.devices.cia402.stage import CanopenStage
from needleplan.devices.cia402.timing import DriveTiming

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
