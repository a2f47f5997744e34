"""Devices: stages, force sensors and trackers behind three small interfaces, and the links and protocols under them."""

from needleplan.devices._base import (
    Closing,
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
from needleplan.devices._clock import Clock, Deadline, SystemClock, VirtualClock, no_long_collections, short_turns
from needleplan.devices._links import Link, MemoryLink, SerialLink, TcpLink, UdpLink, memory_pair
from needleplan.devices._opening import Address, open_link
from needleplan.devices._station import Feed, Sample, Source, Station, ThreadedFeed, TurnFeed

__all__ = [
    "Address",
    "Clock",
    "Closing",
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
    "no_long_collections",
    "open_link",
    "short_turns",
]
