"""OpenIGTLink: a tracker behind a PLUS server, a server for 3D Slicer, and a simulated PLUS server."""

from needleplan.devices.igtl._needle_sensors import NeedleSensor, open_fibre, open_images
from needleplan.devices.igtl._server import MessageServer, Shown, SlicerServer
from needleplan.devices.igtl._simulator import PlusDevice, PlusFaults, PlusServer, TrackedTool
from needleplan.devices.igtl._tracker import IGTL_PORT, IgtlTracker, PoseKind
from needleplan.devices.igtl.contents import StatusCode
from needleplan.devices.igtl.messages import crc64
from needleplan.devices.igtl.poses import IgtlPoseLimits

__all__ = [
    "IGTL_PORT",
    "IgtlPoseLimits",
    "IgtlTracker",
    "MessageServer",
    "NeedleSensor",
    "PlusDevice",
    "PlusFaults",
    "PlusServer",
    "PoseKind",
    "Shown",
    "SlicerServer",
    "StatusCode",
    "TrackedTool",
    "crc64",
    "open_fibre",
    "open_images",
]
