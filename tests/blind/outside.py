"""Hidden effects outside of any library: the honest answer is UNKNOWN, with the axis.

TUNING are those that thresholds may be tuned with. NEVER_TUNED are kept for reporting: never used while tuning.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from tests.blind.base import Scene
from tests.blind.effect import Effect, ForceName, PlainEffect
from tests.blind.hidden import Axis
from tests.blind.motions import SECONDS, STEP_S, Array


@dataclass(frozen=True)
class SlipStep(Effect):
    """The needle slips in its clamp at time_s: the zero is another one from then on."""

    NAME: ClassVar = ForceName.SLIP_STEP
    AXIS: ClassVar = Axis.TIME
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.0
    FIRST: ClassVar = 0.1
    SIGNED: ClassVar = True
    slip_s: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, SECONDS * rng.uniform(0.3, 0.7))

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        return self.size * (scene.time_s[:, None] > self.slip_s) + np.zeros_like(force_n)


@dataclass(frozen=True)
class MotorRipple(Effect):
    """The spindle presses with each turn, whether the needle is in the tissue or not."""

    NAME: ClassVar = ForceName.MOTOR_RIPPLE
    AXIS: ClassVar = Axis.PERIODIC
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.0
    FIRST: ClassVar = 0.1
    pitch_mm: float
    phase_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(1.5, 5.0), rng.uniform(0, 2 * np.pi))

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del force_n
        return self.size * np.sin(2 * np.pi * scene.depth_mm / self.pitch_mm + self.phase_rad)


@dataclass(frozen=True)
class Buckling(Effect):
    """Above a force the needle bows and carries less than it is pushed with; size is the share lost above it."""

    NAME: ClassVar = ForceName.BUCKLING
    AXIS: ClassVar = Axis.FORCE
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 0.9
    FIRST: ClassVar = 0.2
    from_n: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0.4, 0.7))

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return -self.size * 0.05 * np.logaddexp(0.0, (force_n - self.from_n) / 0.05)


@dataclass(frozen=True)
class GainCurve(PlainEffect):
    """The sensor's characteristic is bent: the reading errs with the square of the force."""

    NAME: ClassVar = ForceName.GAIN_CURVE
    AXIS: ClassVar = Axis.FORCE
    UNIT: ClassVar = "1/N"
    LARGEST: ClassVar = 0.6
    FIRST: ClassVar = 0.05
    SIGNED: ClassVar = True

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return self.size * force_n**2


@dataclass(frozen=True)
class EntrySpring(PlainEffect):
    """A sleeve at the entry is stretched by the needle: it pulls back in proportion to the depth, either direction."""

    NAME: ClassVar = ForceName.ENTRY_SPRING
    AXIS: ClassVar = Axis.DEPTH
    UNIT: ClassVar = "N/mm"
    LARGEST: ClassVar = 0.03
    FIRST: ClassVar = 0.002

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        return self.size * np.maximum(scene.tip_mm, 0.0)


@dataclass(frozen=True)
class SpeedCrosstalk(PlainEffect):
    """The motor's current gets into the sensor's cable: the reading rises with the speed, whichever its direction."""

    NAME: ClassVar = ForceName.SPEED_CROSSTALK
    AXIS: ClassVar = Axis.SPEED
    UNIT: ClassVar = "N s/mm"
    LARGEST: ClassVar = 0.1
    FIRST: ClassVar = 0.01
    SIGNED: ClassVar = True

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del force_n
        return self.size * np.abs(scene.velocity_mm_s)


@dataclass(frozen=True)
class Ageing(PlainEffect):
    """The contact strengthens while it rests, and tears off over the first millimetres of the next move."""

    NAME: ClassVar = ForceName.AGEING
    AXIS: ClassVar = Axis.HOLD
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 3.0
    FIRST: ClassVar = 0.3

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del cutting_n
        moved = np.abs(np.diff(scene.tip_mm, axis=0, prepend=scene.tip_mm[:1]))
        age = np.zeros(moved.shape[1])
        strength = np.zeros_like(moved)
        for k in range(1, len(moved)):
            still = moved[k] < 0.05 * STEP_S
            age = np.where(still, age + STEP_S, age * np.exp(-moved[k] / 1.5))
            strength[k] = np.where(still, 0.0, np.log1p(age))
        return self.size * strength * friction_n


@dataclass(frozen=True)
class Vibration(Effect):
    """A pump beside the table runs, from some moment on."""

    NAME: ClassVar = ForceName.VIBRATION
    AXIS: ClassVar = Axis.TIME
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.0
    FIRST: ClassVar = 0.1
    from_s: float
    frequency_hz: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, SECONDS * rng.uniform(0.1, 0.5), rng.uniform(1.0, 4.0))

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        wave = np.sin(2 * np.pi * self.frequency_hz * (scene.time_s - self.from_s)) * (scene.time_s > self.from_s)
        return self.size * wave[:, None] + np.zeros_like(force_n)


TUNING = (SlipStep, MotorRipple, Buckling, GainCurve)
NEVER_TUNED = (EntrySpring, SpeedCrosstalk, Ageing, Vibration)
OUTSIDE = TUNING + NEVER_TUNED
AXES = {each.NAME: each.AXIS for each in OUTSIDE}
