"""Hidden effects of the tip path outside of any library. NEVER_TUNED_PATH: never used while tuning."""

from dataclasses import dataclass

import numpy as np

from tests.blind.curve import Course, Steered
from tests.blind.hidden import REACH, Axis, within
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, side
from tests.blind.steering import SECONDS


@dataclass(frozen=True)
class StageWobble(PathEffect, name=PathName.STAGE_WOBBLE, axis=Axis.PERIODIC, unit="mm", largest=3.0, first=0.2):
    """The spindle of the stage is bent: the needle is carried sideways and back with each turn."""

    toward_rad: float = within(0, 2 * np.pi)
    pitch_mm: float = within(5.0, 12.0)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del course
        return self.size * np.sin(2 * np.pi * steered.depth_mm / self.pitch_mm)[..., None] * side(self.toward_rad)


@dataclass(frozen=True)
class Notch(PathEffect, name=PathName.NOTCH, axis=Axis.DEPTH, unit="rad", largest=0.3, first=0.02, linear=False):
    """Something hard at depth_mm turns the tip aside by size, the same way whatever its bevel."""

    toward_rad: float = within(0, 2 * np.pi)
    depth_mm: float = within(0.3, 0.6, of=REACH)

    def bend_1_mm(self, steered: Steered) -> Array:
        around = np.exp(-0.5 * ((steered.depth_mm - self.depth_mm) / 0.6) ** 2) / (0.6 * np.sqrt(2 * np.pi))
        return self.size * around[..., None] * side(self.toward_rad)[1:]


@dataclass(frozen=True)
class TrackerJump(PathEffect, name=PathName.TRACKER_JUMP, axis=Axis.TIME, unit="mm", largest=5.0, first=0.2):
    """Somebody bumps into the tracker's field generator."""

    toward_rad: float = within(0, 2 * np.pi)
    bump_s: float = within(0.2, 0.7, of=SECONDS)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        after = (steered.time_s > self.bump_s)[:, None, None]
        return self.size * after * side(self.toward_rad) + np.zeros_like(course.position_mm)


@dataclass(frozen=True)
class TurnSlip(PathEffect, name=PathName.TURN_SLIP, axis=Axis.ROTATION, unit="mm", largest=3.0, first=0.2):
    """A turn drills: the tip slips sideways by size for half a turn, and stays there."""

    toward_rad: float = within(0, 2 * np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del course
        turned = np.cumsum(np.abs(np.diff(steered.base_rad, axis=0, prepend=steered.base_rad[:1])), axis=0)
        return self.size * (turned / np.pi)[..., None] * side(self.toward_rad)


@dataclass(frozen=True)
class SpeedPull(PathEffect, name=PathName.SPEED_PULL, axis=Axis.SPEED, unit="mm", largest=3.0, first=0.2):
    """The motor's field pulls at the tracker: the reading is aside by size at 5 mm/s."""

    toward_rad: float = within(0, 2 * np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        del course
        return self.size * (steered.velocity_mm_s / 5.0)[..., None] * side(self.toward_rad)


@dataclass(frozen=True)
class Waving(PathEffect, name=PathName.WAVING, axis=Axis.DEPTH, unit="1/mm", largest=0.02, first=1e-3, linear=False):
    """Fibres lead the tip to and fro along the path, whatever its bevel."""

    toward_rad: float = within(0, 2 * np.pi)
    length_mm: float = within(20.0, 35.0)

    def bend_1_mm(self, steered: Steered) -> Array:
        wave = np.cos(2 * np.pi * steered.depth_mm / self.length_mm)  # so the heading waves about the axis
        return self.size * wave[..., None] * side(self.toward_rad)[1:]


TUNING_PATH = (StageWobble, Notch, TrackerJump)
NEVER_TUNED_PATH = (TurnSlip, SpeedPull, Waving)
OUTSIDE_PATH = TUNING_PATH + NEVER_TUNED_PATH
