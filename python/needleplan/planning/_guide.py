"""The pose of the guide that gives an entry pose of the tip.

A needle leaves its guide at a heading h and an offset o, which `needleplan identify curvature` fits. h and o are those
of the bevel side of the identification; for the other bevel side they are assumed to be mirrored.
"""

from __future__ import annotations

import math

from needleplan.planning._poses import Pose, wrapped
from needleplan.scenario import EntryPose

__all__ = ["guide_pose"]


def guide_pose(tip: Pose, entry: EntryPose) -> Pose:
    """Return the pose of the guide that gives an entry pose of the tip.

    Parameters
    ----------
    tip : Pose
        Wanted pose of the tip at the entry.
    entry : EntryPose
        Heading and offset of the tip relative to the guide.

    Returns
    -------
    Pose
        Point and direction of the guide's axis, with the bevel of `tip`.

    Examples
    --------
    >>> from needleplan.planning import Pose, guide_pose
    >>> from needleplan.scenario import EntryPose
    >>> guide = guide_pose(Pose(0.0, 20.0, 0.05, 1), EntryPose(heading_rad=0.05, offset_mm=0.5, side=1))
    >>> guide.y_mm, guide.heading_rad
    (19.5, 0.0)
    """
    mirror = tip.bevel * entry.side
    heading = tip.heading_rad - mirror * entry.heading_rad
    aside = mirror * entry.offset_mm
    return Pose(tip.x_mm + aside * math.sin(heading), tip.y_mm - aside * math.cos(heading), wrapped(heading), tip.bevel)
