"""NDI Aurora and Polaris trackers: the combined API over a serial port or TCP, and a device that speaks it."""

from needleplan.devices.ndi.crc import crc16
from needleplan.devices.ndi.in_process import DeviceLink
from needleplan.devices.ndi.judgement import PoseLimits
from needleplan.devices.ndi.simulator import AuroraDevice, DeviceFaults, SimulatedTool
from needleplan.devices.ndi.tracker import NdiTracker

__all__ = ["AuroraDevice", "DeviceFaults", "DeviceLink", "NdiTracker", "PoseLimits", "SimulatedTool", "crc16"]
