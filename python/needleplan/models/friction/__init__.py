"""Friction along the shaft of a needle: thesis, chapter 3.

| here | thesis |
|---|---|
| `Karnopp` | benchmark: Coulomb and viscous |
| `QuasiStatic` | Model I |
| `LumpedLuGre` | Model II; with a `profile`, its normal force follows the inserted length |
| `AveragedLuGre(profile=RIGHT)`, `AveragedLuGre()` | Models III-A, III-B |
| `distributed` | the partial differential equation (3.1) to (3.4) itself |

Units mm, N, s. Forces are tenths of a newton for Fn = 1 N.
"""

from needleplan.models.friction.beta import Beta, beta_per_mm
from needleplan.models.friction.cutting import ForceParts, cutting_force, into_fresh_tissue
from needleplan.models.friction.distributed import distributed
from needleplan.models.friction.lugre import AveragedLuGre, LuGre, LumpedLuGre, OutputForm
from needleplan.models.friction.profile import Profile, intensity, normal_length_mm
from needleplan.models.friction.shaft import Friction, StribeckFriction
from needleplan.models.friction.static import Karnopp, QuasiStatic

__all__ = [
    "AveragedLuGre",
    "Beta",
    "ForceParts",
    "Friction",
    "Karnopp",
    "LuGre",
    "LumpedLuGre",
    "OutputForm",
    "Profile",
    "QuasiStatic",
    "StribeckFriction",
    "beta_per_mm",
    "cutting_force",
    "distributed",
    "intensity",
    "into_fresh_tissue",
    "normal_length_mm",
]
