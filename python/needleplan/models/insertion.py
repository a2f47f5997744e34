"""Friction along the inserted shaft and cutting at the tip: the axial force of an insertion, lumped.

::

    z' = (v - |v| z) / presliding                                       -1 <= z <= 1: Dahl's bristle
    F  = friction L z + cutting (1 - exp(-L / onset)) (1 + z)/2

L is the inserted length. The bristle knows the path only, not the speed: friction is the same at any speed, and rest
keeps the force that the last movement left. The tip resists where it is pushed in, and not on the way out:
(1 + z)/2 is exp(-x / presliding) after it was drawn back by x. Literature:
Dahl, AIAA J. 14 (1976) 1675; Okamura et al., IEEE Trans. Biomed. Eng. 51 (2004) 1707, who take apart the forces of
shaft and tip. What the tissue or the sensor does besides is an effect (`needleplan.models.effects`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from needleplan.models.base import Channel, SelfIntegratingModel
from needleplan.models.parameter import parameter
from needleplan.models.sliding import slid
from needleplan.signals import Array, Motion

__all__ = ["ShaftAndTip"]


@dataclass(frozen=True, kw_only=True)
class ShaftAndTip(SelfIntegratingModel):
    """Axial force of friction and cutting (N), positive where it resists insertion. State: the bristle, -1 to 1."""

    name: ClassVar[str] = "shaft_and_tip"
    channel: ClassVar[Channel] = Channel.FORCE

    friction: float = parameter("N/mm", 1e-6, 10, "friction per inserted length")
    cutting: float = parameter("N", 1e-5, 100, "cutting force of the tip, deep in the tissue")
    onset_mm: float = parameter("mm", 1e-2, 50, "depth over which cutting sets in")
    presliding_mm: float = parameter("mm", 1e-3, 20, "travel over which friction turns round")

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return a bristle that is not bent, shape (1,)."""
        return np.zeros(1)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rate of the bristle (1/s), shape (1, ...)."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        return np.asarray((velocity - np.abs(velocity) * state) / self.presliding_mm)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the bristle along a motion, shape (1, samples)."""
        return slid(motion, self.presliding_mm, float(start[0]))[None]

    def shaft_n(self, state: Array, motion: Motion) -> Array:
        """Return the force of the shaft (N), shape (...)."""
        return np.asarray(self.friction * np.maximum(motion.depth_mm, 0.0) * state[0])

    def tip_n(self, state: Array, motion: Motion) -> Array:
        """Return the force of the tip (N), shape (...)."""
        depth = np.asarray(motion.depth_mm, float)
        grown = _grown(depth.tobytes(), self.onset_mm) if depth.ndim == 1 else _growing(depth, self.onset_mm)
        return np.asarray(self.cutting * grown * (1 + state[0]) / 2)

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), shape (...)."""
        return self.shaft_n(state, motion) + self.tip_n(state, motion)


def _growing(depth_mm: Array, onset_mm: float) -> Array:
    return np.asarray(-np.expm1(-np.maximum(depth_mm, 0.0) / onset_mm))


@lru_cache(maxsize=32)
def _grown(depth_mm: bytes, onset_mm: float) -> Array:
    """Return it for the bytes of depths: a fit asks for the same ones with one friction or cutting after another."""
    return _growing(np.frombuffer(depth_mm), onset_mm)
