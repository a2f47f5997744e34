"""Bending of a flexible needle in tissue (thesis, chapter 5): two coupled sub-beams.

| name | meaning |
|---|---|
| `NeedleShaft`, `ElasticTissue` | geometry and material of the needle; stiffness and friction of the tissue |
| `Beam` | coefficients of the beam equation for one or many insertions |
| `solve_elements` | solution of the beam equation by finite elements |
| `march` | an insertion step by step, in tissue that remembers the path of the tip |
| `tip_path_mm` | the path of the tip in closed form |
| `UnsupportedShaft` | buckling load between the last support and the tissue |
| `radius_from_axial_mm` | the radius of curvature from the axial force at the base |
| `TipPath`, `SpatialBeam`, `InsertionForce`, `LayeredShape` | models for `simulate` and `fit` |
| `FibreSensors` | curvature sensors along the needle, and their curvatures from the strains of the cores |
| `fit_shape` | intrinsic curvature from the curvatures that sensors along the needle measure |

The deflection u is positive toward the push of the bevel.
"""

from needleplan.models.deflection._beam import AxialTerms, Beam, ElasticTissue, Foundation, NeedleShaft
from needleplan.models.deflection._buckling import ShaftEnd, UnsupportedShaft
from needleplan.models.deflection._elements import ElementShape, hermite, solve_elements, solve_uniform
from needleplan.models.deflection._fibre import FibreCurvatures, FibreSensors
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
    steady_radius_mm,
    tip_path_mm,
)
from needleplan.models.deflection._rod import LayeredShape, NeedleShape
from needleplan.models.deflection._shape_fit import ShapeFit, fit_shape
from needleplan.models.deflection._tip_path import InsertionForce, SpatialBeam, TipPath

__all__ = [
    "AxialOffset",
    "AxialTerms",
    "Beam",
    "CutPath",
    "ElasticTissue",
    "ElementShape",
    "FibreCurvatures",
    "FibreSensors",
    "Foundation",
    "FreePath",
    "InsertionForce",
    "LayeredShape",
    "NeedleShaft",
    "NeedleShape",
    "ShaftEnd",
    "ShapeFit",
    "SpatialBeam",
    "TipPath",
    "UnsupportedShaft",
    "cutting_force_n",
    "finite_depth_factor",
    "fit_shape",
    "hermite",
    "march",
    "radius_from_axial_mm",
    "solve_elements",
    "solve_uniform",
    "steady_radius_mm",
    "tip_path_mm",
]
