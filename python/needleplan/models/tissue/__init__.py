"""Tissue that moves with the needle under friction (thesis, chapter 4), as a model and by the slow observer.

| name | meaning |
|---|---|
| `MovingTissue` | abstract: Kelvin-Voigt tissue under any friction with one linear state |
| `LumpedOnTissue` | with Model II of chapter 3 |
| `AveragedOnTissue` | with Models III-A and III-B |
| `fit_on_tissue` | joint identification of tissue and friction |
| `tune_slow_observer` | the method of the thesis, with automatic tuning |
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
