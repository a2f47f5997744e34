"""The path of the tip as a member of the family: simulate it along a motion, fit it to a record, filter with it.

----

The path of a tip in space by the beam: what `path_law` says in a plane, for a bevel that may look anywhere.

In the law y = (2 lam/kf) [P + 2 lam int P + 2 lam^2 int int P] let k = P/(EI lam), the curvature once P is steady, and
f = 1/lam, the length over which the needle feels what is done to it. With Y'' = k it reads::

    y = Y + f Y' + (f^2/2) Y''

In space Y is the path of `steered`, with place p, tangent t and curvature (kn, kb) along n and b. The tip is at::

    p + f (t - t(0)) + (f^2/2) (kn n + kb b)

So a tip that is turned at rest goes aside at once, since its needle is bent otherwise: no experiment has tested that.

----

The axial force of an insertion as the tip force of chapter 5 is read from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models._base import Channel, Model, SelfIntegratingModel, constant, parameter
from needleplan.models.deflection._beam import ElasticTissue, NeedleShaft
from needleplan.models.path import SpatialBicycle, SteeredModel
from needleplan.signals import Array, Motion

__all__ = ["InsertionForce", "SpatialBeam", "TipPath"]


@dataclass(frozen=True)
class TipPath(SelfIntegratingModel):
    """Lateral position of the tip (or of a point behind it) by the law of `path_law`; state x1, x2 (N mm2, N mm).

    With s the depth, m = 1 - mu, P = side Fc cos(a) cos(angle) (1 - (1 + s/e) exp(-s/e)) and e the length over which
    the force comes up after the entry::

        x1' = v x2,   x2' = v (P - 2 lam^2 m x1 - 2 lam m x2)
        y = offset + slope s + (2 lam/kf) (P + mu (2 lam x2 + 2 lam^2 x1))/g

    The law is that of a deep needle, g = 1. A needle that is barely in still feels its base; `depth_factor` g is then
    its mean radius over that of the law with the same force.

    Half a turn of the base (`angle_rad` of the motion) is a flip of the bevel. On the way out y goes back the way it
    came, as long as the base is not turned there.

    One record says about one number, the curvature Fc cos(a)/(EI lam), beside offset and slope: these three are free.
    kf, EI and mu change the same number and can be freed by name, but only a flip in the record tells kf from Fc: the
    other thing that would, the entry, is where no model holds and is better masked. Sign: y > 0 towards the push of
    the bevel where side is +1 and the base at 0.
    """

    name: ClassVar[str] = "tip_path"
    channel: ClassVar[Channel] = Channel.LATERAL

    cutting_force: float = parameter("N", 1e-5, 10.0, "Fc, force on the bevel face, normal to it")
    bending: float = parameter("N mm2", 1.0, 1e7, "EI of the needle", free=False)
    stiffness: float = parameter("N/mm2", 1e-5, 10.0, "kf of the tissue, force per length and displacement", free=False)
    bevel: float = constant("rad", 0.01, math.pi / 2, "angle between bevel face and axis")
    slope: float = parameter("rad", -0.5, 0.5, "of the insertion against the record's axis", default=0.0, typical=0.01)
    offset: float = parameter("mm", -100.0, 100.0, "lateral position of the entry", default=0.0, typical=0.1)
    anchoring: float = constant("", 0.0, 1.0, "mu, the part of the tip's path that the tissue keeps", default=1.0)
    entry: float = constant("mm", 0.01, 100.0, "e, over which the force comes up after the entry", default=5.0)
    depth_factor: float = constant("", 0.2, 5.0, "g, radius over that of a deep needle", default=1.0)
    side: float = constant("", -1.0, 1.0, "to which the bevel pushes with the base at angle 0", default=1.0)
    tracked: float = constant("mm", 0.0, 50.0, "distance of the tracked point behind the tip", default=0.0)

    @classmethod
    def of(cls, needle: NeedleShaft, stiffness_n_mm2: float, cutting_force_n: float) -> TipPath:
        """Return the path of a needle in a tissue, with the defaults for everything else."""
        return cls(cutting_force_n, needle.bending_stiffness_n_mm2, stiffness_n_mm2, needle.bevel_angle_rad)

    @property
    def decay_1_mm(self) -> float:
        """Return lam = (kf/4EI)^(1/4), 1/mm."""
        return math.sqrt(math.sqrt(self.stiffness / (4 * self.bending)))

    @property
    def curvature_1_mm(self) -> float:
        """Curvature of the path well after the entry, signed by `side`: P/(EI lam g)."""
        bend = self.bending * self.decay_1_mm * self.depth_factor
        return self.side * self.cutting_force * math.cos(self.bevel) / bend

    def push_n(self, motion: Motion) -> Array:
        """Return P, shape of the motion's fields."""
        reach = np.maximum(motion.depth_mm, 0.0) / self.entry
        risen = 1 - (1 + reach) * np.exp(-reach)
        return np.asarray(self.side * self.cutting_force * math.cos(self.bevel) * np.cos(motion.angle_rad) * risen)

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the state at the entry, shape (2,)."""
        return np.zeros(2)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of x1 and x2, shape (2, ...)."""
        lam, lost = self.decay_1_mm, 1 - self.anchoring
        force = self.push_n(motion) - 2 * lam**2 * lost * state[0] - 2 * lam * lost * state[1]
        in_tissue = np.where(np.asarray(motion.depth_mm) >= 0, motion.velocity_mm_s, 0.0)
        return np.stack([in_tissue * state[1], in_tissue * force])

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states (2, samples) by Kutta's rule; on plain numbers, which takes a tenth of the time."""
        middle, lost, lam = motion.between(0.5), 1 - self.anchoring, self.decay_1_mm
        near, far = 2 * lam**2 * lost, 2 * lam * lost
        speed, half = (np.where(each.depth_mm >= 0, each.velocity_mm_s, 0.0) for each in (motion, middle))
        ends, between = self.push_n(motion).tolist(), self.push_n(middle).tolist()
        v, vm, step = speed.tolist(), half.tolist(), motion.interval_s.tolist()
        x, y = (float(each) for each in start)
        states = [(x, y)]
        for k, h in enumerate(step):
            a1, b1 = v[k] * y, v[k] * (ends[k] - near * x - far * y)
            xm, ym = x + h / 2 * a1, y + h / 2 * b1
            a2, b2 = vm[k] * ym, vm[k] * (between[k] - near * xm - far * ym)
            xe, ye = x + h * (2 * a2 - a1), y + h * (2 * b2 - b1)
            a3, b3 = v[k + 1] * ye, v[k + 1] * (ends[k + 1] - near * xe - far * ye)
            x, y = x + h / 6 * (a1 + 4 * a2 + a3), y + h / 6 * (b1 + 4 * b2 + b3)
            states.append((x, y))
        return np.array(states).T

    def output(self, state: Array, motion: Motion) -> Array:
        """Return y of the tracked point, mm, shape (...).

        A point behind the tip is placed with the curvature of the moment, which is exact for a circle.
        """
        lam, push = self.decay_1_mm, self.push_n(motion)
        unit = 2 * lam / (self.stiffness * self.depth_factor)
        depth = np.maximum(motion.depth_mm, 0.0)
        tip = unit * (push + self.anchoring * (2 * lam * state[1] + 2 * lam**2 * state[0]))
        if self.tracked:
            curvature, behind = push / (self.bending * lam * self.depth_factor), np.minimum(self.tracked, depth)
            direction = unit * self.anchoring * (2 * lam * push + 2 * lam**2 * state[1])
            beside = np.exp(-lam * behind) * np.sin(lam * behind) / (2 * lam**2)
            tip = tip - behind * direction + curvature * (behind**2 / 2 + beside)
        return np.asarray(self.offset + self.slope * (depth - self.tracked) + tip)


@dataclass(frozen=True)
class SpatialBeam(SpatialBicycle):
    """A bevel tip at the end of a beam in tissue that remembers its path; as stiff as nothing, f = 0, the bicycle.

    The force on the tip comes up behind the entry like 1 - (1 + s/e) exp(-s/e) with the depth s, as in `TipPath`.
    """

    name: ClassVar[str] = "spatial_beam"

    felt_mm: float = constant("mm", 0.0, 500.0, "f = 1/lam, over which the needle feels what is done to it", default=40)
    rise_mm: float = constant("mm", 0.01, 100.0, "e, over which the force comes up after the entry", default=5.0)

    @classmethod
    def of(cls, needle: NeedleShaft, tissue: ElasticTissue, cutting_force_n: float) -> SpatialBeam:
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
