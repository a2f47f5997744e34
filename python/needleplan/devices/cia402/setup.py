"""Setup of two drives, a TOML file: encoder, gear and lead of each axis, and the limits of its motion.

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
    """The unit in which a drive counts velocities; accelerations are per second of it."""

    RPM = "rpm"
    """Turns of the motor per minute, the factory setting of EPOS4."""

    COUNTS = "counts/s"


@dataclass(frozen=True)
class AxisLimits:
    """Limits of an axis, in mm or rad and seconds."""

    turn: float
    """Travel per turn of the axis."""

    least: float
    most: float
    fastest: float
    acceleration: float
    stop: float
    """Deceleration of a quick stop."""

    margin: float
    """Largest displacement that is not yet a motion, a jump, or a motion in the wrong direction."""


@dataclass(frozen=True)
class AxisSetup(ConfigTable, ABC, error=ConfigurationError):
    """One axis; abstract. Lengths are in mm or rad, times in s."""

    node: int = ruled(Integer(1, 126))
    counts_per_turn: int = ruled(Integer(1, 1 << 24))
    """Counts per turn of the motor, with all four edges."""

    gear: float = ruled(Number(above=0, at_most=1e5), 1.0)
    """Turns of the motor per turn of the axis."""

    direction: int = ruled(Sign(), 1)
    """1, or -1 if the counts grow as the axis moves back."""

    zero_counts: int = ruled(_COUNTS, 0)
    """Count of the encoder at position 0 of the axis."""

    velocity_unit: VelocityUnit = ruled(Choice(VelocityUnit), VelocityUnit.RPM)

    @property
    def name(self) -> str:
        """`insertion` or `roll`."""
        return self.key

    @property
    @abstractmethod
    def limits(self) -> AxisLimits:
        """Limits of the axis."""

    @property
    def counts_per_unit(self) -> float:
        """Counts per mm or rad, negative for direction -1."""
        return self.direction * self.counts_per_turn * self.gear / self.limits.turn

    def counts(self, position: float) -> int:
        """Return the count nearest to a position."""
        return self.zero_counts + round(position * self.counts_per_unit)

    def position(self, counts: int) -> float:
        """Return the position of a count."""
        return (counts - self.zero_counts) / self.counts_per_unit

    def speed(self, velocity: float) -> int:
        """Return the magnitude of a velocity or an acceleration in the unit of the drive."""
        counts = abs(velocity * self.counts_per_unit)
        return round(counts * 60 / self.counts_per_turn if self.velocity_unit is VelocityUnit.RPM else counts)

    def velocity(self, speed: int) -> float:
        """Return the signed velocity of a value in the unit of the drive."""
        counts = speed * self.counts_per_turn / 60 if self.velocity_unit is VelocityUnit.RPM else speed
        return counts / self.counts_per_unit

    def contradictions(self) -> Iterator[Mistake]:
        """Yield a mistake if the drive cannot count the range or the velocities of the axis."""
        limits = self.limits
        if limits.least >= limits.most:
            yield Mistake("least", f"{limits.least:g}", f"must be less than the most, {limits.most:g}")
        elif max(abs(self.counts(limits.least)), abs(self.counts(limits.most))) > _MOST_COUNTS:
            yield Mistake("counts_per_turn", str(self.counts_per_turn), "must leave the range within 32 bits of counts")
        elif self.speed(limits.fastest) < 1:
            rule = "must be a velocity that the drive can count: take velocity_unit = counts/s"
            yield Mistake("fastest", f"{limits.fastest:g}", rule)


@dataclass(frozen=True)
class InsertionSetup(AxisSetup, key="insertion"):
    """The axis along the needle; the table `[insertion]`."""

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
        """Limits in mm."""
        return AxisLimits(
            self.lead_mm, self.least_mm, self.most_mm, self.fastest_mm_s, self.acceleration_mm_s2, self.stop_mm_s2,
            self.margin_mm,
        )  # fmt: skip


@dataclass(frozen=True)
class RollSetup(AxisSetup, key="roll"):
    """The axis about the needle; the table `[roll]`."""

    least_rad: float = ruled(_RAD, -200.0)
    most_rad: float = ruled(_RAD, 200.0)
    fastest_rad_s: float = ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    acceleration_rad_s2: float = ruled(Number("rad/s^2", above=0, at_most=1e5), 200.0)
    stop_rad_s2: float = ruled(Number("rad/s^2", above=0, at_most=1e5), 1000.0)
    margin_rad: float = ruled(Number("rad", above=0, at_most=1), 0.05)

    @property
    def limits(self) -> AxisLimits:
        """Limits in rad."""
        return AxisLimits(
            math.tau, self.least_rad, self.most_rad, self.fastest_rad_s, self.acceleration_rad_s2, self.stop_rad_s2,
            self.margin_rad,
        )  # fmt: skip


def _two_nodes(insertion: InsertionSetup, roll: RollSetup) -> Iterator[Mistake]:
    if insertion.node == roll.node:
        yield Mistake("roll.node", str(roll.node), "must be another than insertion.node")


@dataclass(frozen=True)
class DrivesSetup(ConfigTable, error=ConfigurationError, schema="needleplan.drives/1", between=(_two_nodes,)):
    """Both axes. Raises ConfigurationError if they are one node."""

    insertion: InsertionSetup = ruled(Subtable(InsertionSetup))
    roll: RollSetup = ruled(Subtable(RollSetup))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the setup of a file. Raises ConfigurationError with every mistake."""
        return read_toml(path, cls)

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Self:
        """Return the setup of the text of a file. Raises ConfigurationError with every mistake."""
        return parse_toml(text, cls, source)
