"""Bending of a flexible needle on its way into tissue (chapter 5 of the thesis): two coupled sub-beams.

`Beam` is the equation of an instant, `solve_exact` and `solve_elements` solve it for many instants at once, `march`
follows an insertion whose path the tissue remembers, and `tip_path_mm` is that path in closed form. `TipPath`, in a
plane, and `SpatialBeam`, with a bevel that is turned, are members of the family of models. u > 0 is towards the push of
the bevel, everywhere.
"""

from needleplan.models.deflection._beam import AxialTerms, Beam, ElasticTissue, Foundation, NeedleShaft
from needleplan.models.deflection._elements import ElementShape, hermite, solve_elements, solve_uniform
from needleplan.models.deflection._exact import ExactShape, solve_exact
from needleplan.models.deflection._march import (
    AxialOffset,
    CutPath,
    cutting_force_n,
    finite_depth_factor,
    march,
    radius_from_axial_mm,
)
from needleplan.models.deflection._path_law import (
    FreePath,
    circle_push_n,
    flip_jump,
    side_slip,
    steady_radius_mm,
    tip_path_mm,
)
from needleplan.models.deflection._tip_path import InsertionForce, SpatialBeam, TipPath

__all__ = [
    "AxialOffset",
    "AxialTerms",
    "Beam",
    "CutPath",
    "ElasticTissue",
    "ElementShape",
    "ExactShape",
    "Foundation",
    "FreePath",
    "InsertionForce",
    "NeedleShaft",
    "SpatialBeam",
    "TipPath",
    "circle_push_n",
    "cutting_force_n",
    "finite_depth_factor",
    "flip_jump",
    "hermite",
    "march",
    "radius_from_axial_mm",
    "side_slip",
    "solve_elements",
    "solve_exact",
    "solve_uniform",
    "steady_radius_mm",
    "tip_path_mm",
]
