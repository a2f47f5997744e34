"""Devices: stages, force sensors and trackers behind three small interfaces, and the links and protocols under them."""

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

__all__ = [
    "Clock",
    "Deadline",
    "Device",
    "ForceSample",
    "ForceSensor",
    "Health",
    "Link",
    "MemoryLink",
    "PoseSample",
    "Stage",
    "StageSample",
    "Stamp",
    "SystemClock",
    "Tracker",
    "VirtualClock",
    "memory_pair",
]
