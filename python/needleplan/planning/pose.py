"""Poses of the tip, what can be done there, and how an execution ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from needleplan.errors import Mistake, PoseError

__all__ = ["Action", "Outcome", "Pose", "wrapped"]


class Action(IntEnum):
    """What to do next."""

    INSERT = 0
    ROTATE = 1
    """Rotate by half a turn, then insert."""

    def __str__(self) -> str:
        return "insert" if self is Action.INSERT else "rotate, then insert"


class Outcome(IntEnum):
    """How an execution ended."""

    TARGET = 1
    COLLISION = 2
    EXIT = 3
    STEP_LIMIT = 4

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


class Pose(NamedTuple):
    """Position of the tip in mm, heading in rad from +x counter-clockwise, bevel -1 or +1 (sign of the curvature)."""

    x_mm: float
    y_mm: float
    heading_rad: float
    bevel: int

    @classmethod
    def of(cls, entries: Sequence[float]) -> Pose:
        """Make a pose of four numbers. Raises PoseError."""
        rule = "a pose is x_mm, y_mm, heading_rad and bevel (-1 or +1)"
        shown = ", ".join(str(entry) for entry in entries)
        try:
            numbers = [float(entry) for entry in entries]
        except (TypeError, ValueError):
            raise PoseError(Mistake("pose", shown, rule)) from None
        if len(numbers) != 4 or not all(math.isfinite(number) for number in numbers) or abs(numbers[3]) != 1:
            raise PoseError(Mistake("pose", shown, rule))
        return cls(numbers[0], numbers[1], numbers[2], int(numbers[3]))

    def __str__(self) -> str:
        return (
            f"x {self.x_mm:g} mm, y {self.y_mm:g} mm, heading {math.degrees(self.heading_rad):.4g} deg, "
            f"bevel {self.bevel:+d}"
        )


def wrapped(heading_rad: float) -> float:
    """Return the heading in (-pi, pi]."""
    turned = math.remainder(heading_rad, 2 * math.pi)
    return math.pi if turned == -math.pi else turned
