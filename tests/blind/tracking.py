"""Hidden effects in the tracker and its coil."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from tests.blind.curve import Course, Steered
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, bevel, side


@dataclass(frozen=True)
class CoilOffset(PathEffect):
    """The coil sits beside the axis, fixed in the needle: it turns with the tip."""

    NAME: ClassVar = PathName.COIL_OFFSET
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 5.0
    FIRST: ClassVar = 0.2
    ahead_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        return self.size * bevel(steered, course, self.ahead_rad)


@dataclass(frozen=True)
class TrackerBias(PathEffect):
    """The tracker's origin is beside the entry."""

    NAME: ClassVar = PathName.TRACKER_BIAS
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 5.0
    FIRST: ClassVar = 0.2
    toward_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del steered
        return self.size * side(self.toward_rad) + np.zeros_like(course.position_mm)


@dataclass(frozen=True)
class TrackerDistortion(PathEffect):
    """Metal bends the tracker's field: its error grows with the square of the depth, to size at 80 mm."""

    NAME: ClassVar = PathName.TRACKER_DISTORTION
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 5.0
    FIRST: ClassVar = 0.2
    toward_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del steered
        away = (course.position_mm[..., :1] / 80.0) ** 2
        return self.size * away * side(self.toward_rad)
