"""Effects of the path of a tip. Each effect is a model that wraps another model and changes one of its properties.

`Altered` effects change the curvature, the entry or the roll. `Shifted` effects change the position, because of the
tracker, or because the tissue moves together with the whole path.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from needleplan.models._parameter import parameter
from needleplan.models.effects._laws import bent_needle, breathing, speed_factor, weight_curvature
from needleplan.models.path import SteeredModel, dragged
from needleplan.signals import Array, Motion

__all__ = [
    "Altered",
    "BreathingTarget",
    "CoilBehind",
    "CoilOffset",
    "CurvatureLayer",
    "DriftingTissue",
    "EntryRupture",
    "Misalignment",
    "PreBend",
    "Sagging",
    "Shifted",
    "SpeedCurvature",
    "TrackerBias",
    "TrackerDistortion",
    "TwistedNeedle",
    "direction_yz",
]


@dataclass(frozen=True, kw_only=True)
class Altered(SteeredModel):
    """Abstract base class of a model that wraps another model.

    Each property is that of the wrapped model unless a subclass overrides it.
    """

    base: SteeredModel
    size: float = parameter("", -1e9, 1e9, "amplitude", typical=1.0)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) of the base model, shape (2, ...)."""
        return self.base.bend_per_mm(motion, roll_rad)

    def entry(self, motion: Motion) -> tuple[Array, Array]:
        """Return the entry point (mm) and the slopes at the entry (rad) of the base model."""
        return self.base.entry(motion)

    def following(self, roll_rad: Array, motion: Motion) -> Array:
        """Return `following` of the base model: the roll (rad) that the rear end of the needle imposes on the tip."""
        return self.base.following(roll_rad, motion)

    def rolls(self, motion: Motion, start_rad: float) -> Array:
        """Return the roll (rad) of the tip in the base model at every sample, shape (samples,)."""
        return self.base.rolls(motion, start_rad)

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:
        """Return the position (mm) of the tip in the base model, shape (3, ...)."""
        return self.base.shown(state, motion, whole)


@dataclass(frozen=True, kw_only=True)
class Shifted(Altered):
    """Abstract base class of effects that shift the tip or its measured position."""

    @abstractmethod
    def shift(self, state: Array, motion: Motion) -> Array:
        """Return the shift for amplitude 1, shape (3, ...)."""

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:
        """Return the position of the tip in the base model plus the shift (mm), shape (3, ...)."""
        return np.asarray(self.base.shown(state, motion, whole) + self.size * self.shift(state, motion))


def direction_yz(angle_rad: float, like: Array) -> Array:
    """Return the unit vector perpendicular to x at `angle_rad` from y toward z, repeated for the shape of `like`.

    The result has the shape (3, ...) if `like` has the shape (...).
    """
    one = np.ones_like(np.asarray(like, float))
    return np.array([0 * one, np.cos(angle_rad) * one, np.sin(angle_rad) * one])


# Length of the transition into a layer, mm; it makes the output a smooth function of the depth of the layer.
_EDGE_MM = 1.0


@dataclass(frozen=True, kw_only=True)
class CurvatureLayer(Altered):
    """A deeper layer of tissue in which the curvature of the path is larger or smaller."""

    size: float = parameter("", -1, 5, "relative change of the curvature in the layer", typical=0.1)
    depth_mm: float = parameter("mm", 0.5, 1000, "depth at which the layer begins")

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) of the base model, in the layer times 1 + size."""
        inside = np.clip((motion.depth_mm - self.depth_mm) / _EDGE_MM + 0.5, 0.0, 1.0)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) * (1 + self.size * inside))


@dataclass(frozen=True, kw_only=True)
class SpeedCurvature(Altered):
    """A curvature that depends on the speed of the insertion."""

    size: float = parameter("", -1, 2, "relative change of the curvature for each 5 mm/s", typical=0.05)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) of the base model times 1 + size (|v| / 5 mm/s - 1)."""
        factor = speed_factor(np.abs(np.asarray(motion.velocity_mm_s)), self.size)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) * factor)


@dataclass(frozen=True, kw_only=True)
class EntryRupture(Altered):
    """A different curvature just behind the entry, because the skin guides the needle or ruptures."""

    size: float = parameter("", -20, 50, "relative change of the curvature at the entry", typical=0.2)
    length_mm: float = parameter("mm", 0.2, 30, "length over which the change decays")

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) of the base model times 1 + size exp(-depth / length)."""
        share = np.exp(-np.maximum(motion.depth_mm, 0) / self.length_mm)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) * (1 + self.size * share))


@dataclass(frozen=True, kw_only=True)
class TwistedNeedle(Altered):
    """A rotational backlash between rear end and tip that grows with the inserted length (see `Torsion`)."""

    size: float = parameter("rad/mm", 0, 0.1, "lag of the tip per inserted length", typical=1e-3)

    def following(self, roll_rad: Array, motion: Motion) -> Array:
        """Return `roll_rad`, clipped to the backlash on both sides of the roll that the base model gives."""
        lag = self.size * np.maximum(motion.depth_mm, 0.0)
        base = self.base.following(roll_rad, motion)
        return np.asarray(np.clip(roll_rad, base - lag, base + lag))

    def rolls(self, motion: Motion, start_rad: float) -> Array:
        """Return the roll (rad) of the tip at every sample, shape (samples,), from `start_rad` at the first sample."""
        base = self.base.rolls(motion, start_rad)
        lag = self.size * np.maximum(motion.depth_mm, 0.0)
        pairs = zip(base[1:].tolist(), lag[1:].tolist(), strict=True)
        return np.array(list(accumulate(pairs, lambda roll, pair: dragged(roll, *pair), initial=start_rad)))


@dataclass(frozen=True, kw_only=True)
class PreBend(Altered):
    """A needle that was bent before the insertion: the additional curvature rotates with the tip."""

    size: float = parameter("1/mm", -0.1, 0.1, "curvature of the bent needle", typical=1e-4)
    direction_rad: float = parameter("rad", -20, 20, "direction of the bend, from the bevel", typical=0.3)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) of the base model plus the curvature of the bent needle, shape (2, ...)."""
        bent = bent_needle(np.asarray(roll_rad, float), self.size, self.direction_rad)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) + np.array(bent))


