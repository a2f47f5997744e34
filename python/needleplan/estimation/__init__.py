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
from needleplan.estimation.replay import mean_absolute_error, replay
from needleplan.estimation.sample import Sample, Step, Use
from needleplan.estimation.track import Track, feed, track_of

__all__ = [
    "Change",
    "Circle",
    "CircleMethod",
    "Curvature",
    "FilterRun",
    "FilterStatus",
    "Heterogeneity",
    "Joint",
    "JointFilter",
    "JointForce",
    "NumericJoint",
    "PathForm",
    "Recipe",
    "Sample",
    "Step",
    "Track",
    "TrackerNoise",
    "Use",
    "agreement",
    "curvature",
    "feed",
    "fit_circle",
    "identify_by_passes",
    "mean_absolute_error",
    "path_curvature",
    "replay",
    "track_of",
]
