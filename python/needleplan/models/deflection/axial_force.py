"""The axial force of an insertion as the tip force of chapter 5 is read from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.base import Channel, Model
from needleplan.models.parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["InsertionForce"]


@dataclass(frozen=True)
class InsertionForce(Model):
    """F = F0 + vf v l + Fc sin a while the needle goes in at depth l with velocity v; static, no state.

    F0 and Fc have one sum, and no insertion tells them apart: F0 is a constant of the fit once Fc is known from the
    deflection, or Fc once F0 is known. Not for the way out, where nothing is cut and Coulomb friction turns round.
    """

    name: ClassVar[str] = "insertion_force"
    channel: ClassVar[Channel] = Channel.FORCE

    offset: float = parameter("N", -10.0, 10.0, "F0: Coulomb friction, rest of the rupture, zero", typical=0.1)
    friction: float = parameter("N s/mm2", -1e-2, 1e-2, "vf, friction per length and velocity", typical=1e-4)
    cutting_force: float = parameter("N", 0.0, 10.0, "Fc, force on the bevel face", typical=0.1, free=False)
    bevel: float = constant("rad", 0.01, math.pi / 2, "angle between bevel face and axis", default=math.pi / 6)

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return no state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return nothing, shape of the state."""
        return state

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return F, N, shape (...)."""
        viscous = self.friction * motion.velocity_mm_s * motion.depth_mm
        return np.asarray(self.offset + viscous + self.cutting_force * math.sin(self.bevel))
