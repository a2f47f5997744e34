"""The needle: geometry and material, and the stiffnesses that follow from them.

Lengths are in mm, angles in rad; moduli in GPa and the density in kg/m3, as tables of materials give them. Stiffnesses
are N mm2: 1 GPa = 1000 N/mm2. The mass that belongs to N, mm and s is the tonne: 1 kg/m3 = 1e-12 t/mm3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from needleplan.errors import Mistake, ModelError

__all__ = ["Needle"]

_RANGES = {
    "outer_diameter_mm": (0.05, 10.0),
    "inner_diameter_mm": (0.0, 10.0),
    "length_mm": (10.0, 1000.0),
    "bevel_angle_rad": (0.01, math.pi / 2),
    "youngs_modulus_gpa": (0.1, 1000.0),
    "shear_modulus_gpa": (0.05, 500.0),
    "density_kg_m3": (500.0, 25000.0),
}


@dataclass(frozen=True)
class Needle:
    """A straight hollow (inner diameter above 0) or solid needle with a bevelled tip.

    `bevel_angle_rad` is the angle between the bevel face and the axis: the force on the face, which is normal to it,
    has the lateral part cos(bevel) and the axial part sin(bevel). Raises ModelError, which names all that is wrong.
    """

    outer_diameter_mm: float
    inner_diameter_mm: float
    length_mm: float
    bevel_angle_rad: float
    youngs_modulus_gpa: float = 200.0
    shear_modulus_gpa: float = 77.0
    density_kg_m3: float = 8000.0

    def __post_init__(self) -> None:
        mistakes = []
        for each in fields(self):
            value = getattr(self, each.name)
            low, high = _RANGES[each.name]
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
                mistakes.append(Mistake(each.name, str(value), f"must be a number from {low:.4g} to {high:.4g}"))
        if not mistakes and self.inner_diameter_mm >= self.outer_diameter_mm:
            rule = f"must be less than outer_diameter_mm, {self.outer_diameter_mm:g}"
            mistakes.append(Mistake("inner_diameter_mm", f"{self.inner_diameter_mm:g}", rule))
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
        """EI, N mm2."""
        return 1000 * self.youngs_modulus_gpa * self.second_moment_mm4

    @property
    def torsional_stiffness_n_mm2(self) -> float:
        """GJ of the round cross-section, J = 2 I, N mm2."""
        return 2000 * self.shear_modulus_gpa * self.second_moment_mm4

    @property
    def line_mass_t_mm(self) -> float:
        """Mass per length, t/mm (1e-6 of it in kg/m): N = t mm/s2.

        The thesis prints the density in kg/m2; kg/m3 is what its numbers need.
        """
        return 1e-12 * self.density_kg_m3 * self.area_mm2
