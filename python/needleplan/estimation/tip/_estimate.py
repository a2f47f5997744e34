"""What the tip filter says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from needleplan.config import ConfigTable, Integer, Number, ruled
from needleplan.errors import ModelError

__all__ = ["PoseUse", "TipEstimate", "TipSettings", "TipStatus"]


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


def _size(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, at_least=0, at_most=at_most), default)


def _positive(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, above=0, at_most=at_most), default)


@dataclass(frozen=True)
class TipSettings(ConfigTable, error=ModelError):
    """Standard deviations and limits of the filter; the defaults are of an electromagnetic tracker near its field.

    Raises ModelError with every value that cannot be.
    """

    position_sd_mm: float = _positive("mm", 10, 0.3)
    """Noise of a tracked position along each axis, independent from frame to frame."""

    angle_sd_rad: float = _positive("rad", 2, 0.01)
    """Noise of a tracked direction about each axis across it."""

    wander_sd_mm: float = _size("mm", 10, 0.0)
    """Error of the tracked position that changes slowly, along each axis ..."""

    wander_s: float = _positive("s", 1e4, 1.0)
    """... and the time over which it is forgotten to 1/e."""

    heading_sd_rad_sqrt_mm: float = _size("rad/sqrt(mm)", 0.2, 0.002)
    """How the direction of the tip wanders in 1 mm of fresh tissue, in the plane and out of it; grows as a root."""

    slip_sd_mm_sqrt_mm: float = _size("mm/sqrt(mm)", 1, 0.02)
    """How the length of the path and the depth of the stage part in 1 mm."""

    factor_sd: float = _size("", 1, 0.2)
    """How far the curvature is from that of the plan, as a share of it, before anything was seen."""

    factor_sd_sqrt_mm: float = _size("1/sqrt(mm)", 0.5, 0.01)
    """How that share changes in 1 mm."""

    roll_sd_rad: float = _size("rad", 1, 0.03)
    """How far the bevel looks from where the roll of the base says, before anything was seen."""

    roll_sd_sqrt_rad: float = _size("rad/sqrt(rad)", 1, 0.04)
    """How that changes when the base turns by 1 rad: the torsional lag that is not known."""

    entry_sd_mm: float = _size("mm", 50, 0.5)
    """How far from the line of entry the needle goes in, along each axis."""

    entry_sd_rad: float = _size("rad", 1, 0.02)
    """How far from its direction."""

    latency_s: float = _size("s", 1, 0.0)
    """How long before a pose arrived it was measured."""

    gate: float = _positive("", 1, 1e-4)
    """A pose is an outlier where a true one would be as far off with this probability."""

    lost_after: int = ruled(Integer(1, 10_000), 12)
    """So many outliers, less the poses that agreed in between, and the track is lost."""

    lost_sd_mm: float = _positive("mm", 1000, 3.0)
    """It is lost as well where the tip is less certain than this, across the path."""

    coasting_s: float = _positive("s", 100, 0.25)
    """Without a pose for so long, the estimate is coasting."""
