"""What two drives are connected to: encoder, gear and lead, and what they may do. A small TOML file.

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
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from needleplan.errors import ConfigurationError, Mistake
from needleplan.scenario.document import document
from needleplan.scenario.parts import Part, checked
from needleplan.scenario.rules import Choice, Integer, Number, Rule

__all__ = ["SCHEMA", "AxisLimits", "AxisSetup", "DrivesSetup", "InsertionSetup", "RollSetup", "VelocityUnit"]

SCHEMA = "needleplan.drives/1"

_MOST_COUNTS = (1 << 31) - 1
_KEYS = ("schema", "insertion", "roll")
_COUNTS = Integer(-_MOST_COUNTS, _MOST_COUNTS)
_MM, _RAD = Number("mm", at_least=-1e4, at_most=1e4), Number("rad", at_least=-1e4, at_most=1e4)


def _ruled(rule: Rule, default: object = MISSING) -> Any:
    return field(default=default, metadata={"rule": rule, "key": ""})


class VelocityUnit(StrEnum):
    """The unit in which a drive counts velocities; accelerations are per second of it."""

    RPM = "rpm"
    """Turns of the motor in a minute, as EPOS4 counts from the factory."""

    COUNTS = "counts/s"


@dataclass(frozen=True)
class AxisLimits:
    """What an axis may do, in mm or rad, and by seconds."""

    turn: float
    """How far it goes in one turn."""

    least: float
    most: float
    fastest: float
    acceleration: float
    stop: float
    """The deceleration of a quick stop."""

    margin: float
    """What is not yet a motion, a jump, or the wrong way."""


@dataclass(frozen=True)
class AxisSetup(Part, ABC):
    """One axis; abstract. Positions, velocities and accelerations are in mm or rad, by seconds."""

    node: int = _ruled(Integer(1, 126))
    counts_per_turn: int = _ruled(Integer(1, 1 << 24))
    """Of the motor, all four edges counted."""

    gear: float = _ruled(Number(above=0, at_most=1e5), 1.0)
    """Turns of the motor in a turn of the axis."""

    direction: int = _ruled(Integer(-1, 1), 1)
    """1, or -1 where counts grow as the axis goes back."""

    zero_counts: int = _ruled(_COUNTS, 0)
    """What the encoder shows where the axis is at zero."""

    velocity_unit: VelocityUnit = _ruled(Choice(VelocityUnit), VelocityUnit.RPM)

    def __post_init__(self) -> None:
        values, mistakes = checked(type(self), vars(self), self.name)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        mistakes = mistakes or self._disagreements()
        if mistakes:
            raise ConfigurationError(mistakes)

    @property
    def name(self) -> str:
        """`insertion` or `roll`."""
        return type(self).__name__.removesuffix("Setup").lower()

    @property
    @abstractmethod
    def limits(self) -> AxisLimits:
        """What the axis may do."""

    @property
    def counts_per_unit(self) -> float:
        """Counts in a mm or rad, with their sign."""
        return self.direction * self.counts_per_turn * self.gear / self.limits.turn

    def counts(self, position: float) -> int:
        """Return the count nearest to a position."""
        return self.zero_counts + round(position * self.counts_per_unit)

    def position(self, counts: int) -> float:
        """Return the position of a count."""
        return (counts - self.zero_counts) / self.counts_per_unit

    def speed(self, velocity: float) -> int:
        """Return a velocity or an acceleration without its sign in the unit of the drive."""
        counts = abs(velocity * self.counts_per_unit)
        return round(counts * 60 / self.counts_per_turn if self.velocity_unit is VelocityUnit.RPM else counts)

    def velocity(self, speed: int) -> float:
        """Return the velocity, with its sign, that a drive calls `speed`."""
        counts = speed * self.counts_per_turn / 60 if self.velocity_unit is VelocityUnit.RPM else speed
        return counts / self.counts_per_unit

    def _disagreements(self) -> list[Mistake]:
        limits = self.limits
        if self.direction == 0:
            return [Mistake(f"{self.name}.direction", "0", "must be 1 or -1")]
        if limits.least >= limits.most:
            return [Mistake(f"{self.name}.least", f"{limits.least:g}", f"must be less than the most, {limits.most:g}")]
        if max(abs(self.counts(limits.least)), abs(self.counts(limits.most))) > _MOST_COUNTS:
            rule = "must leave the range within 32 bits of counts"
            return [Mistake(f"{self.name}.counts_per_turn", str(self.counts_per_turn), rule)]
        if self.speed(limits.fastest) < 1:
            rule = "must be a velocity that the drive can count: take velocity_unit = counts/s"
            return [Mistake(f"{self.name}.fastest", f"{limits.fastest:g}", rule)]
        return []


@dataclass(frozen=True)
class InsertionSetup(AxisSetup):
    """The axis along the needle; the table `[insertion]`."""

    lead_mm: float = _ruled(Number("mm", above=0, at_most=1000), 1.0)
    """Millimetres in a turn of the spindle."""

    least_mm: float = _ruled(_MM, 0.0)
    most_mm: float = _ruled(_MM, 150.0)
    fastest_mm_s: float = _ruled(Number("mm/s", above=0, at_most=1000), 20.0)
    acceleration_mm_s2: float = _ruled(Number("mm/s^2", above=0, at_most=1e5), 200.0)
    stop_mm_s2: float = _ruled(Number("mm/s^2", above=0, at_most=1e5), 1000.0)
    margin_mm: float = _ruled(Number("mm", above=0, at_most=10), 0.2)

    @property
    def limits(self) -> AxisLimits:
        """In mm."""
        return AxisLimits(
            self.lead_mm, self.least_mm, self.most_mm, self.fastest_mm_s, self.acceleration_mm_s2, self.stop_mm_s2,
            self.margin_mm,
        )  # fmt: skip


@dataclass(frozen=True)
class RollSetup(AxisSetup):
    """The axis about the needle; the table `[roll]`."""

    least_rad: float = _ruled(_RAD, -200.0)
    most_rad: float = _ruled(_RAD, 200.0)
    fastest_rad_s: float = _ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    acceleration_rad_s2: float = _ruled(Number("rad/s^2", above=0, at_most=1e5), 200.0)
    stop_rad_s2: float = _ruled(Number("rad/s^2", above=0, at_most=1e5), 1000.0)
    margin_rad: float = _ruled(Number("rad", above=0, at_most=1), 0.05)

    @property
    def limits(self) -> AxisLimits:
        """In rad."""
        return AxisLimits(
            math.tau, self.least_rad, self.most_rad, self.fastest_rad_s, self.acceleration_rad_s2, self.stop_rad_s2,
            self.margin_rad,
        )  # fmt: skip


@dataclass(frozen=True)
class DrivesSetup:
    """Both axes. Raises ConfigurationError where they are one node."""

    insertion: InsertionSetup
    roll: RollSetup

    def __post_init__(self) -> None:
        if self.insertion.node == self.roll.node:
            raise ConfigurationError(Mistake("roll.node", str(self.roll.node), "must be another than insertion.node"))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return what a file says. Raises ConfigurationError with every mistake."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(f"cannot be read: {error.strerror}", str(path)) from error
        except ValueError as error:
            raise ConfigurationError(f"is not text in UTF-8: {error}", str(path)) from error
        return cls.from_toml(text, str(path))

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Self:
        """Return what the text of a file says. Raises ConfigurationError with every mistake."""
        given, mistakes = document(text, SCHEMA, _KEYS)
        if given is None:
            raise ConfigurationError(mistakes, source)
        tables: dict[str, Any] = {}
        for name, kind in (("insertion", InsertionSetup), ("roll", RollSetup)):
            raw = given.get(name)
            if not isinstance(raw, Mapping):
                mistakes.append(Mistake(name, "", f"is missing: a table [{name}]"))
                continue
            values, found = checked(kind, raw, name)
            mistakes += found
            try:
                if not found:
                    tables[name] = kind(**values)
            except ConfigurationError as error:
                mistakes += error.mistakes
        if mistakes:
            raise ConfigurationError(mistakes, source)
        try:
            return cls(**tables)
        except ConfigurationError as error:
            raise ConfigurationError(error.mistakes, source) from None
