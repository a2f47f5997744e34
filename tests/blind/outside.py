"""Hidden effects outside of any library: the honest answer is UNKNOWN, with the axis.

TUNING are those that thresholds may be tuned with. NEVER_TUNED are kept for reporting: never used while tuning.
"""

from dataclasses import dataclass

import numpy as np

from tests.blind.base import Scene
from tests.blind.effect import Effect, ForceName
from tests.blind.hidden import Axis, within
from tests.blind.motions import SECONDS, STEP_S, Array


@dataclass(frozen=True)
class SlipStep(Effect, name=ForceName.SLIP_STEP, axis=Axis.TIME, unit="N", largest=1.0, first=0.1, signed=True):
    """The needle slips in its clamp at time_s: the zero is another one from then on."""

    slip_s: float = within(0.3, 0.7, of=SECONDS)

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        return self.size * (scene.time_s[:, None] > self.slip_s) + np.zeros_like(force_n)


@dataclass(frozen=True)
class MotorRipple(Effect, name=ForceName.MOTOR_RIPPLE, axis=Axis.PERIODIC, unit="N", largest=1.0, first=0.1):
    """The spindle presses with each turn, whether the needle is in the tissue or not."""

    pitch_mm: float = within(1.5, 5.0)
    phase_rad: float = within(0, 2 * np.pi)

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del force_n
        return self.size * np.sin(2 * np.pi * scene.depth_mm / self.pitch_mm + self.phase_rad)


@dataclass(frozen=True)
class Buckling(Effect, name=ForceName.BUCKLING, axis=Axis.FORCE, unit="1", largest=0.9, first=0.2):
    """Above a force the needle bows and carries less than it is pushed with; size is the share lost above it."""

    from_n: float = within(0.4, 0.7)

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return -self.size * 0.05 * np.logaddexp(0.0, (force_n - self.from_n) / 0.05)


@dataclass(frozen=True)
class GainCurve(Effect, name=ForceName.GAIN_CURVE, axis=Axis.FORCE, unit="1/N", largest=0.6, first=0.05, signed=True):
    """The sensor's characteristic is bent: the reading errs with the square of the force."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del scene
        return self.size * force_n**2


@dataclass(frozen=True)
class EntrySpring(Effect, name=ForceName.ENTRY_SPRING, axis=Axis.DEPTH, unit="N/mm", largest=0.03, first=0.002):
    """A sleeve at the entry is stretched by the needle: it pulls back in proportion to the depth, either direction."""

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        return self.size * np.maximum(scene.tip_mm, 0.0)


@dataclass(frozen=True)
class SpeedCrosstalk(
    Effect, name=ForceName.SPEED_CROSSTALK, axis=Axis.SPEED, unit="N s/mm", largest=0.1, first=0.01, signed=True
):
    """The motor's current gets into the sensor's cable: the reading rises with the speed, whichever its direction."""

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        del force_n
        return self.size * np.abs(scene.velocity_mm_s)


@dataclass(frozen=True)
class Ageing(Effect, name=ForceName.AGEING, axis=Axis.HOLD, unit="1", largest=3.0, first=0.3):
    """The contact strengthens while it rests, and tears off over the first millimetres of the next move."""

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
class Vibration(Effect, name=ForceName.VIBRATION, axis=Axis.TIME, unit="N", largest=1.0, first=0.1):
    """A pump beside the table runs, from some moment on."""

    from_s: float = within(0.1, 0.5, of=SECONDS)
    frequency_hz: float = within(1.0, 4.0)

    def reading_n(self, scene: Scene, force_n: Array) -> Array:
        wave = np.sin(2 * np.pi * self.frequency_hz * (scene.time_s - self.from_s)) * (scene.time_s > self.from_s)
        return self.size * wave[:, None] + np.zeros_like(force_n)


TUNING = (SlipStep, MotorRipple, Buckling, GainCurve)
NEVER_TUNED = (EntrySpring, SpeedCrosstalk, Ageing, Vibration)
OUTSIDE = TUNING + NEVER_TUNED
AXES = {each.NAME: each.AXIS for each in OUTSIDE}
