"""Axial force on a needle as a function of depth (chapter 2 of the thesis), and force that relaxes.

| name | meaning |
|---|---|
| `ForceModel1`, `ForceModel2` | the two models of the thesis; they differ in which parameters are fixed |
| `RelaxingForce` | elastic tissue with Maxwell branches, capsules that break, layers |
| `insertion_asymptote`, `retraction_asymptote` | closed forms of the force at depths far beyond its peak |
| `regauged`, `with_gauge` | models with equal forces and another scale of the state |
| `sensitivity` | one integration step with its derivatives, for Kalman filters |
"""

from needleplan.models.force._depth_force import (
    DepthForce,
    ForceModel1,
    ForceModel2,
    insertion_asymptote,
    regauged,
    retraction_asymptote,
    with_gauge,
)
from needleplan.models.force._relaxing import BOUNDARIES, NOWHERE_MM, RelaxingForce

__all__ = [
    "BOUNDARIES",
    "NOWHERE_MM",
    "DepthForce",
    "ForceModel1",
    "ForceModel2",
    "RelaxingForce",
    "insertion_asymptote",
    "regauged",
    "retraction_asymptote",
    "with_gauge",
]
