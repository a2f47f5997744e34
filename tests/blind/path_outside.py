"""Hidden effects of the tip path outside of any library. NEVER_TUNED_PATH: never used while tuning."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from tests.blind.curve import Course, Steered
from tests.blind.hidden import Axis
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, side
from tests.blind.steering import SECONDS


@dataclass(frozen=True)
class StageWobble(PathEffect):
    """The spindle of the stage is bent: the needle is carried sideways and back with each turn."""

    NAME: ClassVar = PathName.STAGE_WOBBLE
    AXIS: ClassVar = Axis.PERIODIC
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 3.0
    FIRST: ClassVar = 0.2
    toward_rad: float
    pitch_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi), rng.uniform(5.0, 12.0))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del course
        return self.size * np.sin(2 * np.pi * steered.depth_mm / self.pitch_mm)[..., None] * side(self.toward_rad)


@dataclass(frozen=True)
class Notch(PathEffect):
    """Something hard at depth_mm turns the tip aside by size, the same way whatever its bevel."""

    NAME: ClassVar = PathName.NOTCH
    AXIS: ClassVar = Axis.DEPTH
    UNIT: ClassVar = "rad"
    LARGEST: ClassVar = 0.3
    FIRST: ClassVar = 0.02
    LINEAR: ClassVar = False
    toward_rad: float
    depth_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        return cls(0.0, rng.uniform(0, 2 * np.pi), reach_mm * rng.uniform(0.3, 0.6))

    def bend_1_mm(self, steered: Steered) -> Array:
        around = np.exp(-0.5 * ((steered.depth_mm - self.depth_mm) / 0.6) ** 2) / (0.6 * np.sqrt(2 * np.pi))
        return self.size * around[..., None] * side(self.toward_rad)[1:]


@dataclass(frozen=True)
class TrackerJump(PathEffect):
    """Somebody bumps into the tracker's field generator."""

    NAME: ClassVar = PathName.TRACKER_JUMP
    AXIS: ClassVar = Axis.TIME
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 5.0
    FIRST: ClassVar = 0.2
    toward_rad: float
    bump_s: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi), SECONDS * rng.uniform(0.2, 0.7))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        after = (steered.time_s > self.bump_s)[:, None, None]
        return self.size * after * side(self.toward_rad) + np.zeros_like(course.position_mm)


@dataclass(frozen=True)
class TurnSlip(PathEffect):
    """A turn drills: the tip slips sideways by size for half a turn, and stays there."""

    NAME: ClassVar = PathName.TURN_SLIP
    AXIS: ClassVar = Axis.ROTATION
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 3.0
    FIRST: ClassVar = 0.2
    toward_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del course
        turned = np.cumsum(np.abs(np.diff(steered.base_rad, axis=0, prepend=steered.base_rad[:1])), axis=0)
        return self.size * (turned / np.pi)[..., None] * side(self.toward_rad)


@dataclass(frozen=True)
class SpeedPull(PathEffect):
    """The motor's field pulls at the tracker: the reading is aside by size at 5 mm/s."""

    NAME: ClassVar = PathName.SPEED_PULL
    AXIS: ClassVar = Axis.SPEED
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 3.0
    FIRST: ClassVar = 0.2
    toward_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del course
        return self.size * (steered.velocity_mm_s / 5.0)[..., None] * side(self.toward_rad)


@dataclass(frozen=True)
class Waving(PathEffect):
    """Fibres lead the tip to and fro along the path, whatever its bevel."""

    NAME: ClassVar = PathName.WAVING
    AXIS: ClassVar = Axis.DEPTH
    UNIT: ClassVar = "1/mm"
    LARGEST: ClassVar = 0.02
    FIRST: ClassVar = 1e-3
    LINEAR: ClassVar = False
    toward_rad: float
    length_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi), rng.uniform(20.0, 35.0))

    def bend_1_mm(self, steered: Steered) -> Array:
        wave = np.cos(2 * np.pi * steered.depth_mm / self.length_mm)  # so the heading waves about the axis
        return self.size * wave[..., None] * side(self.toward_rad)[1:]


TUNING_PATH = (StageWobble, Notch, TrackerJump)
NEVER_TUNED_PATH = (TurnSlip, SpeedPull, Waving)
OUTSIDE_PATH = TUNING_PATH + NEVER_TUNED_PATH
