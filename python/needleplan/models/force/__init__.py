"""Axial force on a needle as a function of depth: chapter 2 of the thesis.

`base` has the equations, `model_1` and `model_2` which of the seven numbers are free, `gauge` their exact symmetry,
`asymptote` the closed forms, `published` what the thesis identified.
"""

from needleplan.models.force.asymptote import insertion_asymptote, retraction_asymptote, steady_state
from needleplan.models.force.base import DepthForce
from needleplan.models.force.gauge import regauged, regauged_state, with_gauge
from needleplan.models.force.model_1 import ForceModel1
from needleplan.models.force.model_2 import ForceModel2
from needleplan.models.force.published import PUBLISHED_FORCES, PublishedForce

__all__ = [
    "PUBLISHED_FORCES",
    "DepthForce",
    "ForceModel1",
    "ForceModel2",
    "PublishedForce",
    "insertion_asymptote",
    "regauged",
    "regauged_state",
    "retraction_asymptote",
    "steady_state",
    "with_gauge",
]
