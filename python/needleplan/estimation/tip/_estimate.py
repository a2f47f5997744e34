"""Settings and results of the tip filter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from needleplan.config import ConfigTable, Integer, Number, ruled
from needleplan.errors import ModelError

__all__ = ["PoseUse", "TipEstimate", "TipSettings", "TipStatus"]


def _size(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, at_least=0, at_most=at_most), default)


def _positive(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, above=0, at_most=at_most), default)


@dataclass(frozen=True)
class TipSettings(ConfigTable, error=ModelError):
    """Standard deviations and limits of the tip filter; the defaults suit an electromagnetic tracker near its field.

    Raises ModelError with every value outside its range.
    """

    position_sd_mm: float = _positive("mm", 10, 0.3)
    """White noise of a tracked position, along each axis."""

    angle_sd_rad: float = _positive("rad", 2, 0.01)
    """White noise of a tracked direction, about each of the two axes across it."""

    wander_sd_mm: float = _size("mm", 10, 0.0)
    """Correlated drift of the tracked position, along each axis."""

    wander_s: float = _positive("s", 1e4, 1.0)
    """Correlation time of the drift: its autocorrelation is 1/e after this time."""

    heading_sd_rad_sqrt_mm: float = _size("rad/sqrt(mm)", 0.2, 0.002)
    """Random walk of the direction of the tip per root of the length of fresh path, in the plane and out of it."""

    slip_sd_mm_sqrt_mm: float = _size("mm/sqrt(mm)", 1, 0.02)
    """Random walk of the difference between path length and stage depth, per root of the length."""

    factor_sd: float = _size("", 1, 0.2)
    """Initial relative deviation of the curvature from the planned curvature."""

    factor_sd_sqrt_mm: float = _size("1/sqrt(mm)", 0.5, 0.01)
    """Random walk of the curvature factor, per root of the length."""

    roll_sd_rad: float = _size("rad", 1, 0.03)
    """Initial difference between the roll of the bevel and the roll of the base."""

    roll_sd_sqrt_rad: float = _size("rad/sqrt(rad)", 1, 0.04)
    """Random walk of that difference per root of the rotation of the base: the unknown torsional lag."""

    entry_sd_mm: float = _size("mm", 50, 0.5)
    """Error of the entry position, along each axis."""

    entry_sd_rad: float = _size("rad", 1, 0.02)
    """Error of the entry direction, in heading and elevation."""

    latency_s: float = _size("s", 1, 0.0)
    """Age of a pose when it arrives."""

    gate: float = _positive("", 1, 1e-4)
    """Probability of the squared innovation of a pose below which the pose is an outlier."""

    lost_after: int = ruled(Integer(1, 10_000), 12)
    """Excess of outliers over agreeing poses from which the status is LOST."""

    lost_sd_mm: float = _positive("mm", 1000, 3.0)
    """Standard deviation of the tip across the path above which the status is LOST."""

    coasting_s: float = _positive("s", 100, 0.25)
    """Age of the last used pose above which the status is COASTING."""


class TipStatus(StrEnum):
    """Status of the estimate."""

    WAITING = "waiting"
    """No pose has been used yet: the estimate rests on the assumed entry and on the stage."""

    TRACKING = "tracking"
    """The estimate is up to date."""

    COASTING = "coasting"
    """The last used pose is older than `coasting_s`: the arc is extrapolated, and the deviations grow."""

    LOST = "lost"
    """The poses contradict the estimate, or it is too uncertain. Do not use it for control."""


class PoseUse(StrEnum):
    """How the filter used a pose. Only a USED pose corrects the estimate."""

    USED = "used"
    OUTLIER = "outlier"
    """The pose contradicts the estimate."""

    MISSING = "missing"
    """The tracker did not see the coil, or the pose has a number that is not finite."""

    SUSPECT = "suspect"
    """The tracker reports the pose as unreliable."""

    STALE = "stale"
    """The pose is not newer than an earlier one: a repeated frame, or a frame out of order."""

    WITHDRAWN = "withdrawn"
    """The coil is behind its deepest position, where the path is already known."""

    EARLY = "early"
    """There is no stage sample yet, so the depth is unknown."""


@dataclass(frozen=True)
class TipEstimate:
    """The tip in the frame of the plan at the time of the newest stage sample; `sd` denotes standard deviations.

    x is along the insertion, y to its left, z out of the plane. `heading_rad` is the direction of the tip in the plane,
    counter-clockwise from +x, and `elevation_rad` its angle towards +z. At `roll_rad` 0 the tip bends to the left, at
    pi to the right. `curvature_factor` is the ratio of the curvature to the planned curvature.
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
    """Age of the last used pose; infinite before the first one."""

    @property
    def bevel(self) -> int:
        """+1 if the bevel bends the path to the left, -1 if to the right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def usable(self) -> bool:
        """Whether the status is TRACKING or COASTING."""
        return self.status in (TipStatus.TRACKING, TipStatus.COASTING)