@dataclass(frozen=True, kw_only=True)
class Sagging(Altered):
    """A downward curvature caused by the weight of the needle; it decreases as the needle is inserted.

    The weight acts along -z, as in the lab twin. If the direction were a parameter, the effect would resemble a
    distorted tracker field, except for the decay with depth.
    """

    size: float = parameter(
        "1/mm", -0.1, 0.1, "downward curvature at the entry; negative if z points down", typical=1e-4
    )
    fading_mm: float = parameter("mm", 5, 1e4, "inserted length over which the curvature decays")

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) of the base model plus the curvature caused by the weight, shape (2, ...)."""
        down = weight_curvature(motion.depth_mm, self.size, self.fading_mm) + 0 * np.asarray(roll_rad, float)
        return np.asarray(self.base.bend_per_mm(motion, roll_rad) + np.array([0 * down, -down]))


@dataclass(frozen=True, kw_only=True)
class Misalignment(Altered):
    """An insertion direction that differs from the assumed one."""

    size: float = parameter("rad", -0.5, 0.5, "angle between the two directions", typical=5e-3)
    direction_rad: float = parameter("rad", -20, 20, "direction of the tilt, from y toward z", typical=0.3)

    def entry(self, motion: Motion) -> tuple[Array, Array]:
        """Return the entry point of the base model, and its slopes plus the tilt."""
        place, slopes = self.base.entry(motion)
        tilt = self.size * np.array([np.cos(self.direction_rad), np.sin(self.direction_rad)])
        return place, np.asarray(slopes + tilt)


# Distance along x at which the error of `TrackerDistortion` equals its amplitude, mm.
_FIELD_MM = 100.0


@dataclass(frozen=True, kw_only=True)
class CoilOffset(Shifted):
    """A tracker coil beside the axis of the needle, which rotates with the tip."""

    size: float = parameter("mm", -20, 20, "distance of the coil from the axis", typical=0.3)
    direction_rad: float = parameter("rad", -20, 20, "direction of the coil, from the bevel", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the unit vector from the axis toward the coil, shape (3, ...)."""
        tangent, normal, angle = state[3:6], state[6:9], state[9] + self.direction_rad
        return np.asarray(np.cos(angle) * normal + np.sin(angle) * np.cross(tangent, normal, axis=0))


@dataclass(frozen=True, kw_only=True)
class CoilBehind(Shifted):
    """A tracker coil on the path behind the tip; the tracker was set to zero while the tip was at the entry."""

    size: float = parameter("mm", -30, 30, "distance of the coil behind the tip", typical=1.0)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the unit vector along x minus the tangent of the path, shape (3, ...)."""
        tangent = state[3:6]
        lead = np.zeros_like(tangent)
        lead[0] = 1.0
        return np.asarray(lead - tangent)


@dataclass(frozen=True, kw_only=True)
class TrackerBias(Shifted):
    """A constant offset of the tracker."""

    size: float = parameter("mm", -50, 50, "offset", typical=0.3)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the unit vector of the offset, shape (3, ...)."""
        return direction_yz(self.direction_rad, motion.depth_mm)


@dataclass(frozen=True, kw_only=True)
class TrackerDistortion(Shifted):
    """A tracker field that metal distorts: the lateral error grows with the square of the distance along x."""

    size: float = parameter("mm", -50, 50, "lateral error at 100 mm", typical=0.5)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:
        """Return (x / 100 mm)^2 times the unit vector of the distortion, shape (3, ...)."""
        return np.asarray((state[0] / _FIELD_MM) ** 2 * direction_yz(self.direction_rad, motion.depth_mm))


@dataclass(frozen=True, kw_only=True)
class DriftingTissue(Shifted):
    """Tissue that drifts sideways together with the needle, from the time 0 of each trial."""

    size: float = parameter("mm/s", -2, 2, "speed of the drift", typical=0.01)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the time (s) times the unit vector of the drift, shape (3, ...)."""
        return np.asarray(np.asarray(motion.time_s) * direction_yz(self.direction_rad, motion.depth_mm))


@dataclass(frozen=True, kw_only=True)
class BreathingTarget(Shifted):
    """Breathing tissue that moves sideways together with the needle, and dwells between breaths."""

    size: float = parameter("mm", -60, 60, "displacement from one end to the other", typical=0.3)
    frequency_hz: float = parameter("Hz", 0.05, 2, "frequency of the breathing")
    phase_rad: float = parameter("rad", -20, 20, "phase at the beginning of a trial", typical=0.3)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return `breathing` with a dwell, cos(pi f t + phase / 2)^4, times the unit vector, shape (3, ...)."""
        phase = self.phase_rad + np.pi / 2
        wave, _ = breathing(np.asarray(motion.time_s, float), self.frequency_hz, phase, rest=1.0)
        return np.asarray(wave * direction_yz(self.direction_rad, motion.depth_mm))
