"""Forces along the needle: shaft friction, compliant tissue, cutting, and membranes.

The physics of friction and tissue is in `models`. This module simulates the forces step by step, because the depths are
not known in advance. The normal force of the friction is read from a table with a spacing of 0.01 mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from needleplan.models.friction import LuGre
from needleplan.models.tissue import LuGreLaw, bristle_step, stepping
from needleplan.signals import Motion
from needleplan.simulation._setup import SimulatedLayer

__all__ = ["DepthLaw", "ShaftForce", "TipForce"]

# spacing (mm) of the table of normal forces
_SPACING_MM = 0.01
# rate (1/s) at which the bristles relax outside of the tissue
_RELAXATION_PER_S = 1e3
# mass of the dragged tissue (N s^2/mm), so small that it has no effect
_MASS = 1e-6
# distance (mm) by which the tip compresses the tissue before it cuts
_CONTACT_MM = 0.1


class DepthLaw:
    """A friction model for single numbers instead of arrays.

    A sample number is the depth in steps of 0.01 mm, or -1 outside of the tissue.
    """

    def __init__(self, friction: LuGre, deepest_mm: float) -> None:
        depth = np.asarray((np.arange(max(math.ceil(deepest_mm / _SPACING_MM), 2)) + 0.5) * _SPACING_MM)
        one = np.ones_like(depth)
        inner = LuGreLaw(friction, Motion.sampled(depth, depth, one))
        within, force_within = inner.coefficients, inner.force
        last = depth.size - 1

        def coefficients(sample: int, w_mm_s: float) -> tuple[float, float]:
            if sample < 0:
                return 0.0, _RELAXATION_PER_S
            return within(min(sample, last), w_mm_s)

        def force(sample: int, w_mm_s: float, bending: float, bending_rate: float) -> float:
            return force_within(min(sample, last), w_mm_s, bending, bending_rate) if sample >= 0 else 0.0

        self.coefficients: Callable[[int, float], tuple[float, float]] = coefficients
        self.force: Callable[[int, float, float, float], float] = force

    @staticmethod
    def sample(depth_mm: float) -> int:
        """Return the sample number of a depth (mm)."""
        return int(depth_mm / _SPACING_MM) if depth_mm > 0 else -1


class ShaftForce:
    """Friction on the shaft (N, positive if it resists insertion), and the displacement (mm) of the dragged tissue."""

    def __init__(self, friction: LuGre | None, deepest_mm: float, compliance_mm_n: float, relaxation_s: float) -> None:
        self.force_n = 0.0
        self.tissue_mm = 0.0
        self._law = DepthLaw(friction, deepest_mm) if friction else None
        self._bent = self._velocity = 0.0
        self._sample = -1
        self._steps = None
        if self._law and compliance_mm_n:
            stiffness = 1 / compliance_mm_n
            # The needle starts at rest outside of the tissue, so the friction force is 0.
            outside = (stiffness, stiffness * relaxation_s, _MASS, 0.0, (0.0, 0.0, 0.0))
            self._steps = stepping(self._law, *outside, first=-1)
            next(self._steps)

    def step(self, interval_s: float, velocity_mm_s: float, depth_mm: float) -> None:
        """Simulate a time step, at whose end the needle has the given depth and velocity.

        The velocity is relative to tissue that is not dragged.
        """
        if self._law is None:
            return
        sample = self._law.sample(depth_mm)
        if self._steps:
            self._bent, self.tissue_mm, _, self.force_n = self._steps.send((sample, interval_s, velocity_mm_s))
            return
        forcing, rate = self._law.coefficients(self._sample, self._velocity)
        new_forcing, new_rate = self._law.coefficients(sample, velocity_mm_s)
        self._bent = bristle_step(self._bent, interval_s / 2, (forcing, new_forcing), (rate, new_rate))
        self.force_n = self._law.force(sample, velocity_mm_s, self._bent, new_forcing - new_rate * self._bent)
        self._sample, self._velocity = sample, velocity_mm_s


class TipForce:
    """Force on the tip (N): cutting force, and the force of each membrane until it is punctured.

    The tip compresses the tissue by 0.1 mm and then cuts. The force remains while the needle is at rest, and vanishes
    when the needle has been pulled back by 0.1 mm. The force of a membrane rises over the membrane's own stretch, and
    drops to 0 at the puncture.
    """

    def __init__(self, layers: Sequence[SimulatedLayer]) -> None:
        self._layers = layers
        self._front_mm = 0.0
        self._through = [False] * len(layers)

    def step(self, depth_mm: float) -> float:
        """Move the tip to a depth (mm) and return the force (N)."""
        if depth_mm <= 0:
            return 0.0
        self._front_mm = max(self._front_mm, depth_mm - _CONTACT_MM)
        pressed = min(max((depth_mm - self._front_mm) / _CONTACT_MM, 0.0), 1.0)
        force = cutting = 0.0
        for number, layer in enumerate(self._layers):
            into = depth_mm - layer.from_mm
            if into < 0:
                break
            cutting = layer.cutting_n
            if layer.puncture_n and not self._through[number]:
                self._through[number] = into >= layer.stretch_mm
                force += 0.0 if self._through[number] else layer.puncture_n * into / layer.stretch_mm
        return force + cutting * pressed

    def turn_off(self, depth_mm: float) -> None:
        """Treat the tissue beyond a depth (mm) as uncut, because the needle leaves its old channel there."""
        self._front_mm = min(self._front_mm, depth_mm)
