"""What goes into a filter and comes out of it, one sample at a time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from needleplan.signals import Array

__all__ = ["Sample", "Step", "Use"]


@dataclass(frozen=True, slots=True)
class Sample:
    """One measurement; `value` is in the unit of the model's channel, NaN where there is none at this time.

    Without a velocity it is the difference of the depths over that of the times.
    """

    time_s: float
    depth_mm: float
    value: float
    velocity_mm_s: float | None = None
    angle_rad: float = 0.0


class Use(StrEnum):
    """What a filter did with a measurement."""

    USED = "used"
    MASKED = "masked"
    """At a reversal, where the sensor's average mixes both directions; or masked by the caller."""

    MISSING = "missing"
    """It is not a number."""

    DIVERGED = "diverged"
    """The filter has lost its estimate and does nothing any more."""


@dataclass(frozen=True, slots=True)
class Step:
    """What a filter says after one sample.

    `predicted` is what it expected before it saw the value, `innovation` the value less that (NaN where there is none),
    `sd` the standard deviation that it gave the innovation. `x` is the estimate and `x_sd` its standard deviations,
    shape (n,), in the coordinates of the joint system.
    """

    use: Use
    predicted: float
    innovation: float
    sd: float
    x: Array
    x_sd: Array
