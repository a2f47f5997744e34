"""What the tip filter says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["PoseUse", "TipEstimate", "TipStatus"]


class TipStatus(StrEnum):
    """How far an estimate may be trusted."""

    WAITING = "waiting"
    """No pose has been used yet: only what was assumed of the entry, and the stage."""

    TRACKING = "tracking"

    COASTING = "coasting"
    """The last pose that was used is older than `coasting_s`: the arc alone, with growing deviations."""

    LOST = "lost"
    """Poses contradict the estimate, or it has become too uncertain: not for control."""


class PoseUse(StrEnum):
    """What became of a pose."""

    USED = "used"
    OUTLIER = "outlier"
    """It contradicts the estimate; counted, and not used."""

    MISSING = "missing"
    SUSPECT = "suspect"
    STALE = "stale"
    """Not newer than a pose before it: a frame that was repeated, or out of order."""

    WITHDRAWN = "withdrawn"
    """The coil is behind where it was: the path there is known, and the pose says nothing new."""

    EARLY = "early"
    """There is no stage sample yet that says how deep the needle is."""


@dataclass(frozen=True)
class TipEstimate:
    """The tip in the frame of the plan, at the time of the newest stage sample; every `sd` is a standard deviation.

    x is along the insertion, y to its left, z out of the plane. `heading_rad` is the direction of the tip in the plane
    from +x to the left, `elevation_rad` its angle out of the plane, towards +z. `roll_rad` is the roll of the tip: 0
    bends to the left, pi to the right. `curvature_factor` is the curvature over that of the plan.
    """

    time_ns: int
    status: TipStatus
    x_mm: float
    y_mm: float
    z_mm: float
    heading_rad: float
    elevation_rad: float
    roll_rad: float
    curvature_per_mm: float
    curvature_factor: float
    x_sd_mm: float
    y_sd_mm: float
    z_sd_mm: float
    heading_sd_rad: float
    elevation_sd_rad: float
    roll_sd_rad: float
    curvature_sd_per_mm: float
    curvature_factor_sd: float
    depth_mm: float
    """Insertion depth of the stage."""

    pose_age_s: float
    """How old the last pose is that was used; infinite before the first one."""

    @property
    def bevel(self) -> int:
        """+1 where the bevel bends to the left, -1 to the right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def usable(self) -> bool:
        """Whether the track is neither lost nor still without a pose."""
        return self.status in (TipStatus.TRACKING, TipStatus.COASTING)
