"""Success of the best heading at every position of an edge."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from needleplan.artifacts import short_html, short_repr
from needleplan.planning._coded import Outcome
from needleplan.planning._poses import Edge, Entry, Pose, best_of, edge_poses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning._table import PolicyTable

__all__ = ["EdgeProfile", "edge_profile"]


class EdgeProfile(NamedTuple):
    """Best heading at every position of an edge.

    Attributes
    ----------
    position_mm : ndarray of float64, shape (n,)
        Positions along the edge in mm: y at the left and right edge, x at the bottom and top edge.
    success : ndarray of float64, shape (n,)
        Largest success probability over headings and bevels; NaN in obstacles.
    heading_rad : ndarray of float64, shape (n,)
        The heading of this success, in rad.
    best : Entry or None
        The best entry of the edge, as `PolicyTable.best_entry` returns it; None if all positions are in obstacles.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.planning import edge_profile
    >>> profile = edge_profile(npl.plan("four_obstacles"), "left")
    >>> float(profile.position_mm[-1]), bool(profile.success.max() > 0.9)
    (80.0, True)
    """

    position_mm: NDArray[np.float64]
    success: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    best: Entry[Pose] | None

    def _repr_html_(self) -> str:
        return short_html(self)

    def __repr__(self) -> str:
        return short_repr(self)


def edge_profile(table: PolicyTable, edge: str = "left") -> EdgeProfile:
    """Return the success of the best heading at every grid position of an edge.

    Parameters
    ----------
    table : PolicyTable
        The policy table.
    edge : {"left", "right", "bottom", "top"}
        Edge of the workspace at which the needle enters.

    Returns
    -------
    EdgeProfile

    Raises
    ------
    PoseError
        If there is no such edge.
    """
    poses = edge_poses(table.scenario, edge, None, None)
    along = 1 if Edge(edge) in (Edge.LEFT, Edge.RIGHT) else 0
    free = table.lattice.events(np.ascontiguousarray(poses[:, :2])) != Outcome.COLLISION.code
    success, entry = np.full(len(poses), np.nan), None
    if free.any():
        decisions = table.lookup_many(poses[free])
        success[free] = decisions.success
        entry = best_of(edge, poses[free], decisions.success, decisions.value)
    positions = np.unique(poses[:, along])
    rows = success.reshape(len(positions), -1)  # the poses of one position follow each other
    best = np.arange(len(rows)) * rows.shape[1] + np.argmax(np.nan_to_num(rows, nan=-1.0), axis=1)
    return EdgeProfile(positions, success[best], poses[best, 2], entry)
