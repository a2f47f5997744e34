"""Hidden effects in the sensor and in what carries it."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from tests.blind.base import Scene
from tests.blind.effect import Effect, ForceName, PlainEffect
from tests.blind.motions import Array


@dataclass(frozen=True)
class Bias(PlainEffect):
    """The sensor was not at zero when the trial began."""

    NAME: ClassVar = ForceName.BIAS
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.0
    FIRST: ClassVar = 0.03
    SIGNED: ClassVar = True

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return np.full_like(force_n, self.size)


@dataclass(frozen=True)
class Drift(PlainEffect):
    """The zero runs away in proportion to the time of the trial."""

    NAME: ClassVar = ForceName.DRIFT
    UNIT: ClassVar = "N/s"
    LARGEST: ClassVar = 0.05
    FIRST: ClassVar = 0.002
    SIGNED: ClassVar = True

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        return self.size * scene.time_s[:, None] + np.zeros_like(force_n)


@dataclass(frozen=True)
class ThermalDrift(Effect):
    """The zero runs away while the sensor warms up: fast at first, then settling."""

    NAME: ClassVar = ForceName.THERMAL_DRIFT
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.0
    FIRST: ClassVar = 0.05
    SIGNED: ClassVar = True
    settling_s: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(4.0, 10.0))

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        return self.size * -np.expm1(-scene.time_s[:, None] / self.settling_s) + np.zeros_like(force_n)


@dataclass(frozen=True)
class Gain(PlainEffect):
    """The sensor shows a share more than acts on it."""

    NAME: ClassVar = ForceName.GAIN
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 0.5
    FIRST: ClassVar = 0.05
    SIGNED: ClassVar = True

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return self.size * force_n


@dataclass(frozen=True)
class Latency(PlainEffect):
    """The force is stamped later than the depth."""

    NAME: ClassVar = ForceName.LATENCY
    UNIT: ClassVar = "s"
    LARGEST: ClassVar = 0.6
    FIRST: ClassVar = 0.02
    LINEAR: ClassVar = False

    def reading_n(self, scene: Scene, force_n: Array) -> Array | float:
        if self.size == 0.0:
            return 0.0
        late = scene.time_s - self.size
        return np.stack([np.interp(late, scene.time_s, each) for each in force_n.T], axis=1) - force_n


@dataclass(frozen=True)
class Inertia(PlainEffect):
    """The sensor also carries a mass in front of it."""

    NAME: ClassVar = ForceName.INERTIA
    UNIT: ClassVar = "kg"
    LARGEST: ClassVar = 6.0
    FIRST: ClassVar = 0.3

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del force_n
        return self.size * 1e-3 * scene.acceleration_mm_s2  # kg mm/s2 are mN
