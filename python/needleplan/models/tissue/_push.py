"""Displacement of a target by the push of the needle, in an infinite incompressible elastic medium.

The tip pushes with the force F_t like a rigid sphere of the radius a, bonded to a medium with the shear modulus G. The
axial displacement at the distance r from the tip, with c the cosine of the angle to the needle's direction, is
equation (4) of docs/explanation/mechanics.md ::

    u = U [ (3a / 4r) (1 + c^2) + (a^3 / 4r^3) (1 - 3 c^2) ],   U = F_t / (6 pi G a),   u = U for r < a

This is Stokes' solution for the slow flow around a sphere; the equations of an incompressible elastic solid at rest are
the same, with displacement for velocity and G for viscosity. Far away it is Kelvin's solution for a point force,
u = F_t (1 + c^2) / (8 pi G r).

The friction F_s is spread evenly over the inserted length L behind the tip. Kelvin's solution, integrated along the
straight shaft, gives for a target that is z ahead of the tip and rho beside the axis equation (5) ::

    u = F_s / (8 pi G L) [ 2 asinh(s / rho) - s / sqrt(s^2 + rho^2) ] from s = z to s = z + L

with rho at least a. Only the displacement along the needle is returned; on the axis there is no other.

Sources: Stokes' sphere and Kelvin's point force, as in textbooks of fluid mechanics and of elasticity. Assumptions: the
boundaries of the organ are far away, the tissue is linear and uniform, and cutting does not relieve it. Near the tip,
where tissue tears, the displacement is too large; near a free surface, or if the organ moves as a whole, too small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from needleplan.errors import Mistake, ModelError

__all__ = ["NeedlePush"]


@dataclass(frozen=True)
class NeedlePush:
    """Elastic tissue around a needle, whose push displaces a target.

    The constructor raises ModelError unless both numbers are positive and finite.

    Parameters
    ----------
    shear_modulus_n_mm2 : float
        Shear modulus G of the tissue, a third of Young's modulus; 1 kPa is 0.001 N/mm2.
    radius_mm : float
        Outer radius a of the needle.

    Examples
    --------
    >>> from needleplan.models.tissue import NeedlePush
    >>> push = NeedlePush(shear_modulus_n_mm2=0.01, radius_mm=0.635)
    >>> print(f"{push.at_tip_mm(0.3):.2f} mm, {push.shift_mm(0.3, 0.0, 0.0, ahead_mm=10.0, aside_mm=0.0):.2f} mm")
    2.51 mm, 0.24 mm
    """

    shear_modulus_n_mm2: float
    radius_mm: float

    def __post_init__(self) -> None:
        mistakes = [
            Mistake(name, f"{getattr(self, name):g}", "must be a number above 0")
            for name in ("shear_modulus_n_mm2", "radius_mm")
            if not 0 < getattr(self, name) < math.inf
        ]
        if mistakes:
            raise ModelError(mistakes, "push")

    def at_tip_mm(self, tip_n: float) -> float:
        """Return the displacement of the tissue at the tip, the largest of all.

        Parameters
        ----------
        tip_n : float
            Force of the tip on the tissue (N).

        Returns
        -------
        float
            Displacement (mm).
        """
        return tip_n / (6 * math.pi * self.shear_modulus_n_mm2 * self.radius_mm)

    def shift_mm(self, tip_n: float, shaft_n: float, inserted_mm: float, *, ahead_mm: float, aside_mm: float) -> float:
        """Return the displacement of a target along the needle.

        Parameters
        ----------
        tip_n, shaft_n : float
            Force of the tip and friction of the shaft on the tissue (N), positive in the direction of insertion.
        inserted_mm : float
            Inserted length, along which the friction is spread.
        ahead_mm, aside_mm : float
            Place of the target relative to the tip: along the direction of the tip, and beside its axis.

        Returns
        -------
        float
            Displacement (mm), positive in the direction of insertion.
        """
        a = self.radius_mm
        r = max(math.hypot(ahead_mm, aside_mm), a)
        c2 = (ahead_mm / r) ** 2 if r > a else 1.0
        near = a / r
        tip = self.at_tip_mm(tip_n) * (3 * near * (1 + c2) + near**3 * (1 - 3 * c2)) / 4
        if inserted_mm <= 0 or not shaft_n:
            return tip
        rho = max(abs(aside_mm), a)
        line = _integral(ahead_mm + inserted_mm, rho) - _integral(ahead_mm, rho)
        return tip + shaft_n / (8 * math.pi * self.shear_modulus_n_mm2 * inserted_mm) * line


def _integral(s: float, rho: float) -> float:
    return 2 * math.asinh(s / rho) - s / math.hypot(s, rho)
