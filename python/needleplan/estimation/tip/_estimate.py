"""Settings and results of the tip filter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from needleplan.artifacts import ShortRepr
from needleplan.config import ConfigTable, Integer, Number, ruled
from needleplan.errors import ModelError

__all__ = ["PoseUse", "TipEstimate", "TipSettings", "TipStatus"]

Vector = tuple[float, float, float]


def _size(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, at_least=0, at_most=at_most), default)


def _positive(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, above=0, at_most=at_most), default)


@dataclass(frozen=True)
class TipSettings(ConfigTable, error=ModelError):
    """Standard deviations and limits of the tip filter; the defaults suit an electromagnetic tracker.

    Raises ModelError with every value outside its range.
    """

    position_sd_mm: float = _positive("mm", 10, 0.3)
    """Standard deviation of the white noise of a tracked position, along each axis."""

    angle_sd_rad: float = _positive("rad", 2, 0.01)
    """Standard deviation of the white noise of a tracked direction, about each of the two axes across the direction."""

    wander_sd_mm: float = _size("mm", 10, 0.0)
    """Standard deviation of the correlated drift of the tracked position, along each axis."""

    wander_s: float = _positive("s", 1e4, 1.0)
    """Correlation time of the drift: the time after which its autocorrelation is 1/e."""

    heading_sd_rad_sqrt_mm: float = _size("rad/sqrt(mm)", 0.2, 0.002)
    """Random walk of the direction of the tip, in the plane and out of the plane, per root of the new path length."""

    slip_sd_mm_sqrt_mm: float = _size("mm/sqrt(mm)", 1, 0.02)
    """Random walk of the difference between path length and stage depth, per root of the path length."""

    factor_sd: float = _size("", 1, 0.2)
    """Standard deviation of the initial ratio of the curvature to the planned curvature."""

    factor_sd_sqrt_mm: float = _size("1/sqrt(mm)", 0.5, 0.01)
    """Random walk of the ratio of the curvature to the planned curvature, per root of the path length."""

    change_sd_per_mm: float = _size("1/mm", 0.1, 0.002)
    """Standard deviation of the change of this ratio per length; 0: the ratio does not change except at random."""

    change_mm: float = _positive("mm", 1e4, 50.0)
    """Length of the path over which the change decays, in the mean, to 1/e."""

    roll_sd_rad: float = _size("rad", 1, 0.03)
    """Standard deviation of the initial difference between the roll of the bevel and the roll of the base."""

    roll_sd_sqrt_rad: float = _size("rad/sqrt(rad)", 1, 0.04)
    """Random walk of the same difference, per root of the rotation of the base: the unknown torsional lag."""

    entry_sd_mm: float = _size("mm", 50, 0.5)
    """Standard deviation of the entry position, along each axis."""

    entry_sd_rad: float = _size("rad", 1, 0.02)
    """Standard deviation of the entry direction, in heading and in elevation."""

    fibre_sd_per_mm: float = _size("1/mm", 0.1, 2e-4)
    """Standard deviation of the white noise of a curvature that a sensor along the needle measures."""

    fibre_bias_sd_per_mm: float = _size("1/mm", 0.1, 1e-4)
    """Standard deviation of the constant error of such a sensor, in each of its two axes."""

    latency_s: float = _size("s", 1, 0.0)
    """Age of a pose when it arrives."""

    image_sd_mm: float = _positive("mm", 20, 1.0)
    """Standard deviation of a position in an ultrasound image, along each of its axes."""

    image_latency_s: float = _size("s", 2, 0.0)
    """Age of such a position when it arrives."""

    gate: float = _positive("", 1, 1e-4)
    """Significance level of outliers: a pose is an outlier if so large an innovation is less probable than this."""

    lost_after: int = ruled(Integer(1, 10_000), 12)
    """Number of outliers from which the status is LOST. Each agreeing pose reduces the number by one, down to zero."""

    lost_sd_mm: float = _positive("mm", 1000, 3.0)
    """Standard deviation of the tip across the path, per axis, above which the status is LOST."""

    coasting_s: float = _positive("s", 100, 0.25)
    """Age of the last used pose above which the status is COASTING."""


class TipStatus(StrEnum):
    """Status of the estimate."""

    WAITING = "waiting"
    """No pose has been used yet: the estimate is computed from the assumed entry and the stage only."""

    TRACKING = "tracking"
    """The last used pose is at most `coasting_s` old."""

    COASTING = "coasting"
    """The last used pose is older than `coasting_s`: the path is extrapolated, and the standard deviations grow."""

    LOST = "lost"
    """Outliers have reached `lost_after`, or the tip is more uncertain than `lost_sd_mm`. Do not use it for control.

    If outliers were the cause, the status remains until agreeing poses have reduced the count of outliers to zero.
    """


class PoseUse(StrEnum):
    """How the filter used a pose. Only a USED pose corrects the estimate."""

    USED = "used"
    OUTLIER = "outlier"
    """The pose contradicts the estimate: the probability of its innovation is below `gate`."""

    MISSING = "missing"
    """The tracker did not see the coil, a number of the pose is not finite, or the quaternion is zero."""

    SUSPECT = "suspect"
    """The tracker reports the pose as unreliable."""

    STALE = "stale"
    """The pose is not newer than the previous pose: a repeated frame, or a frame out of order."""

    WITHDRAWN = "withdrawn"
    """The coil is behind its deepest position, in a part of the path that was measured before."""

    EARLY = "early"
    """There is no stage sample yet, so the depth is unknown."""


@dataclass(frozen=True)
class TipEstimate(ShortRepr):
    """The tip in the frame of the plan at the time of the newest stage sample.

    x is along the insertion, y lateral to the left, z out of the plane. `heading_rad` is the direction of the tip in
    the plane, counter-clockwise from +x; `elevation_rad` is the angle of the direction towards +z. At `roll_rad` 0 the
    tip bends to the left, at pi to the right. `curvature_factor` is the ratio of the curvature to the planned
    curvature, `curvature_factor_change_per_mm` its change per length. Names with `_sd` are standard deviations.
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
    """Age of the last used pose; infinite before the first used pose."""

    curvature_factor_change_per_mm: float = 0.0
    curvature_factor_change_sd_per_mm: float = 0.0

    @property
    def bevel(self) -> int:
        """Bevel side: +1 if the bevel bends the path to the left, -1 if to the right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def position_mm(self) -> Vector:
        """Position of the tip."""
        return self.x_mm, self.y_mm, self.z_mm

    @property
    def tangent(self) -> Vector:
        """Direction of the tip, a unit vector."""
        level = math.cos(self.elevation_rad)
        return level * math.cos(self.heading_rad), level * math.sin(self.heading_rad), math.sin(self.elevation_rad)

    @property
    def bend_direction(self) -> Vector:
        """Unit vector across the tangent to which the tip bends."""
        left, up = self._across()
        cos, sin = math.cos(self.roll_rad), math.sin(self.roll_rad)
        x, y, z = (cos * a + sin * b for a, b in zip(left, up, strict=True))
        return x, y, z

    def turn_towards(self, direction: Vector) -> float:
        """Return the rotation (rad, -pi to pi) of the bevel after which the tip bends towards a direction."""
        left, up = self._across()
        aside = (sum(a * b for a, b in zip(axis, direction, strict=True)) for axis in (up, left))
        return math.remainder(math.atan2(*aside) - self.roll_rad, 2 * math.pi)

    def _across(self) -> tuple[Vector, Vector]:
        """Return the unit vectors across the tangent to which the tip bends at the rolls 0 and pi/2."""
        cos_h, sin_h = math.cos(self.heading_rad), math.sin(self.heading_rad)
        cos_e, sin_e = math.cos(self.elevation_rad), math.sin(self.elevation_rad)
        return (-sin_h, cos_h, 0.0), (-sin_e * cos_h, -sin_e * sin_h, cos_e)

    @property
    def usable(self) -> bool:
        """Whether the status is TRACKING or COASTING."""
        return self.status in (TipStatus.TRACKING, TipStatus.COASTING)
