"""Effects of the sensor and of what hangs on it: they belong to what is measured, and not to the needle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.effects.base import Memoryless, Term
from needleplan.models.effects.path import decaying
from needleplan.models.parameter import parameter
from needleplan.signals import Array, Motion

__all__ = ["Bias", "Drift", "GainError", "Inertia", "ThermalDrift"]

_N_PER_KG_MM_S2 = 1e-3
_DIFFERENCE_S = 0.005
"""Over which an acceleration is taken: shorter than the lag of a sensor, which the calibration finds for all forces."""


@dataclass(frozen=True, kw_only=True)
class Bias(Memoryless):
    """The sensor shows a force where there is none."""

    name: ClassVar[str] = "bias"
    size: float = parameter("N", -20, 20, "reading without a force", typical=0.01)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return one."""
        return np.ones_like(np.asarray(motion.depth_mm, float))


@dataclass(frozen=True, kw_only=True)
class Drift(Memoryless):
    """The zero of the sensor moves evenly, from the begin of each trial."""

    name: ClassVar[str] = "drift"
    size: float = parameter("N/s", -1, 1, "how fast the reading moves", typical=1e-3)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the time."""
        return np.asarray(motion.time_s, float)


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(Memoryless):
    """The zero of the sensor moves to another value while it warms up, from the begin of each trial."""

    name: ClassVar[str] = "thermal_drift"
    size: float = parameter("N", -20, 20, "how far the reading moves in the end", typical=0.01)
    time_s: float = parameter("s", 0.1, 1e4, "time constant of the warming")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return 1 - exp(-t/time)."""
        return -np.expm1(-np.asarray(motion.time_s, float) / self.time_s)


@dataclass(frozen=True, kw_only=True)
class GainError(Memoryless):
    """The sensor shows forces too large, or too small.

    Friction and cutting take it up wherever they are free: from forces alone it can be seen only beside a base whose
    parameters are known.
    """

    name: ClassVar[str] = "gain_error"
    size: float = parameter("", -0.9, 5, "share by which forces read too large", typical=0.01)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the force."""
        return plain


@dataclass(frozen=True, kw_only=True)
class Inertia(Term):
    """What hangs on the sensor beyond the needle is accelerated with it."""

    name: ClassVar[str] = "inertia"
    order: ClassVar[int] = 1
    size: float = parameter("kg", 0, 100, "mass that the sensor accelerates", typical=0.1)

    def initial(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return a velocity of zero."""
        return np.zeros(1)

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return how the smoothed velocity follows the velocity."""
        return np.asarray((np.asarray(motion.velocity_mm_s, float) - state) / _DIFFERENCE_S)

    def states(self, motion: Motion, start: Array) -> Array:
        """Return the velocity, smoothed over 5 ms; exact for a velocity that is linear in time."""
        step, slope = motion.interval_s, np.diff(motion.velocity_mm_s) / motion.interval_s
        decay = np.exp(-step / _DIFFERENCE_S)
        velocity = motion.velocity_mm_s
        behind = decaying(decay, -_DIFFERENCE_S * slope, float(start[0] - velocity[0]))
        return np.asarray(velocity + behind)[None]

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the acceleration, in N/kg."""
        return np.asarray(_N_PER_KG_MM_S2 * (motion.velocity_mm_s - state[0]) / _DIFFERENCE_S)
