"""The pose of the guide that gives an entry pose of the tip, and the success with the scatter of the entry.

A needle leaves its guide at a heading h and an offset o, which `needleplan identify curvature` fits. h and o are those
of the bevel side of the identification; for the other bevel side they are assumed to be mirrored. The next insertion
has h + e1 and o + e2 with normal errors. The success is integrated over both errors by Gauss-Hermite quadrature.
"""

from __future__ import annotations

import math

import numpy as np

from needleplan.planning._plane_truth import scattered_poses
from needleplan.planning._poses import Pose, wrapped
from needleplan.planning._table import PolicyTable
from needleplan.scenario import EntryPose

__all__ = ["guide_pose", "success_over_entries"]

# Number of quadrature nodes for each error.
_NODES = 7


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


def success_over_entries(table: PolicyTable, tip: Pose, entry: EntryPose) -> float:
    """Return the probability of reaching the target, averaged over the scatter of heading and offset at the entry.

    Parameters
    ----------
    table : PolicyTable
        The plan.
    tip : Pose
        Mean entry pose of the tip.
    entry : EntryPose
        Its scatter between insertions.

    Returns
    -------
    float
        The probability. Poses outside of the workspace count as failures.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.planning import success_over_entries
    >>> from needleplan.scenario import EntryPose
    >>> table = npl.plan("four_obstacles")
    >>> best = table.best_entry()
    >>> certain, scattered = EntryPose(), EntryPose(heading_sd_rad=0.1, offset_sd_mm=1.0)
    >>> success_over_entries(table, best.pose, certain) > success_over_entries(table, best.pose, scattered)
    True
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    turn, shift = (each.ravel() for each in np.meshgrid(nodes * entry.heading_sd_rad, nodes * entry.offset_sd_mm))
    weight = np.outer(weights, weights).ravel() / weights.sum() ** 2
    poses = scattered_poses(table.scenario.workspace, tip, shift, turn)
    inside = np.isfinite(poses[:, 0])
    return float(weight[inside] @ table.lookup_many(poses[inside]).success) if inside.any() else 0.0
