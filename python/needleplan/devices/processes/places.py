"""Where the devices of a lab in real time are to be found."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["LabAddresses", "LabPlaces", "TrackerLine"]


class TrackerLine(StrEnum):
    """How the tracker is reached."""

    PTY = "pty"
    TCP = "tcp"


@dataclass(frozen=True)
class LabPlaces:
    """Where the devices are to be; port 0 is any that is free."""

    host: str = "127.0.0.1"
    robot_port: int = 0
    force_port: int = 0
    http_port: int = 0
    """Of the force sensor's configuration."""

    tracker_line: TrackerLine = TrackerLine.PTY
    tracker_port: int = 0


@dataclass(frozen=True)
class LabAddresses:
    """Where the devices are; each opens its device."""

    robot: str
    force: str
    tracker: str
