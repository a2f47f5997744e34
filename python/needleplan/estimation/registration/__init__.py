"""Registration: where the tip is on a tracked needle, and how the tracker's frame lies to that of the plan."""

from needleplan.estimation.registration.pivot import Pivot, calibrate_axis, calibrate_pivot
from needleplan.estimation.registration.registration import CoilPose, Registration
from needleplan.estimation.registration.rigid import RigidMotion, register

__all__ = ["CoilPose", "Pivot", "Registration", "RigidMotion", "calibrate_axis", "calibrate_pivot", "register"]
