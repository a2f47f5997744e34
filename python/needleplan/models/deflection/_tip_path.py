"""Models that are based on the beam: path of the tip in the plane and in 3D, and insertion force.

`SpatialBeam` extends the law of `tip_path_mm` from the plane to a bevel in any direction. With the steady curvature k =
P/(EI lam), the length f = 1/lam over which a local load bends the needle, and Y'' = k, the law in the plane is::

    y = Y + f Y' + (f^2/2) Y''

In 3D, Y is the path of `SpatialBicycle` with position p, tangent t and curvature (kn, kb) along n and b. The tip is
at::

    p + f (t - t(0)) + (f^2/2) (kn n + kb b)

A rotation at rest therefore moves the tip sideways at once, because it changes the bending. No experiment has tested
this prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models._base import Channel, Model, SelfIntegratingModel
from needleplan.models._parameter import constant, parameter
from needleplan.models.deflection._beam import ElasticTissue, NeedleShaft
from needleplan.models.path import SpatialBicycle, SteeredModel
from needleplan.signals import Array, Motion

__all__ = ["InsertionForce", "SpatialBeam", "TipPath"]


@dataclass(frozen=True)
class TipPath(SelfIntegratingModel):
    """Lateral position of the tip, or of a tracked point behind it, by the law of `tip_path_mm`.

    The state is x1 (N mm2) and x2 (N mm). s is the depth, v the velocity, a the bevel angle, e the length over which
    the force rises after the entry, and m = 1 - mu. With P = side Fc cos(a) cos(base angle) (1 - (1 + s/e) exp(-s/e))::

        x1' = v x2,   x2' = v (P - 2 lam^2 m x1 - 2 lam m x2)
        y = offset + slope s + (2 lam/kf) (P + mu (2 lam x2 + 2 lam^2 x1))/g

    The law holds for a deep needle, g = 1. At small depths the base stiffens the needle; `depth_factor` g is the ratio
    of the mean radius to the radius of the law for the same force. Half a turn of the base is a flip of the bevel. On
    retraction without rotation, y returns along the same values. y > 0 is toward the push of the bevel, for side +1 and
    the base at 0.

    **Identifiability.** Beside offset and slope, a record determines one number, the curvature Fc cos(a)/(EI lam).
    Offset, slope and Fc are therefore free. kf, EI and mu, which change the same number, can be freed by name, but only
    a flip in the record separates kf from Fc. The entry region would separate kf from Fc too, but no model is valid
    there: mask this region.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import NeedleShaft, TipPath, simulate
    >>> from needleplan.signals import Motion
    >>> depth = np.linspace(0.0, 80.0, 801)
    >>> motion = Motion.sampled(depth / 10.0, depth)
    >>> needle = NeedleShaft(0.718, 0.413, 203.0, np.radians(24.8))
    >>> model = TipPath.of(needle, stiffness_n_mm2=3.87e-3, cutting_force_n=0.2)
    >>> print(f"{simulate(model, motion).output[-1]:.1f} mm")
    18.5 mm
    """

    name: ClassVar[str] = "tip_path"
    channel: ClassVar[Channel] = Channel.LATERAL

    cutting_force: float = parameter("N", 1e-5, 10.0, "Fc, force on the bevel face, normal to it")
    bending: float = parameter("N mm2", 1.0, 1e7, "EI of the needle", free=False)
    stiffness: float = parameter("N/mm2", 1e-5, 10.0, "kf of the tissue, force per length and displacement", free=False)
    bevel: float = constant("rad", 0.01, math.pi / 2, "angle between bevel face and axis", typical=0.5)
    slope: float = parameter(
        "rad", -0.5, 0.5, "slope of the insertion relative to the record's axis", default=0.0, typical=0.01
    )
    offset: float = parameter("mm", -100.0, 100.0, "lateral position of the entry", default=0.0, typical=0.1)
    anchoring: float = constant("", 0.0, 1.0, "mu, share of the tip's path that the tissue keeps", default=1.0)
    entry: float = constant("mm", 0.01, 100.0, "e, length over which the force rises after the entry", default=5.0)
    depth_factor: float = constant("", 0.2, 5.0, "g, ratio of the radius to that of a deep needle", default=1.0)
    side: float = constant("", -1.0, 1.0, "side to which the bevel pushes with the base at angle 0", default=1.0)
    tracked: float = constant("mm", 0.0, 50.0, "distance of the tracked point behind the tip", default=0.0)

    @classmethod
    def of(cls, needle: NeedleShaft, stiffness_n_mm2: float, cutting_force_n: float) -> TipPath:
        """Return the path of a needle in a tissue, with the defaults of the other parameters.

        Parameters
        ----------
        needle : NeedleShaft
            The needle.
        stiffness_n_mm2 : float
            Stiffness kf of the tissue.
        cutting_force_n : float
            Force Fc on the bevel face.

        Returns
        -------
        TipPath
            The model.
        """
        return cls(cutting_force_n, needle.bending_stiffness_n_mm2, stiffness_n_mm2, needle.bevel_angle_rad)

    @property
    def decay_1_mm(self) -> float:
        """Decay constant lam = (kf/4EI)^(1/4), 1/mm."""
        return math.sqrt(math.sqrt(self.stiffness / (4 * self.bending)))

    @property
    def curvature_1_mm(self) -> float:
        """Curvature P/(EI lam g) of the path far beyond the entry with the base at angle 0, signed by `side`."""
        bend = self.bending * self.decay_1_mm * self.depth_factor
        return self.side * self.cutting_force * math.cos(self.bevel) / bend

    def push_n(self, motion: Motion) -> Array:
        """Return the lateral force P on the tip (N), of the shape of the motion's fields.

        Parameters
        ----------
        motion : Motion
            The motion.

        Returns
        -------
        Array
            Lateral force on the tip.
        """
        reach = np.maximum(motion.depth_mm, 0.0) / self.entry
        risen = 1 - (1 + reach) * np.exp(-reach)
        return np.asarray(self.side * self.cutting_force * math.cos(self.bevel) * np.cos(motion.angle_rad) * risen)

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the state at the entry, x1 = x2 = 0, shape (2,)."""
        return np.zeros(2)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the time derivatives of the state x1 (N mm2/s) and x2 (N mm/s), shape (2, ...)."""
        lam, lost = self.decay_1_mm, 1 - self.anchoring
        force = self.push_n(motion) - 2 * lam**2 * lost * state[0] - 2 * lam * lost * state[1]
        in_tissue = np.where(np.asarray(motion.depth_mm) >= 0, motion.velocity_mm_s, 0.0)
        return np.stack([in_tissue * state[1], in_tissue * force])

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states, shape (2, samples), by Kutta's method in Python floats, ten times as fast as NumPy."""
        middle, lost, lam = motion.between(0.5), 1 - self.anchoring, self.decay_1_mm
        near, far = 2 * lam**2 * lost, 2 * lam * lost
        speed, half = (np.where(instant.depth_mm >= 0, instant.velocity_mm_s, 0.0) for instant in (motion, middle))
        ends, between = self.push_n(motion).tolist(), self.push_n(middle).tolist()
        v, vm, step = speed.tolist(), half.tolist(), motion.interval_s.tolist()
        x, y = (float(number) for number in start)
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
        """Return the lateral position of the tracked point, mm, shape (...).

        A point behind the tip is placed with the present curvature, which is exact for a circle.
        """
        lam, push = self.decay_1_mm, self.push_n(motion)
        unit = 2 * lam / (self.stiffness * self.depth_factor)
        depth = np.maximum(motion.depth_mm, 0.0)
        tip = unit * (push + self.anchoring * (2 * lam * state[1] + 2 * lam**2 * state[0]))
        if self.tracked:
            curvature, behind = push / (self.bending * lam * self.depth_factor), np.minimum(self.tracked, depth)
            direction = unit * self.anchoring * (2 * lam * push + 2 * lam**2 * state[1])
            offset_mm = np.exp(-lam * behind) * np.sin(lam * behind) / (2 * lam**2)
            tip = tip - behind * direction + curvature * (behind**2 / 2 + offset_mm)
        return np.asarray(self.offset + self.slope * (depth - self.tracked) + tip)


