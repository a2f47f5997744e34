"""Devices: stages, force sensors and trackers behind three small interfaces, and the links and protocols under them."""

from needleplan.devices.address import Address
from needleplan.devices.base import (
    Device,
    ForceSample,
    ForceSensor,
    Health,
    PoseSample,
    Stage,
    StageSample,
    Stamp,
    Tracker,
)
from needleplan.devices.clock import Clock, Deadline, SystemClock, VirtualClock
from needleplan.devices.link import Link, MemoryLink, memory_pair
from needleplan.devices.network import TcpLink, UdpLink
from needleplan.devices.opening import open_link
from needleplan.devices.serial_port import SerialLink
from needleplan.devices.station import Feed, Sample, Source, Station, ThreadedFeed, TurnFeed

__all__ = [
    "Address",
    "Clock",
    "Deadline",
    "Device",
    "Feed",
    "ForceSample",
    "ForceSensor",
    "Health",
    "Link",
    "MemoryLink",
    "PoseSample",
    "Sample",
    "SerialLink",
    "Source",
    "Stage",
    "StageSample",
    "Stamp",
    "Station",
    "SystemClock",
    "TcpLink",
    "ThreadedFeed",
    "Tracker",
    "TurnFeed",
    "UdpLink",
    "VirtualClock",
    "memory_pair",
    "open_link",
]
