"""NDI Aurora and Polaris trackers (combined API over a serial port or TCP), and a simulated Aurora."""

from needleplan.devices.ndi._simulator import AuroraDevice, AuroraFaults, SimulatedTool
from needleplan.devices.ndi._tracker import NdiTracker
from needleplan.devices.ndi.frames import NdiPoseLimits, crc16

__all__ = ["AuroraDevice", "AuroraFaults", "NdiPoseLimits", "NdiTracker", "SimulatedTool", "crc16"]
