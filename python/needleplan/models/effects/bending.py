"""Effects that bend the path of a tip otherwise: of the tissue, of the tip and of the needle."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from needleplan.models.effects.altered import Altered
from needleplan.models.parameter import parameter
from needleplan.models.torsion import dragged
from needleplan.signals import Array, Motion

__all__ = [
    "CurvatureLayer",
    "EntryRupture",
    "Misalignment",
    "PreBend",
    "Sagging",
    "SpeedCurvature",
    "TwistedNeedle",
]

_USUAL_MM_S = 5.0
_EDGE_MM = 1.0
"""Over that length a layer begins: needed for a depth that can be fitted, too short to be seen."""


@dataclass(frozen=True, kw_only=True)
class CurvatureLayer(Altered):
    """From some depth on the path bends more, or less."""

    size: float = parameter("", -1, 5, "share by which the path bends more in the layer", typical=0.1)
    depth_mm: float = parameter("mm", 0.5, 1000, "depth at which the layer begins")

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the base, times 1 + size in the layer."""
        inside = np.clip((motion.depth_mm - self.depth_mm) / _EDGE_MM + 0.5, 0.0, 1.0)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) * (1 + self.size * inside))


@dataclass(frozen=True, kw_only=True)
class SpeedCurvature(Altered):
    """The path bends more, or less, the faster the needle goes in."""

    size: float = parameter("", -0.9, 2, "share by which the path bends more for each 5 mm/s", typical=0.05)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the base, times 1 + size (v / 5 mm/s - 1)."""
        share = np.abs(np.asarray(motion.velocity_mm_s)) / _USUAL_MM_S - 1
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) * (1 + self.size * share))


@dataclass(frozen=True, kw_only=True)
class EntryRupture(Altered):
    """Just behind the entry the path bends otherwise: the skin guides the needle, or its rupture bends it."""

    size: float = parameter("", -20, 50, "share by which the path bends more at the entry", typical=0.2)
    length_mm: float = parameter("mm", 0.2, 30, "over which that decays")

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the base, times 1 + size exp(-depth / length)."""
        share = np.exp(-np.maximum(motion.depth_mm, 0) / self.length_mm)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) * (1 + self.size * share))


@dataclass(frozen=True, kw_only=True)
class TwistedNeedle(Altered):
    """The tip is behind the base when that turns: a play that widens with the inserted length (see `torsion`)."""

    size: float = parameter("rad/mm", 0, 0.1, "lag of the tip, for each mm that is inserted", typical=1e-3)

    def following(self, roll_rad: Array, motion: Motion) -> Array:
        """Return the roll, dragged by the base."""
        lag = self.size * np.maximum(motion.depth_mm, 0.0)
        base = self.base.following(roll_rad, motion)
        return np.asarray(np.clip(roll_rad, base - lag, base + lag))

    def rolls(self, motion: Motion, start_rad: float) -> Array:
        """Return the roll, dragged from sample to sample."""
        base = self.base.rolls(motion, start_rad)
        lag = self.size * np.maximum(motion.depth_mm, 0.0)
        pairs = zip(base[1:].tolist(), lag[1:].tolist(), strict=True)
        return np.array(list(accumulate(pairs, lambda roll, each: dragged(roll, *each), initial=start_rad)))


@dataclass(frozen=True, kw_only=True)
class PreBend(Altered):
    """The needle was bent before: its path bends in a direction that turns with the base."""

    size: float = parameter("1/mm", -0.02, 0.02, "curvature of the bent needle", typical=1e-4)
    direction_rad: float = parameter("rad", -20, 20, "direction of the bend, from the bevel", typical=0.3)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the base, and that of the needle."""
        angle = np.asarray(motion.angle_rad) + self.direction_rad
        return np.asarray(
            self.base.bend_per_mm(motion, roll_rad) + self.size * np.array([np.cos(angle), np.sin(angle)])
        )


@dataclass(frozen=True, kw_only=True)
class Sagging(Altered):
    """The weight bends the path downwards, wherever the bevel looks; less, as less of the needle is outside.

    Weight has no other direction than down, along -z as in the lab twin. With one to choose it would be, but for its
    fading, what a bent field of the tracker shows.
    """

    size: float = parameter("1/mm", -0.02, 0.02, "curvature down at the entry; below 0 where z is down", typical=1e-4)
    fading_mm: float = parameter("mm", 5, 1e4, "inserted length over which it fades")

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the base, and that of the weight."""
        down = np.exp(-np.maximum(motion.depth_mm, 0.0) / self.fading_mm) + 0 * np.asarray(roll_rad, float)
        aside = np.array([0 * down, -down])
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) + self.size * aside)


@dataclass(frozen=True, kw_only=True)
class Misalignment(Altered):
    """The needle goes in along another direction than is thought."""

    size: float = parameter("rad", -0.5, 0.5, "angle between the two directions", typical=5e-3)
    direction_rad: float = parameter("rad", -20, 20, "direction to which it is tilted, from y toward z", typical=0.3)

    def entry(self, motion: Motion) -> tuple[Array, Array]:
        """Return the entry of the base, tilted."""
        place, slopes = self.base.entry(motion)
        tilt = self.size * np.array([np.cos(self.direction_rad), np.sin(self.direction_rad)])
        return place, np.asarray(slopes + tilt)
