"""Hidden effects in the sensor and in what carries it."""

from dataclasses import dataclass

import numpy as np

from tests.blind.base import Scene
from tests.blind.effect import Effect, ForceName
from tests.blind.hidden import within
from tests.blind.motions import Array


@dataclass(frozen=True)
class Bias(Effect, name=ForceName.BIAS, unit="N", largest=1.0, first=0.03, signed=True):
    """The sensor was not at zero when the trial began."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return np.full_like(force_n, self.size)


@dataclass(frozen=True)
class Drift(Effect, name=ForceName.DRIFT, unit="N/s", largest=0.05, first=0.002, signed=True):
    """The zero runs away in proportion to the time of the trial."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        return self.size * scene.time_s[:, None] + np.zeros_like(force_n)


@dataclass(frozen=True)
class ThermalDrift(Effect, name=ForceName.THERMAL_DRIFT, unit="N", largest=1.0, first=0.05, signed=True):
    """The zero runs away while the sensor warms up: fast at first, then settling."""

    settling_s: float = within(4.0, 10.0)

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        return self.size * -np.expm1(-scene.time_s[:, None] / self.settling_s) + np.zeros_like(force_n)


@dataclass(frozen=True)
class Gain(Effect, name=ForceName.GAIN, unit="1", largest=0.5, first=0.05, signed=True):
    """The sensor shows a share more than acts on it."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return self.size * force_n


@dataclass(frozen=True)
class Latency(Effect, name=ForceName.LATENCY, unit="s", largest=0.6, first=0.02, linear=False):
    """The force is stamped later than the depth."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array | float:
        if self.size == 0.0:
            return 0.0
        late = scene.time_s - self.size
        return np.stack([np.interp(late, scene.time_s, each) for each in force_n.T], axis=1) - force_n


@dataclass(frozen=True)
class Inertia(Effect, name=ForceName.INERTIA, unit="kg", largest=6.0, first=0.3):
    """The sensor also carries a mass in front of it."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del force_n
        return self.size * 1e-3 * scene.acceleration_mm_s2  # kg mm/s2 are mN