@dataclass(frozen=True)
class SpatialBeam(SpatialBicycle):
    """3D path of a bevel tip at the end of a beam, in tissue that remembers the path.

    As in `TipPath`, the force on the tip, and with it the curvature, rises with the depth s as 1 - (1 + s/e) exp(-s/e).
    For f = 0 the model is a bicycle whose curvature rises in this way.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import SpatialBeam, simulate
    >>> from needleplan.signals import Motion
    >>> depth = np.linspace(0.0, 80.0, 801)
    >>> run = simulate(SpatialBeam(curvature_per_mm=0.002), Motion.sampled(depth / 10.0, depth))
    >>> print(f"y = {run.output[1, -1]:.1f} mm")
    y = 12.1 mm
    """

    name: ClassVar[str] = "spatial_beam"

    felt_mm: float = constant(
        "mm", 0.0, 500.0, "f = 1/lam, length over which a local load bends the needle", default=40
    )
    rise_mm: float = constant("mm", 0.01, 100.0, "e, length over which the force rises after the entry", default=5.0)

    @classmethod
    def of(cls, needle: NeedleShaft, tissue: ElasticTissue, cutting_force_n: float) -> SpatialBeam:
        """Return the path of a needle in a tissue, with the defaults of the other parameters.

        Parameters
        ----------
        needle : NeedleShaft
            The needle.
        tissue : ElasticTissue
            The tissue.
        cutting_force_n : float
            Force Fc on the bevel face.

        Returns
        -------
        SpatialBeam
            The model.
        """
        needle.require_uniform("the law of the path")
        lam = tissue.decay_1_mm(needle)
        push = cutting_force_n * np.cos(needle.bevel_angle_rad)
        return cls(float(push / (needle.bending_stiffness_n_mm2 * lam)), felt_mm=1 / lam)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature (1/mm) along n and b, shape (2, ...), which rises with the depth."""
        reach = np.maximum(motion.depth_mm, 0.0) / self.rise_mm
        return np.asarray(super().bend_per_mm(motion, roll_rad) * (1 - (1 + reach) * np.exp(-reach)))

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:
        """Return the position of the tip (mm), shape (3, ...)."""
        kn, kb = whole.bend_per_mm(motion, state[9])
        tangent, normal = state[3:6], state[6:9]
        lead = np.append(1.0, whole.entry(motion)[1])
        lead = (lead / np.sqrt(lead @ lead)).reshape(3, *(1,) * (state.ndim - 1))
        bent = kn * normal + kb * np.cross(tangent, normal, axis=0)
        return np.asarray(state[:3] + self.felt_mm * (tangent - lead) + self.felt_mm**2 / 2 * bent)


@dataclass(frozen=True)
class InsertionForce(Model):
    """F = F0 + vf v l + Fc sin a: the axial force of an insertion, without state.

    The data determine the sum of F0 and Fc sin a only. Fix F0 if Fc is known from the deflection, or Fc if F0 is known.
    The model does not hold for retraction, where nothing is cut and Coulomb friction reverses.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import InsertionForce, simulate
    >>> from needleplan.signals import Motion
    >>> depth = np.linspace(0.0, 80.0, 81)
    >>> run = simulate(InsertionForce(0.1, 1e-4, 0.2), Motion.sampled(depth / 10.0, depth))
    >>> print(f"{run.output[-1]:.2f} N")
    0.28 N
    """

    name: ClassVar[str] = "insertion_force"
    channel: ClassVar[Channel] = Channel.FORCE

    offset: float = parameter(
        "N", -10.0, 10.0, "F0, offset: Coulomb friction, remainder of the rupture, zero of the sensor", typical=0.1
    )
    friction: float = parameter("N s/mm2", -1e-2, 1e-2, "vf, friction per length and velocity", typical=1e-4)
    cutting_force: float = parameter("N", 0.0, 10.0, "Fc, force on the bevel face", typical=0.1, free=False)
    bevel: float = constant("rad", 0.01, math.pi / 2, "angle between bevel face and axis", default=math.pi / 6)

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the empty state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return an empty array, because there is no state, shape (0, ...)."""
        return state

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the axial force F (N), shape (...)."""
        viscous = self.friction * motion.velocity_mm_s * motion.depth_mm
        return np.asarray(self.offset + viscous + self.cutting_force * math.sin(self.bevel))
