"""What TX and BX say: for each tool where it is, whether it is seen, and in which frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["PORT_SUSPECT", "SYSTEM_SUSPECT", "Frames", "Seen", "ToolFrame", "bits_of"]

_NAN = math.nan

PORT_SUSPECT = {0x40: "out of the volume", 0x80: "partly out of the volume"}
"""Bits of the port status under which numbers may be plausible and wrong; those above 0x80 are told by number."""

SYSTEM_SUSPECT = {
    0x01: "synchronisation",
    0x02: "external infrared",
    0x04: "CRC in the system",
    0x08: "recoverable error",
}
"""Bits of the system status that leave the tracker usable."""


class Seen(StrEnum):
    """Whether the device says where a tool is."""

    VALID = "valid"
    MISSING = "missing"
    DISABLED = "disabled"
    UNOCCUPIED = "unoccupied"


@dataclass(frozen=True)
class ToolFrame:
    """One tool in one frame: quaternion (w, x, y, z) and position are NaN where it is not VALID."""

    handle: int
    seen: Seen
    quaternion: tuple[float, float, float, float] = (_NAN, _NAN, _NAN, _NAN)
    position_mm: tuple[float, float, float] = (_NAN, _NAN, _NAN)
    error_mm: float = _NAN
    port_status: int | None = None
    frame: int | None = None


@dataclass(frozen=True)
class Frames:
    """One reply to TX or BX."""

    tools: tuple[ToolFrame, ...]
    system_status: int


def bits_of(status: int, names: dict[int, str]) -> tuple[str, ...]:
    """Return the names of the bits that are set."""
    return tuple(name for bit, name in names.items() if status & bit)
