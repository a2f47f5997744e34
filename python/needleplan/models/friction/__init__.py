"""Friction along the shaft of a needle (thesis, chapter 3), and cutting at the tip.

| name | in the thesis |
|---|---|
| `Karnopp` | benchmark: Coulomb and viscous friction |
| `DirectionalKarnopp` | not in the thesis: the same, with values of its own on retraction |
| `QuasiStatic` | Model I |
| `LumpedLuGre` | Model II; with a `profile`, its normal force follows the inserted length |
| `AveragedLuGre(profile=Profile.RIGHT)`, `AveragedLuGre()` | Models III-A and III-B |
| `distributed` | the partial differential equation (3.1) to (3.4) |
| `ShaftAndTip` | not in the thesis: Dahl friction along the shaft and cutting at the tip |

Units are mm, N and s. With Fn = 1 N the friction forces are some tenths of a newton.
"""

from needleplan.models.friction._base import Friction, Profile, StribeckFriction, intensity, normal_length_mm
from needleplan.models.friction._distributed import distributed
from needleplan.models.friction._law_curves import LawCurves, mean_speed
from needleplan.models.friction._lugre import AveragedLuGre, Beta, LuGre, LumpedLuGre, OutputForm, beta_per_mm
from needleplan.models.friction._memoryless import (
    DirectionalKarnopp,
    ForceParts,
    Karnopp,
    QuasiStatic,
    cutting_force,
    into_fresh_tissue,
)
from needleplan.models.friction._periodic import first_guess, steady
from needleplan.models.friction._shaft_and_tip import BlendedReversal, ShaftAndTip, slid, slid_along

__all__ = [
    "AveragedLuGre",
    "Beta",
    "BlendedReversal",
    "DirectionalKarnopp",
    "ForceParts",
    "Friction",
    "Karnopp",
    "LawCurves",
    "LuGre",
    "LumpedLuGre",
    "OutputForm",
    "Profile",
    "QuasiStatic",
    "ShaftAndTip",
    "StribeckFriction",
    "beta_per_mm",
    "cutting_force",
    "distributed",
    "first_guess",
    "intensity",
    "into_fresh_tissue",
    "mean_speed",
    "normal_length_mm",
    "slid",
    "slid_along",
    "steady",
]
