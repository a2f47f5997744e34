"""Estimation: filters that follow a model through data, curvature from tracked points, calibration of sensors."""

from needleplan.estimation.circle import Circle, CircleMethod, fit_circle
from needleplan.estimation.curvature import (
    Change,
    Curvature,
    Heterogeneity,
    PathForm,
    TrackerNoise,
    agreement,
    curvature,
    path_curvature,
)
from needleplan.estimation.joint import Joint, NumericJoint
from needleplan.estimation.joint_filter import JointFilter
from needleplan.estimation.joint_force import JointForce
from needleplan.estimation.passes import FilterRun, FilterStatus, Recipe, identify_by_passes
from needleplan.estimation.punctures import Drop, force_drops
from needleplan.estimation.registration import (
    CoilPose,
    Outlier,
    Pivot,
    PivotStatus,
    Registration,
    RigidMotion,
    calibrate_axis,
    calibrate_pivot,
    register,
    worst_pair,
)
from needleplan.estimation.replay import mean_absolute_error, replay
from needleplan.estimation.sample import Sample, Step, Use
from needleplan.estimation.tip import PoseUse, TipEstimate, TipFilter, TipSettings, TipStatus
from needleplan.estimation.tip_noise import NoiseStatus, TipNoise, headings_at, tip_noise
from needleplan.estimation.track import Track, feed, track_of

__all__ = [
    "Change",
    "Circle",
    "CircleMethod",
    "CoilPose",
    "Curvature",
    "Drop",
    "FilterRun",
    "FilterStatus",
    "Heterogeneity",
    "Joint",
    "JointFilter",
    "JointForce",
    "NoiseStatus",
    "NumericJoint",
    "Outlier",
    "PathForm",
    "Pivot",
    "PivotStatus",
    "PoseUse",
    "Recipe",
    "Registration",
    "RigidMotion",
    "Sample",
    "Step",
    "TipEstimate",
    "TipFilter",
    "TipNoise",
    "TipSettings",
    "TipStatus",
    "Track",
    "TrackerNoise",
    "Use",
    "agreement",
    "calibrate_axis",
    "calibrate_pivot",
    "curvature",
    "feed",
    "fit_circle",
    "force_drops",
    "headings_at",
    "identify_by_passes",
    "mean_absolute_error",
    "path_curvature",
    "register",
    "replay",
    "tip_noise",
    "track_of",
    "worst_pair",
]
