"""Estimation: Kalman filters of models with free parameters, and what was identified."""

from needleplan.estimation.joint import Joint, NumericJoint
from needleplan.estimation.joint_filter import JointFilter
from needleplan.estimation.joint_force import JointForce
from needleplan.estimation.passes import FilterRun, FilterStatus, Recipe, identify_by_passes
from needleplan.estimation.replay import mean_absolute_error, replay
from needleplan.estimation.sample import Sample, Step, Use
from needleplan.estimation.track import Track, feed, track_of

__all__ = [
    "FilterRun",
    "FilterStatus",
    "Joint",
    "JointFilter",
    "JointForce",
    "NumericJoint",
    "Recipe",
    "Sample",
    "Step",
    "Track",
    "Use",
    "feed",
    "identify_by_passes",
    "mean_absolute_error",
    "replay",
    "track_of",
]
