"""What a hidden effect of the tip path may do: tilt the entry, twist the needle, bend the path, spoil the tracker."""

from abc import ABC
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tests.blind.curve import Course, Steered
from tests.blind.hidden import Hidden
from tests.blind.motions import Array


class PathName(StrEnum):
    """Hidden effects of the tip path; those from STAGE_WOBBLE on are outside of any library."""

    CURVATURE_LAYER = "curvature_layer"
    CURVATURE_SPEED = "curvature_speed"
    TORSIONAL_LAG = "torsional_lag"
    PRE_BEND = "pre_bend"
    ENTRY_RUPTURE = "entry_rupture"
    MISALIGNMENT = "misalignment"
    COIL_OFFSET = "coil_offset"
    TRACKER_BIAS = "tracker_bias"
    TRACKER_DISTORTION = "tracker_distortion"
    TISSUE_DRIFT = "tissue_drift"
    RESPIRATION = "respiration"
    GRAVITY = "gravity"
    STAGE_WOBBLE = "stage_wobble"
    NOTCH = "notch"
    TRACKER_JUMP = "tracker_jump"
    TURN_SLIP = "turn_slip"
    SPEED_PULL = "speed_pull"
    WAVING = "waving"


@dataclass(frozen=True)
class PathEffect(Hidden, ABC):
    """A hidden effect of the tip path."""

    def tilt_rad(self) -> Array | float:
        """Heading of the needle at the entry toward y and z (2,)."""
        return 0.0

    def tip_rad(self, base_rad: Array, depth_mm: Array) -> Array:
        """Angle of the tip about the axis (T, R)."""
        del depth_mm
        return base_rad

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array | float:
        """Curvature beside the base's toward the bevel (T, R)."""
        del steered, toward_1_mm
        return 0.0

    def bend_1_mm(self, steered: Steered) -> Array | float:
        """Curvature in the directions of the tip's frame that begin as y and z (T, R, 2)."""
        del steered
        return 0.0

    def shift_mm(self, steered: Steered, course: Course) -> Array | float:
        """What moves the tip, or what the tracker shows beside where the tip is (T, R, 3)."""
        del steered, course
        return 0.0


def side(angle_rad: Array | float) -> Array:
    """The lateral unit vector (..., 3) at an angle from +y toward +z."""
    return np.stack([np.zeros_like(angle_rad), np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


def bevel(steered: Steered, course: Course, ahead_rad: float) -> Array:
    """The direction (T, R, 3) of a mark on the tip, ahead_rad from its bevel."""
    angle = (steered.tip_rad + ahead_rad)[..., None]
    return np.cos(angle) * course.first + np.sin(angle) * course.second
