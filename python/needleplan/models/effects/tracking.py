"""Effects on where a tip is shown: of the tracker, and of tissue that moves with the whole path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.models.effects.altered import Shifted, direction_yz
from needleplan.models.parameter import parameter
from needleplan.signals import Array, Motion

__all__ = ["BreathingTarget", "CoilBehind", "CoilOffset", "DriftingTissue", "TrackerBias", "TrackerDistortion"]

_FIELD_MM = 100.0


@dataclass(frozen=True, kw_only=True)
class CoilOffset(Shifted):
    """The coil of the tracker is beside the axis of the needle, and turns with the tip."""

    size: float = parameter("mm", -20, 20, "distance of the coil from the axis", typical=0.3)
    direction_rad: float = parameter("rad", -20, 20, "direction, from the bevel", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the direction, in the frame of the tip."""
        tangent, normal, angle = state[3:6], state[6:9], state[9] + self.direction_rad
        return np.asarray(np.cos(angle) * normal + np.sin(angle) * np.cross(tangent, normal, axis=0))


@dataclass(frozen=True, kw_only=True)
class CoilBehind(Shifted):
    """The coil of the tracker is behind the tip, on the path; zeroed where the tip was at the entry."""

    size: float = parameter("mm", -30, 30, "distance of the coil behind the tip", typical=1.0)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the tangent backwards, against that along x."""
        tangent = state[3:6]
        lead = np.zeros_like(tangent)
        lead[0] = 1.0
        return np.asarray(lead - tangent)


@dataclass(frozen=True, kw_only=True)
class TrackerBias(Shifted):
    """The tracker shows all places beside where they are."""

    size: float = parameter("mm", -50, 50, "how far beside", typical=0.3)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the direction."""
        return direction_yz(self.direction_rad, motion.depth_mm)


@dataclass(frozen=True, kw_only=True)
class TrackerDistortion(Shifted):
    """The field of the tracker is bent by metal: places are shown further aside the deeper they are."""

    size: float = parameter("mm", -50, 50, "how far aside at 100 mm", typical=0.5)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:
        """Return the square of the place along x, in 100 mm, in that direction."""
        return np.asarray((state[0] / _FIELD_MM) ** 2 * direction_yz(self.direction_rad, motion.depth_mm))


@dataclass(frozen=True, kw_only=True)
class DriftingTissue(Shifted):
    """The tissue, with the needle in it, moves slowly aside from the begin of each trial."""

    size: float = parameter("mm/s", -2, 2, "how fast", typical=0.01)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the time, in that direction."""
        return np.asarray(np.asarray(motion.time_s) * direction_yz(self.direction_rad, motion.depth_mm))


@dataclass(frozen=True, kw_only=True)
class BreathingTarget(Shifted):
    """The tissue, with the needle in it, moves with the breath: there and back, and rests between."""

    size: float = parameter("mm", -40, 40, "how far it moves", typical=0.3)
    frequency_hz: float = parameter("Hz", 0.05, 2, "frequency of the breathing")
    phase_rad: float = parameter("rad", -20, 20, "phase at the begin of a trial", typical=0.3)
    direction_rad: float = parameter("rad", -20, 20, "direction, from y toward z", typical=0.3)

    def shift(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return cos(pi f t + phase / 2)^4 in that direction (Lujan et al., Med. Phys. 26 (1999) 715)."""
        wave = np.cos(np.pi * self.frequency_hz * np.asarray(motion.time_s) + self.phase_rad / 2) ** 4
        return np.asarray(wave * direction_yz(self.direction_rad, motion.depth_mm))
