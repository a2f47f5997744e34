"""One identified needle-tissue combination, and the force that it predicts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from needleplan.errors import Mistake, ModelError
from needleplan.models import simulate
from needleplan.models.force import DepthForce
from needleplan.signals import Array, Motion

__all__ = ["Combination", "Prediction"]

_SPEED_TOLERANCE = 0.1


@dataclass(frozen=True)
class Prediction:
    """The axial force along a motion without a force sensor; arrays have the shape (samples,).

    `outside` marks the samples that the identification did not cover: deeper than it went, or faster than its speed.
    """

    motion: Motion
    force_n: Array
    outside: NDArray[np.bool_]


@dataclass(frozen=True)
class Combination:
    """A needle in a tissue at a speed, with the model that was identified.

    `depth_mm` is how deep the identification went, `intervals` the 95 % intervals of free parameters as far as they are
    known, `mae_n` the mean absolute error of the open loop on the data (N) or None, `source` says where it comes from,
    and `digests` name the data files. The parameters hold for the speed at which they were identified: the model
    has no velocity in it.
    """

    needle: str
    tissue: str
    velocity_mm_s: float
    depth_mm: float
    model: DepthForce
    source: str
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    mae_n: float | None = None
    digests: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        mistakes = [
            Mistake(name, f'"{getattr(self, name)}"', "must not be empty")
            for name in ("needle", "tissue", "source")
            if not getattr(self, name).strip()
        ]
        for name in ("velocity_mm_s", "depth_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                mistakes.append(Mistake(name, f"{value:g}", "must be a positive number"))
        if self.mae_n is not None and not (math.isfinite(self.mae_n) and self.mae_n >= 0):
            mistakes.append(Mistake("mae_n", f"{self.mae_n:g}", "must be a number in N of at least 0"))
        if not self.model.proper:
            rule = "f1 and f1 + f2 must be positive, or the force grows without bound"
            mistakes.append(Mistake("parameters.f1", f"{self.model.f1:g}", rule))
        values = self.model.values()
        for name, (low, high) in self.intervals.items():
            if name not in values:
                rule = f"is not a parameter of {self.model.name}; those are {', '.join(values)}"
                mistakes.append(Mistake(f"intervals.{name}", "", rule))
            elif not low <= values[name] <= high:
                rule = f"must be [low, high] around the value, {values[name]:g}"
                mistakes.append(Mistake(f"intervals.{name}", f"[{low:g}, {high:g}]", rule))
        if mistakes:
            raise ModelError(mistakes, self.title)

    @property
    def title(self) -> str:
        """Short name, such as `A in B at 10 mm/s`."""
        return f"{self.needle} in {self.tissue} at {self.velocity_mm_s:g} mm/s"

    def predict(self, motion: Motion) -> Prediction:
        """Return the force along `motion`, which begins at the surface with an undisturbed tissue."""
        fast = np.abs(motion.velocity_mm_s) > (1 + _SPEED_TOLERANCE) * self.velocity_mm_s
        deep = motion.depth_mm > self.depth_mm * (1 + 1e-9)
        return Prediction(motion, simulate(self.model, motion).output, np.asarray(fast | deep))
