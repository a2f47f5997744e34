"""NDI Aurora and Polaris trackers: the combined API over a serial port or TCP, and a device that speaks it."""

from needleplan.devices.ndi._simulator import AuroraDevice, AuroraFaults, AuroraLink, SimulatedTool
from needleplan.devices.ndi._tracker import NdiTracker
from needleplan.devices.ndi._validation import NdiPoseLimits
from needleplan.devices.ndi.frames import crc16

__all__ = ["AuroraDevice", "AuroraFaults", "AuroraLink", "NdiPoseLimits", "NdiTracker", "SimulatedTool", "crc16"]
