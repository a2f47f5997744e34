"""Registration: where the tip is on a tracked needle, and how the tracker's frame lies to that of the plan."""

from needleplan.estimation.registration.pivot import Pivot, PivotStatus, calibrate_axis, calibrate_pivot
from needleplan.estimation.registration.registration import CoilPose, Registration
from needleplan.estimation.registration.rigid import Outlier, RigidMotion, register, worst_pair

__all__ = [
    "CoilPose",
    "Outlier",
    "Pivot",
    "PivotStatus",
    "Registration",
    "RigidMotion",
    "calibrate_axis",
    "calibrate_pivot",
    "register",
    "worst_pair",
]
