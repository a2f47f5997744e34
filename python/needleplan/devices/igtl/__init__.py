"""OpenIGTLink: trackers through PLUS, a server for 3D Slicer, and a simulated PLUS server."""

from needleplan.devices.igtl.contents import StatusCode
from needleplan.devices.igtl.crc import crc64
from needleplan.devices.igtl.judgement import PoseLimits
from needleplan.devices.igtl.server import MessageServer
from needleplan.devices.igtl.simulator import PlusDevice, PlusFaults, PlusLink, PlusServer, TrackedTool
from needleplan.devices.igtl.slicer import Shown, SlicerServer
from needleplan.devices.igtl.tracker import IGTL_PORT, IgtlTracker, PoseKind

__all__ = [
    "IGTL_PORT",
    "IgtlTracker",
    "MessageServer",
    "PlusDevice",
    "PlusFaults",
    "PlusLink",
    "PlusServer",
    "PoseKind",
    "PoseLimits",
    "Shown",
    "SlicerServer",
    "StatusCode",
    "TrackedTool",
    "crc64",
]
