"""Registration: distance from coil to tip, and rigid motion from tracker coordinates to plan coordinates."""

from needleplan.estimation.registration._measurements import Points, Poses, read_points, read_poses
from needleplan.estimation.registration._needle import Registered, register_needle
from needleplan.estimation.registration._pivot import Pivot, PivotStatus, calibrate_axis, calibrate_pivot
from needleplan.estimation.registration._registration import CoilPose, Registration
from needleplan.estimation.registration._rigid import Outlier, RigidMotion, register, worst_pair

__all__ = [
    "CoilPose",
    "Outlier",
    "Pivot",
    "PivotStatus",
    "Points",
    "Poses",
    "Registered",
    "Registration",
    "RigidMotion",
    "calibrate_axis",
    "calibrate_pivot",
    "read_points",
    "read_poses",
    "register",
    "register_needle",
    "worst_pair",
]
