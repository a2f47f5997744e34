"""Stage with two CiA-402 drives on a CAN bus (CANopen); requires the optional dependency `canopen`."""

from needleplan.devices.cia402._axes import DriveTiming
from needleplan.devices.cia402._simulated_drive import Cia402DriveFaults, SimulatedDrive, SimulatedDrives
from needleplan.devices.cia402._stage import CanopenStage
from needleplan.devices.cia402.setup import AxisSetup, DrivesSetup, InsertionSetup, RollSetup, VelocityUnit

__all__ = [
    "AxisSetup",
    "CanopenStage",
    "Cia402DriveFaults",
    "DriveTiming",
    "DrivesSetup",
    "InsertionSetup",
    "RollSetup",
    "SimulatedDrive",
    "SimulatedDrives",
    "VelocityUnit",
]
