"""What the tip filter assumes of needle, tissue, tracker and entry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from needleplan.config import ConfigTable, Integer, Number, ruled
from needleplan.errors import ModelError

__all__ = ["TipSettings"]


def _size(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, at_least=0, at_most=at_most), default)


def _positive(unit: str, at_most: float, default: float) -> Any:
    return ruled(Number(unit, above=0, at_most=at_most), default)


@dataclass(frozen=True)
class TipSettings(ConfigTable, key="tip filter", error=ModelError):
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
