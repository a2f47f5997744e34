"""Hidden effects in the tracker and its coil."""

from dataclasses import dataclass

import numpy as np

from tests.blind.curve import Course, Steered
from tests.blind.hidden import within
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, bevel, side


@dataclass(frozen=True)
class CoilOffset(PathEffect, name=PathName.COIL_OFFSET, unit="mm", largest=5.0, first=0.2):
    """The coil sits beside the axis, fixed in the needle: it turns with the tip."""

    ahead_rad: float = within(0, 2 * np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        return self.size * bevel(steered, course, self.ahead_rad)


@dataclass(frozen=True)
class TrackerBias(PathEffect, name=PathName.TRACKER_BIAS, unit="mm", largest=5.0, first=0.2):
    """The tracker's origin is beside the entry."""

    toward_rad: float = within(0, 2 * np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del steered
        return self.size * side(self.toward_rad) + np.zeros_like(course.position_mm)


@dataclass(frozen=True)
class TrackerDistortion(PathEffect, name=PathName.TRACKER_DISTORTION, unit="mm", largest=5.0, first=0.2):
    """Metal bends the tracker's field: its error grows with the square of the depth, to size at 80 mm."""

    toward_rad: float = within(0, 2 * np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del steered
        away = (course.position_mm[..., :1] / 80.0) ** 2
        return self.size * away * side(self.toward_rad)
