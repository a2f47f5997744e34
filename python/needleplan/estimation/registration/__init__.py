"""Registration: distance from coil to tip, rigid motion from tracker to plan coordinates, and the verdict on both."""

from needleplan.estimation.registration._measurements import Points, Poses, read_points, read_poses
from needleplan.estimation.registration._needle import (
    CalibratedNeedle,
    Registered,
    calibrate_needle,
    register_tracker,
)
from needleplan.estimation.registration._pivot import Pivot, PivotStatus, calibrate_axis, calibrate_pivot
from needleplan.estimation.registration._registration import CoilPose, Registration, not_refused, require_verdict
from needleplan.estimation.registration._rigid import Outlier, RigidMotion, register, worst_pair
from needleplan.estimation.registration._status import RegistrationVerdict, VerdictStatus
from needleplan.estimation.registration._verdict import PoseNoise, Refusal, RefusalReason, noise_at_rest

__all__ = [
    "CalibratedNeedle",
    "CoilPose",
    "Outlier",
    "Pivot",
    "PivotStatus",
    "Points",
    "PoseNoise",
    "Poses",
    "Refusal",
    "RefusalReason",
    "Registered",
    "Registration",
    "RegistrationVerdict",
    "RigidMotion",
    "VerdictStatus",
    "calibrate_axis",
    "calibrate_needle",
    "calibrate_pivot",
    "noise_at_rest",
    "not_refused",
    "read_points",
    "read_poses",
    "register",
    "register_tracker",
    "require_verdict",
    "worst_pair",
]
