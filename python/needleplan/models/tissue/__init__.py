"""Tissue that gives way under friction: thesis, chapter 4, as a model instead of a slow observer.

| here | what |
|---|---|
| `MovingTissue` | Kelvin-Voigt tissue under any friction with one linear state; abstract |
| `LumpedOnTissue` | under Model II of chapter 3 |
| `AveragedOnTissue` | under Models III-A and III-B |
| `fit_on_tissue` | stiffness and damping together with the friction |
| `tune_slow_observer` | the thesis' way, without the person |
"""

from needleplan.models.tissue._joint_fit import fit_on_tissue, lag_with_sd, tissue_lag_rad, tissue_start
from needleplan.models.tissue._moving import AveragedOnTissue, LuGreLaw, LumpedOnTissue, MovingTissue, PointwiseLaw
from needleplan.models.tissue._slow_observer import SlowObserver, TuningStatus, tune_slow_observer
from needleplan.models.tissue._stepping import FrictionLaw, stepping

__all__ = [
    "AveragedOnTissue",
    "FrictionLaw",
    "LuGreLaw",
    "LumpedOnTissue",
    "MovingTissue",
    "PointwiseLaw",
    "SlowObserver",
    "TuningStatus",
    "fit_on_tissue",
    "lag_with_sd",
    "stepping",
    "tissue_lag_rad",
    "tissue_start",
    "tune_slow_observer",
]
