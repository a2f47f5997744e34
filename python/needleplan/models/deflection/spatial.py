"""The path of a tip in space by the beam: what `path_law` says in a plane, for a bevel that may look anywhere.

In the law y = (2 lam/kf) [P + 2 lam int P + 2 lam^2 int int P] let k = P/(EI lam), the curvature once P is steady, and
f = 1/lam, the length over which the needle feels what is done to it. With Y'' = k it reads::

    y = Y + f Y' + (f^2/2) Y''

In space Y is the path of `steered`, with place p, tangent t and curvature (kn, kb) along n and b. The tip is at::

    p + f (t - t(0)) + (f^2/2) (kn n + kb b)

So a tip that is turned at rest goes aside at once, since its needle is bent otherwise: no experiment has tested that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.deflection.beam import Tissue
from needleplan.models.needle import Needle
from needleplan.models.parameter import constant
from needleplan.models.steered import SpatialBicycle, SteeredModel
from needleplan.signals import Array, Motion

__all__ = ["SpatialBeam"]


@dataclass(frozen=True)
class SpatialBeam(SpatialBicycle):
    """A bevel tip at the end of a beam in tissue that remembers its path; as stiff as nothing, f = 0, the bicycle.

    The force on the tip comes up behind the entry like 1 - (1 + s/e) exp(-s/e) with the depth s, as in `TipPath`.
    """

    name: ClassVar[str] = "spatial_beam"

    felt_mm: float = constant("mm", 0.0, 500.0, "f = 1/lam, over which the needle feels what is done to it", default=40)
    rise_mm: float = constant("mm", 0.01, 100.0, "e, over which the force comes up after the entry", default=5.0)

    @classmethod
    def of(cls, needle: Needle, tissue: Tissue, cutting_force_n: float) -> SpatialBeam:
        """Return the path of a needle in a tissue, with the defaults for everything else."""
        lam = tissue.decay_1_mm(needle)
        push = cutting_force_n * np.cos(needle.bevel_angle_rad)
        return cls(float(push / (needle.bending_stiffness_n_mm2 * lam)), felt_mm=1 / lam)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature toward the bevel, as it comes up."""
        reach = np.maximum(motion.depth_mm, 0.0) / self.rise_mm
        return np.asarray(super().bend_per_mm(motion, roll_rad) * (1 - (1 + reach) * np.exp(-reach)))

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:
        """Return the place of the tip, shape (3, ...)."""
        kn, kb = whole.bend_per_mm(motion, state[9])
        tangent, normal = state[3:6], state[6:9]
        lead = np.append(1.0, whole.entry(motion)[1])
        lead = (lead / np.sqrt(lead @ lead)).reshape(3, *(1,) * (state.ndim - 1))
        bent = kn * normal + kb * np.cross(tangent, normal, axis=0)
        return np.asarray(state[:3] + self.felt_mm * (tangent - lead) + self.felt_mm**2 / 2 * bent)
