"""Displacement of a target by the push of the needle, in an elastic half-space.

The tip pushes with the force F_t like a rigid sphere of the radius a, bonded to a medium with the shear modulus G and
Poisson's ratio nu. Without a surface, the axial displacement at the distance r from the tip, with c the cosine of the
angle to the needle's direction, is equation (4) of docs/explanation/mechanics.md ::

    u = F_t / (16 pi G (1 - nu)) [ (3 - 4 nu + c^2) / r + (a^2 / 3 r^3) (1 - 3 c^2) ],   u = u(a) for r < a

For nu = 1/2 this is Stokes' solution for the slow flow around a sphere; far away it is Kelvin's point force.

The friction F_s is spread evenly over the inserted length L behind the tip. Kelvin's solution, integrated along the
straight shaft, gives for a target that is z ahead of the tip and rho beside the axis equation (5) ::

    u = F_s / (16 pi G (1 - nu) L) [ (4 - 4 nu) asinh(s / rho) - s / sqrt(s^2 + rho^2) ] from s = z to s = z + L

with rho at least a. The free surface, across the needle at the distance L behind the tip, adds Mindlin's image of each
point force: equation (6) of docs/explanation/mechanics.md. It is smooth in the tissue, and is integrated along the
shaft numerically. Only the displacement along the needle is returned.

Sources: Stokes' sphere and Kelvin's point force, as in textbooks of fluid mechanics and of elasticity; R. D. Mindlin,
"Force at a point in the interior of a semi-infinite solid", Physics 7 (1936) 195. Assumptions: the other boundaries of
the organ are far away, the tissue is linear and uniform, and cutting does not relieve it. Near the tip, where tissue
tears, the displacement is too large; if the organ moves as a whole, too small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.config import ConfigTable, Flag, Number, ruled
from needleplan.errors import ModelError
from needleplan.signals import Array

__all__ = ["NeedlePush", "TargetPush"]

# Width (mm) of the bracket of a root.
_SAME_MM = 1e-9

# Places on -1 to 1 and weights of Gauss' rule along the shaft.
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True)
class NeedlePush(ConfigTable, error=ModelError):
    """Elastic tissue around a needle, whose push displaces a target.

    The constructor raises ModelError unless modulus and radius are positive and finite, and nu is from 0 to 1/2.

    Parameters
    ----------
    shear_modulus_n_mm2 : float
        Shear modulus G of the tissue, a third of Young's modulus; 1 kPa is 0.001 N/mm2.
    radius_mm : float
        Outer radius a of the needle.
    poisson : float
        Poisson's ratio nu; 1/2 is incompressible.
    free_surface : bool
        Whether the medium ends at a free surface, where the needle enters.

    Examples
    --------
    >>> from needleplan.models.tissue import NeedlePush
    >>> push = NeedlePush(shear_modulus_n_mm2=0.01, radius_mm=0.635)
    >>> print(f"{push.at_tip_mm(0.3):.2f} mm, {push.shift_mm(0.3, 0.0, 0.0, ahead_mm=10.0, aside_mm=0.0):.2f} mm")
    2.51 mm, 0.24 mm
    """

    shear_modulus_n_mm2: float = ruled(Number("N/mm2", above=0))
    radius_mm: float = ruled(Number("mm", above=0))
    poisson: float = ruled(Number(at_least=0, at_most=0.5), 0.5)
    free_surface: bool = ruled(Flag(), True)

    def _per_mm(self) -> float:
        """Return 1 / (16 pi G (1 - nu)), mm2/N."""
        return 1 / (16 * math.pi * self.shear_modulus_n_mm2 * (1 - self.poisson))

    def at_tip_mm(self, tip_n: float) -> float:
        """Return the displacement of the tissue at the tip, the largest of all, far from the surface.

        Parameters
        ----------
        tip_n : float
            Force of the tip on the tissue (N).

        Returns
        -------
        float
            Displacement (mm).
        """
        return tip_n * self._per_mm() * (10 - 12 * self.poisson) / (3 * self.radius_mm)

    def shift_mm(self, tip_n: float, shaft_n: float, inserted_mm: float, *, ahead_mm: float, aside_mm: float) -> float:
        """Return the displacement of a target along the needle.

        Parameters
        ----------
        tip_n, shaft_n : float
            Force of the tip and friction of the shaft on the tissue (N), positive in the direction of insertion.
        inserted_mm : float
            Inserted length, along which the friction is spread, and the distance of the tip from the surface.
        ahead_mm, aside_mm : float
            Place of the target relative to the tip: along the direction of the tip, and beside its axis.

        Returns
        -------
        float
            Displacement (mm), positive in the direction of insertion.
        """
        a, nu = self.radius_mm, self.poisson
        r = max(math.hypot(ahead_mm, aside_mm), a)
        c2 = (ahead_mm / r) ** 2 if r > a else 1.0
        tip = tip_n * ((3 - 4 * nu + c2) / r + a**2 / (3 * r**3) * (1 - 3 * c2))
        if inserted_mm <= 0:
            return self._per_mm() * tip
        rho = max(abs(aside_mm), a)
        line = self._along(ahead_mm + inserted_mm, rho) - self._along(ahead_mm, rho)
        shaft = shaft_n / inserted_mm * line
        if self.free_surface:
            depth = max(inserted_mm + ahead_mm, 0.0)
            tip += tip_n * self._image(inserted_mm, depth, rho)
            places = inserted_mm * (_PLACES + 1) / 2
            shaft += (
                shaft_n
                / 2
                * sum(
                    weight * self._image(place, depth, rho)
                    for place, weight in zip(places.tolist(), _WEIGHTS.tolist(), strict=True)
                )
            )
        return self._per_mm() * (tip + shaft)

    def beyond_mm(
        self, tip_n: float, shaft_n: float = 0.0, inserted_mm: float = math.inf, aside_mm: float = 0.0
    ) -> float:
        """Return how much further than to the place of a target at rest a tip must go to reach the displaced target.

        Parameters
        ----------
        tip_n, shaft_n, inserted_mm : float
            As in `shift_mm`; an infinite length means far from the surface, without friction.
        aside_mm : float
            Distance of the target from the axis of the needle.

        Returns
        -------
        float
            Length (mm) beyond the place at rest, along the needle: the root s of shift(ahead = -s) = s.
        """
        length = inserted_mm if math.isfinite(inserted_mm) else 0.0
        low, high = 0.0, 2 * self.shift_mm(tip_n, shaft_n, length, ahead_mm=0.0, aside_mm=aside_mm)
        while high - low > _SAME_MM:
            middle = (low + high) / 2
            shift = self.shift_mm(tip_n, shaft_n, length, ahead_mm=-middle, aside_mm=aside_mm)
            low, high = (middle, high) if shift > middle else (low, middle)
        return max(high, 0.0)

    def _along(self, s: float, rho: float) -> float:
        return (4 - 4 * self.poisson) * math.asinh(s / rho) - s / math.hypot(s, rho)

    def _image(self, source_mm: float, depth_mm: float, rho_mm: float) -> float:
        """Return what the surface adds to the displacement at a depth by a force at the depth `source_mm` (1/mm)."""
        nu, apart = self.poisson, depth_mm + source_mm
        r = math.hypot(rho_mm, apart)
        return (
            (8 * (1 - nu) ** 2 - (3 - 4 * nu)) / r
            + ((3 - 4 * nu) * apart**2 - 2 * source_mm * depth_mm) / r**3
            + 6 * source_mm * depth_mm * apart**2 / r**5
        )


@dataclass(frozen=True)
class TargetPush(ShortRepr):
    """Push of a needle on its target: the tissue, and the forces when the tip arrives.

    Parameters
    ----------
    tissue : NeedlePush
        Tissue around the needle.
    tip_n, shaft_n : float
        Force of the tip and friction of the shaft (N).
    length_mm : float
        Length of the path (mm); infinite: far from the surface, without friction.
    """

    tissue: NeedlePush
    tip_n: float
    shaft_n: float = 0.0
    length_mm: float = math.inf

    @property
    def shift_mm(self) -> float:
        """Displacement (mm) of a target at the tip."""
        length = self.length_mm if math.isfinite(self.length_mm) else 0.0
        return self.tissue.shift_mm(self.tip_n, self.shaft_n, length, ahead_mm=0.0, aside_mm=0.0)

    def beyond_mm(self, apart_mm: Array, tangent: Array) -> float:
        """Return how much further than to the place at rest a tip must go that passes the target.

        Parameters
        ----------
        apart_mm : numpy.ndarray
            Place of the target at rest relative to a point of the axis of the needle (mm), shape (2,) or (3,).
        tangent : numpy.ndarray
            Unit vector along the needle.

        Returns
        -------
        float
            Length (mm), as of `NeedlePush.beyond_mm`.
        """
        aside = float(np.linalg.norm(apart_mm - (apart_mm @ tangent) * tangent))
        return self.tissue.beyond_mm(self.tip_n, self.shaft_n, self.length_mm, aside)
