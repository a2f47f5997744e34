"""Tip estimation: a Kalman filter of the needle path, from stage samples and poses of a coil behind the tip."""

from needleplan.estimation.tip._estimate import PoseUse, TipEstimate, TipSettings, TipStatus
from needleplan.estimation.tip._filter import TipFilter

__all__ = [
    "PoseUse",
    "TipEstimate",
    "TipFilter",
    "TipSettings",
    "TipStatus",
]
