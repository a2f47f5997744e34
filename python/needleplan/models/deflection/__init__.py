"""Bending of a flexible needle on its way into tissue (chapter 5 of the thesis): two coupled sub-beams.

`Beam` is the equation of an instant, `solve_exact` and `solve_elements` solve it for many instants at once, `march`
follows an insertion whose path the tissue remembers, and `tip_path_mm` is that path in closed form. `TipPath`, in a
plane, and `SpatialBeam`, with a bevel that is turned, are members of the family of models. u > 0 is towards the push of
the bevel, everywhere.
"""

from needleplan.models.deflection.axial_force import InsertionForce
from needleplan.models.deflection.beam import Beam, Tissue
from needleplan.models.deflection.choices import AxialTerms, Foundation
from needleplan.models.deflection.elements import ElementShape, solve_elements, solve_uniform
from needleplan.models.deflection.exact import ExactShape, solve_exact
from needleplan.models.deflection.march import CutPath, march
from needleplan.models.deflection.path_law import (
    FreePath,
    circle_push_n,
    flip_jump,
    side_slip,
    steady_radius_mm,
    tip_path_mm,
)
from needleplan.models.deflection.radius import (
    AxialOffset,
    cutting_force_n,
    finite_depth_factor,
    radius_from_axial_mm,
)
from needleplan.models.deflection.spatial import SpatialBeam
from needleplan.models.deflection.tip_path import TipPath

__all__ = [
    "AxialOffset",
    "AxialTerms",
    "Beam",
    "CutPath",
    "ElementShape",
    "ExactShape",
    "Foundation",
    "FreePath",
    "InsertionForce",
    "SpatialBeam",
    "TipPath",
    "Tissue",
    "circle_push_n",
    "cutting_force_n",
    "finite_depth_factor",
    "flip_jump",
    "march",
    "radius_from_axial_mm",
    "side_slip",
    "solve_elements",
    "solve_exact",
    "solve_uniform",
    "steady_radius_mm",
    "tip_path_mm",
]
