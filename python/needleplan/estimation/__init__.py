"""Estimation: joint filters of state and parameters, the tip filter, and the registration of a tracked needle."""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.estimation._joint_filter import FilterSample, FilterStep, JointFilter, SampleUse, ScalarKalmanFilter
from needleplan.estimation._joint_system import JointForce, JointSystem
from needleplan.estimation._numeric_system import NumericJointSystem
from needleplan.estimation.registration import (
    CoilPose,
    Outlier,
    Pivot,
    PivotStatus,
    Points,
    Poses,
    Registered,
    Registration,
    RigidMotion,
    calibrate_axis,
    calibrate_pivot,
    read_points,
    read_poses,
    register,
    register_needle,
    worst_pair,
)
from needleplan.estimation.tip import PoseUse, TipEstimate, TipFilter, TipSettings, TipStatus

__all__ = [
    "CoilPose",
    "FilterSample",
    "FilterStep",
    "JointFilter",
    "JointForce",
    "JointSystem",
    "NumericJointSystem",
    "Outlier",
    "Pivot",
    "PivotStatus",
    "Points",
    "PoseUse",
    "Poses",
    "Registered",
    "Registration",
    "RigidMotion",
    "SampleUse",
    "ScalarKalmanFilter",
    "TipEstimate",
    "TipFilter",
    "TipSettings",
    "TipStatus",
    "calibrate_axis",
    "calibrate_pivot",
    "read_points",
    "read_poses",
    "register",
    "register_needle",
    "worst_pair",
]
