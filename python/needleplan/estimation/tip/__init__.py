"""Where the tip is: a filter that knows the arc, from stage samples and poses of a coil behind the tip."""

from needleplan.estimation.tip.estimate import PoseUse, TipEstimate, TipStatus
from needleplan.estimation.tip.filter import TipFilter
from needleplan.estimation.tip.settings import TipSettings

__all__ = ["PoseUse", "TipEstimate", "TipFilter", "TipSettings", "TipStatus"]
