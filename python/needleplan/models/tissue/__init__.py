"""Tissue that friction moves with the needle (thesis, chapter 4): models, and the slow observer.

| name | meaning |
|---|---|
| `MovingTissue` | abstract: a friction model with one linear state on Kelvin-Voigt tissue |
| `LumpedOnTissue` | Model II of chapter 3 on Kelvin-Voigt tissue |
| `AveragedOnTissue` | Models III-A and III-B of chapter 3 on Kelvin-Voigt tissue |
| `fit_on_tissue` | joint identification of tissue and friction |
| `NeedlePush`, `TargetPush` | displacement of a target by the push of the needle |
| `tune_slow_observer` | the slow observer of the thesis, tuned automatically |
"""

from needleplan.models.tissue._joint_fit import fit_on_tissue, lag_with_sd, tissue_lag_rad, tissue_start
from needleplan.models.tissue._moving import (
    AveragedOnTissue,
    FrictionLaw,
    LuGreLaw,
    LumpedOnTissue,
    MovingTissue,
    PointwiseLaw,
    bristle_step,
    stepping,
)
from needleplan.models.tissue._push import NeedlePush, TargetPush
from needleplan.models.tissue._slow_observer import SlowObserver, TuningStatus, tune_slow_observer

__all__ = [
    "AveragedOnTissue",
    "FrictionLaw",
    "LuGreLaw",
    "LumpedOnTissue",
    "MovingTissue",
    "NeedlePush",
    "PointwiseLaw",
    "SlowObserver",
    "TargetPush",
    "TuningStatus",
    "bristle_step",
    "fit_on_tissue",
    "lag_with_sd",
    "stepping",
    "tissue_lag_rad",
    "tissue_start",
    "tune_slow_observer",
]
