"""Setup of two drives, read from a TOML file: encoder, gear, lead and motion limits of each axis.

```toml
schema = "needleplan.drives/1"

[insertion]
node = 1
counts_per_turn = 4096
gear = 14.0
lead_mm = 2.0
least_mm = 0.0
most_mm = 150.0

[roll]
node = 2
counts_per_turn = 4096
gear = 23.0
```
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Self

from needleplan.config import Choice, ConfigTable, Integer, Number, Sign, Subtable, parse_toml, read_toml, ruled
from needleplan.errors import ConfigurationError, Mistake

__all__ = ["AxisLimits", "AxisSetup", "DrivesSetup", "InsertionSetup", "RollSetup", "VelocityUnit"]

# Largest count of an encoder: positions are signed 32-bit integers on the wire.
_MOST_COUNTS = (1 << 31) - 1
_COUNTS = Integer(-_MOST_COUNTS, _MOST_COUNTS)
_MM, _RAD = Number("mm", at_least=-1e4, at_most=1e4), Number("rad", at_least=-1e4, at_most=1e4)


class VelocityUnit(StrEnum):
    """Unit of velocities in the object dictionary of a drive; accelerations are in this unit per second."""

    RPM = "rpm"
    """Turns of the motor per minute; the factory setting of EPOS4."""

    COUNTS = "counts/s"


@dataclass(frozen=True)
class AxisLimits:
    """Travel per turn and motion limits of an axis; lengths are in mm (insertion) or rad (roll), times in s."""

    turn: float
    """Travel per turn of the output shaft of the gear, mm or rad."""

    least: float
    most: float
    fastest: float
    acceleration: float
    stop: float
    """Deceleration of a quick stop."""

    margin: float
    """Largest displacement (mm or rad) that is taken for noise, not for a motion, a jump or a wrong direction."""


@dataclass(frozen=True)
class AxisSetup(ConfigTable, ABC, error=ConfigurationError):
    """Abstract setup of one axis. Lengths are in mm (insertion) or rad (roll), times in s."""

    node: int = ruled(Integer(1, 126))
    """CANopen node number of the drive."""

    counts_per_turn: int = ruled(Integer(1, 1 << 24))
    """Encoder counts per turn of the motor, with all four edges of the encoder signals counted."""

    gear: float = ruled(Number(above=0, at_most=1e5), 1.0)
    """Gear ratio: turns of the motor per turn of the output shaft."""

    direction: int = ruled(Sign(), 1)
    """1 if the counts increase with the position of the axis, else -1."""

    zero_counts: int = ruled(_COUNTS, 0)
    """Encoder count at position 0 of the axis."""

    velocity_unit: VelocityUnit = ruled(Choice(VelocityUnit), VelocityUnit.RPM)

    @property
    def name(self) -> str:
        """Name of the axis: `insertion` or `roll`."""
        return self.key

    @property
    @abstractmethod
    def limits(self) -> AxisLimits:
        """Travel per turn and motion limits of the axis."""

    @property
    def counts_per_unit(self) -> float:
        """Encoder counts per mm or rad; negative if `direction` is -1."""
        return self.direction * self.counts_per_turn * self.gear / self.limits.turn

    def counts(self, position: float) -> int:
        """Return the encoder count nearest to a position (mm or rad)."""
        return self.zero_counts + round(position * self.counts_per_unit)

    def position(self, counts: int) -> float:
        """Return the position (mm or rad) at an encoder count."""
        return (counts - self.zero_counts) / self.counts_per_unit

    def speed(self, velocity: float) -> int:
        """Convert a velocity or an acceleration of the axis to the unit of the drive; return the rounded magnitude."""
        counts = abs(velocity * self.counts_per_unit)
        return round(counts * 60 / self.counts_per_turn if self.velocity_unit is VelocityUnit.RPM else counts)

    def velocity(self, speed: int) -> float:
        """Convert a signed velocity in the unit of the drive to the velocity of the axis (mm/s or rad/s)."""
        counts = speed * self.counts_per_turn / 60 if self.velocity_unit is VelocityUnit.RPM else speed
        return counts / self.counts_per_unit

    def contradictions(self) -> Iterator[Mistake]:
        """Yield a mistake if the limits are inconsistent, or if the drive cannot represent positions or velocities."""
        limits = self.limits
        if limits.least >= limits.most:
            yield Mistake("least", f"{limits.least:g}", f"must be less than the largest position, {limits.most:g}")
        elif max(abs(self.counts(limits.least)), abs(self.counts(limits.most))) > _MOST_COUNTS:
            yield Mistake(
                "counts_per_turn", str(self.counts_per_turn), "must be smaller: the positions exceed 32 bits of counts"
            )
        elif self.speed(limits.fastest) < 1:
            rule = "is below the smallest velocity of the drive: set velocity_unit to counts/s"
            yield Mistake("fastest", f"{limits.fastest:g}", rule)


@dataclass(frozen=True)
class InsertionSetup(AxisSetup, key="insertion"):
    """Setup of the insertion axis: the table `[insertion]`."""

    lead_mm: float = ruled(Number("mm", above=0, at_most=1000), 1.0)
    """Travel per turn of the spindle (mm)."""

    least_mm: float = ruled(_MM, 0.0)
    most_mm: float = ruled(_MM, 150.0)
    fastest_mm_s: float = ruled(Number("mm/s", above=0, at_most=1000), 20.0)
    acceleration_mm_s2: float = ruled(Number("mm/s^2", above=0, at_most=1e5), 200.0)
    stop_mm_s2: float = ruled(Number("mm/s^2", above=0, at_most=1e5), 1000.0)
    margin_mm: float = ruled(Number("mm", above=0, at_most=10), 0.2)

    @property
    def limits(self) -> AxisLimits:
        """Travel per turn (mm) and limits of position (mm), velocity (mm/s) and acceleration (mm/s^2)."""
        return AxisLimits(
            self.lead_mm, self.least_mm, self.most_mm, self.fastest_mm_s, self.acceleration_mm_s2, self.stop_mm_s2,
            self.margin_mm,
        )  # fmt: skip


@dataclass(frozen=True)
class RollSetup(AxisSetup, key="roll"):
    """Setup of the roll axis, which rotates the needle: the table `[roll]`."""

    least_rad: float = ruled(_RAD, -200.0)
    most_rad: float = ruled(_RAD, 200.0)
    fastest_rad_s: float = ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    acceleration_rad_s2: float = ruled(Number("rad/s^2", above=0, at_most=1e5), 200.0)
    stop_rad_s2: float = ruled(Number("rad/s^2", above=0, at_most=1e5), 1000.0)
    margin_rad: float = ruled(Number("rad", above=0, at_most=1), 0.05)

    @property
    def limits(self) -> AxisLimits:
        """Travel per turn (rad) and limits of position (rad), velocity (rad/s) and acceleration (rad/s^2)."""
        return AxisLimits(
            math.tau, self.least_rad, self.most_rad, self.fastest_rad_s, self.acceleration_rad_s2, self.stop_rad_s2,
            self.margin_rad,
        )  # fmt: skip


def _two_nodes(insertion: InsertionSetup, roll: RollSetup) -> Iterator[Mistake]:
    if insertion.node == roll.node:
        yield Mistake("roll.node", str(roll.node), "must differ from insertion.node")


@dataclass(frozen=True)
class DrivesSetup(ConfigTable, error=ConfigurationError, schema="needleplan.drives/1", between=(_two_nodes,)):
    """Setup of both axes. Raises ConfigurationError if both axes have the same node number."""

    insertion: InsertionSetup = ruled(Subtable(InsertionSetup))
    roll: RollSetup = ruled(Subtable(RollSetup))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a setup file and return its setup. Raises ConfigurationError with all mistakes."""
        return read_toml(path, cls)

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Self:
        """Return the setup in the TOML text `text`. Raises ConfigurationError with all mistakes."""
        return parse_toml(text, cls, source)
