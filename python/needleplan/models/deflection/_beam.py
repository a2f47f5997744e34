"""The beam equation of the needle: needle, tissue, the choice of axial terms, and the coefficients.

Lengths are in mm, angles in rad, moduli in GPa and the density in kg/m3, as in material tables. Stiffnesses are in N
mm2 (1 GPa = 1000 N/mm2). The unit of mass that is consistent with N, mm and s is the tonne: 1 kg/m3 = 1e-12 t/mm3.

The four variants of `AxialTerms` are cases of one equation. u > 0 is toward the push of the bevel. x runs from the base
(0) past the entry point (l1 = L - depth) to the tip (L), equation (1) of docs/explanation/deflection.md::

    EI u'''' + N(x) u'' + b u' + kf (u - path) = 0     in the tissue, x > l1
    EI u'''' + N(l1) u''                       = 0     outside
    EI u''(L) = M,   EI u'''(L) = -(P + s u'(L)),   u and u' given at the base, u to u''' continuous at l1
    N(x) = N_tip + c (L - max(x, l1))

Source: sections 5.2 and 5.3 of the thesis. The deflection w of the thesis is -u for positive Fc.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleplan.artifacts import CallRepr
from needleplan.config import ConfigTable, Number, mistakes_of, ruled
from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection._stepped import StiffnessSteps
from needleplan.signals import Array

__all__ = ["AxialTerms", "Beam", "ElasticTissue", "Foundation", "NeedleShaft"]

_RULES = {
    "outer_diameter_mm": Number("mm", at_least=0.05, at_most=10),
    "inner_diameter_mm": Number("mm", at_least=0, at_most=10),
    "length_mm": Number("mm", at_least=10, at_most=1000),
    "bevel_angle_rad": Number("rad", at_least=0.01, at_most=math.pi / 2),
    "youngs_modulus_gpa": Number("GPa", at_least=0.1, at_most=1000),
    "shear_modulus_gpa": Number("GPa", at_least=0.05, at_most=500),
    "density_kg_m3": Number("kg/m3", at_least=500, at_most=25000),
}


@dataclass(frozen=True)
class NeedleShaft(CallRepr):
    """Geometry and material of a straight needle with a bevelled tip, hollow or solid.

    The constructor raises ModelError, with all mistakes, for numbers out of range and for an inner diameter that is not
    less than the outer diameter.

    Parameters
    ----------
    outer_diameter_mm, inner_diameter_mm : float
        Diameters; the inner diameter of a solid needle is 0.
    length_mm : float
        Length.
    bevel_angle_rad : float
        Angle between the bevel face and the axis. The force on the face is normal to it: its lateral component is
        proportional to cos(bevel), its axial component to sin(bevel).
    youngs_modulus_gpa, shear_modulus_gpa : float
        Elastic moduli.
    density_kg_m3 : float
        Density.
    stiffness_steps : tuple of (float, float)
        Changes of the bending stiffness along the shaft: pairs of a distance from the tip (mm) and the ratio of the
        stiffness from there on to that of the tip, by increasing distance. The diameters, and everything that follows
        from them, are those of the tip.

    Examples
    --------
    >>> from needleplan.models import NeedleShaft
    >>> needle = NeedleShaft(outer_diameter_mm=0.718, inner_diameter_mm=0.413, length_mm=203.0, bevel_angle_rad=0.433)
    >>> print(f"EI = {needle.bending_stiffness_n_mm2:.0f} N mm2")
    EI = 2324 N mm2
    """

    outer_diameter_mm: float
    inner_diameter_mm: float
    length_mm: float
    bevel_angle_rad: float
    youngs_modulus_gpa: float = 200.0
    shear_modulus_gpa: float = 77.0
    density_kg_m3: float = 8000.0
    stiffness_steps: StiffnessSteps = ()

    def __post_init__(self) -> None:
        mistakes = mistakes_of(self, _RULES)
        if not mistakes and self.inner_diameter_mm >= self.outer_diameter_mm:
            rule = f"must be less than outer_diameter_mm, {self.outer_diameter_mm:g}"
            mistakes.append(Mistake("inner_diameter_mm", f"{self.inner_diameter_mm:g}", rule))
        places = [0.0, *(place for place, _ in self.stiffness_steps), self.length_mm]
        if not all(before < after for before, after in pairwise(places)):
            rule = "must have increasing distances from the tip, above 0 and below length_mm"
            mistakes.append(Mistake("stiffness_steps", str(self.stiffness_steps), rule))
        if not all(1e-3 <= ratio <= 1e3 for _, ratio in self.stiffness_steps):
            mistakes.append(
                Mistake("stiffness_steps", str(self.stiffness_steps), "must have ratios from 0.001 to 1000")
            )
        if mistakes:
            raise ModelError(mistakes, "needle")

    @property
    def second_moment_mm4(self) -> float:
        """Second moment of area about a diameter, mm4."""
        return math.pi / 64 * (self.outer_diameter_mm**4 - self.inner_diameter_mm**4)

    @property
    def area_mm2(self) -> float:
        """Area of the cross-section, mm2."""
        return math.pi / 4 * (self.outer_diameter_mm**2 - self.inner_diameter_mm**2)

    @property
    def bending_stiffness_n_mm2(self) -> float:
        """Bending stiffness EI at the tip, N mm2."""
        return 1000 * self.youngs_modulus_gpa * self.second_moment_mm4

    def require_uniform(self, what: str) -> None:
        """Raise ModelError if the stiffness changes along the shaft, for which `what` has no formula."""
        if self.stiffness_steps:
            rule = f"must be empty for {what}, which holds for a uniform shaft; use march or solve_elements"
            raise ModelError(Mistake("stiffness_steps", str(self.stiffness_steps), rule), "needle")

    @property
    def torsional_stiffness_n_mm2(self) -> float:
        """Torsional stiffness GJ of the round cross-section with J = 2 I, N mm2."""
        return 2000 * self.shear_modulus_gpa * self.second_moment_mm4

    @property
    def line_mass_t_mm(self) -> float:
        """Mass per length, t/mm.

        The thesis prints the density in kg/m2; its numbers require kg/m3.
        """
        return 1e-12 * self.density_kg_m3 * self.area_mm2


class AxialTerms(StrEnum):
    """Choice of the first-order terms of the axial load in the beam equation.

    c = vf v is the friction per length. The equations below hold in the tissue; c and kf are zero outside.
    """

    CONSISTENT = "consistent"
    """All terms: EI u'''' + N u'' + kf (u - path) = 0, EI u'''(L) = -Fc cos a, N(x) = Fc sin a + c (L - max(x, l1)).

    A needle that is pushed along a straight oblique line stays on the line.
    """

    PLAIN = "plain"
    """No terms: EI u'''' + kf (u - path) = 0, EI u'''(L) = -Fc cos a."""

    PRINTED = "printed"
    """(5.6) and (5.8) as printed: EI u'''' + kf u - c u' = 0, EI u'''(L) = -(Fc cos a + Fc sin a u'(L)).

    The signs of the terms with u' are wrong. The friction pushes forward, and the tip force follows the slope of the
    tip in the wrong sense, which makes the cantilever unstable at Fc = 2 EI/(L^2 sin a). (A positive Fc pushes toward
    the bevel here; (5.3) has the opposite sign.)
    """

    FIXED = "fixed"
    """The printed terms with corrected signs: EI u'''' + kf u + c u' = 0, EI u'''(L) = -(Fc cos a - Fc sin a u'(L)).

    The expansion is still incomplete: the omitted axial load N would cancel both terms exactly.
    """


class Foundation(StrEnum):
    """The reference position of the tissue's springs."""

    MEMORY = "memory"
    """The path that the tip has cut: fresh tissue is unstressed. The path becomes a circle, R = EI lam/P."""

    ANCHORED = "anchored"
    """The straight line of the insertion, as in (5.1). A constant tip force then makes no arc."""


@dataclass(frozen=True)
class ElasticTissue(ConfigTable, error=ModelError):
    """Uniform elastic tissue around the needle.

    The constructor raises ModelError for numbers out of range.

    Parameters
    ----------
    stiffness_n_mm2 : float
        kf, force per length and displacement; 1 kN/m2 is 1e-3 N/mm2.
    friction_n_s_mm2 : float
        vf, friction per length and velocity; 1 N s/m2 is 1e-6 N s/mm2.

    Examples
    --------
    >>> import math
    >>> from needleplan.models import NeedleShaft
    >>> from needleplan.models.deflection import ElasticTissue
    >>> needle = NeedleShaft(0.718, 0.413, 203.0, math.radians(24.8))
    >>> print(f"{1 / ElasticTissue(3.87e-3).decay_1_mm(needle):.1f} mm")
    39.4 mm
    """

    stiffness_n_mm2: float = ruled(Number("N/mm2 (1 kN/m2 is 0.001 N/mm2)", at_least=1e-6, at_most=100))
    friction_n_s_mm2: float = ruled(Number("N s/mm2 (1 N s/m2 is 1e-6 N s/mm2)", at_least=0, at_most=0.1), 0.0)

    def decay_1_mm(self, needle: NeedleShaft) -> float:
        """Return lam = (kf/4EI)^(1/4), 1/mm. A local load bends the needle over about 1/lam."""
        return math.sqrt(math.sqrt(self.stiffness_n_mm2 / (4 * needle.bending_stiffness_n_mm2)))


@dataclass(frozen=True)
class Beam(CallRepr):
    """Coefficients of the beam equation: scalars, or arrays that broadcast, one entry for each insertion."""

    length_mm: Array
    depth_mm: Array
    bending_n_mm2: Array
    """EI, bending stiffness."""

    foundation_n_mm2: Array
    """kf, stiffness of the tissue."""

    slope_n_mm: Array
    """b, lateral force per length and slope."""

    tip_axial_n: Array
    """N_tip, compression at the tip."""

    axial_rate_n_mm: Array
    """c, increase of the compression per length from the tip to the entry point."""

    tip_push_n: Array
    """P, lateral force on the tip."""

    tip_follow_n: Array
    """s, lateral force on the tip per slope of the tip."""

    tip_moment_n_mm: Array
    """M, moment at the tip. A needle whose tip is bent with the curvature k0 (1/mm) has M = EI k0."""

    _: KW_ONLY
    steps: StiffnessSteps = ()
    """Changes of EI along the shaft, the same for all insertions; `bending_n_mm2` is EI at the tip."""

    @classmethod
    def of(
        cls,
        needle: NeedleShaft,
        tissue: ElasticTissue,
        depth_mm: ArrayLike,
        cutting_force_n: ArrayLike,
        velocity_mm_s: ArrayLike = 0.0,
        *,
        bevel: ArrayLike = 1,
        terms: AxialTerms = AxialTerms.CONSISTENT,
        tip_moment_n_mm: ArrayLike = 0.0,
    ) -> Beam:
        """Return the coefficients for a needle in a tissue; the arguments broadcast.

        `cutting_force_n` is Fc, normal to the bevel face. `bevel` is +1 if Fc pushes toward u > 0, and -1 otherwise.
        Raises ModelError if a depth is not between 0 and the length of the needle, or a depth, force or velocity is not
        finite.
        """
        depth, force, velocity, side, moment = np.broadcast_arrays(
            *(np.asarray(array, float) for array in (depth_mm, cutting_force_n, velocity_mm_s, bevel, tip_moment_n_mm))
        )
        _require(needle, depth, force, velocity)
        friction = tissue.friction_n_s_mm2 * velocity
        axial = force * math.sin(needle.bevel_angle_rad)
        zero = np.zeros(depth.shape)
        consistent = terms is AxialTerms.CONSISTENT
        sign = {AxialTerms.PRINTED: 1.0, AxialTerms.FIXED: -1.0}.get(terms, 0.0)
        return cls(
            length_mm=zero + needle.length_mm,
            depth_mm=depth,
            bending_n_mm2=zero + needle.bending_stiffness_n_mm2,
            foundation_n_mm2=zero + tissue.stiffness_n_mm2,
            slope_n_mm=-sign * friction,
            tip_axial_n=axial if consistent else zero,
            axial_rate_n_mm=friction if consistent else zero,
            tip_push_n=side * force * math.cos(needle.bevel_angle_rad),
            tip_follow_n=sign * axial,
            tip_moment_n_mm=moment,
            steps=needle.stiffness_steps,
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Common shape of the coefficients."""
        return np.broadcast_shapes(*(np.shape(coefficient) for coefficient in self.coefficients))

    @property
    def coefficients(self) -> tuple[Array, ...]:
        """All coefficients in the order of the fields, without `steps`."""
        return tuple(value for name, value in vars(self).items() if name != "steps")

    def flat(self) -> Beam:
        """Return the beam with all coefficients broadcast to the shape (insertions,)."""
        shape = self.shape
        return Beam(
            *(np.broadcast_to(coefficient, shape).reshape(-1) for coefficient in self.coefficients), steps=self.steps
        )

    def rows(self, chosen: NDArray[np.intp]) -> Beam:
        """Return the beam with only the insertions of the indices `chosen`. The beam must be flat (see `flat`)."""
        return Beam(*(coefficient[chosen] for coefficient in self.coefficients), steps=self.steps)


def _require(needle: NeedleShaft, depth: Array, force: Array, velocity: Array) -> None:
    mistakes = [
        Mistake(name, "", "must be finite")
        for name, values in (("depth_mm", depth), ("cutting_force_n", force), ("velocity_mm_s", velocity))
        if not np.isfinite(values).all()
    ]
    if not mistakes and not ((depth > 0) & (depth < needle.length_mm)).all():
        worst = float(depth.max() if depth.max() >= needle.length_mm else depth.min())
        rule = f"must be more than 0 and less than the needle's length, {needle.length_mm:g} mm"
        mistakes.append(Mistake("depth_mm", f"{worst:g}", rule))
    if mistakes:
        raise ModelError(mistakes, "deflection")
