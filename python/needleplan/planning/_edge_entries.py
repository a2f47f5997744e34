"""The best entries of a policy table on an edge of its workspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import Mistake, PoseError
from needleplan.planning._coded import Outcome
from needleplan.planning._lookup import Lookups
from needleplan.planning._poses import Entry, Pose, best_of, edge_poses, whole_number

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["EdgeEntries"]

# Largest number of entries that may be asked for: more than an edge has grid points.
_MOST_ENTRIES = 1_000_000


@dataclass(frozen=True, eq=False, repr=False)
class EdgeEntries(Lookups):
    """Entries on the edges of the workspace; base class of `PolicyTable`."""

    def best_entry(
        self, edge: str = "left", *, x_mm: float | None = None, y_mm: float | None = None, nearest: bool = False
    ) -> Entry[Pose]:
        """Return the entry on an edge with the highest success probability.

        Entries whose success differs by less than 0.1 % count as equal; the lowest cost decides among them.

        Parameters
        ----------
        edge : {"left", "right", "bottom", "top"}
            Edge of the workspace at which the needle enters.
        x_mm : float, optional
            Position on the bottom or top edge in mm. Without it, every grid point is searched.
        y_mm : float, optional
            Position on the left or right edge in mm. Without it, every grid point is searched.
        nearest : bool, default False
            Compare the entries of the table at the nearest states, as in the thesis, instead of predictions.

        Returns
        -------
        Entry
            The pose, its success probability and its expected cost. All headings that lead into the workspace are
            searched. Positions in an obstacle are left out.

        Raises
        ------
        PoseError
            If there is no such edge, if the position is not on the edge, or if all positions are in obstacles.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> print(table.best_entry(y_mm=60).pose)
        x 0 mm, y 60 mm, heading -48 deg, bevel +1
        """
        return best_of(edge, *self._edge_answers(edge, x_mm, y_mm, nearest=nearest))

    def entries(self, count: int = 5, edge: str = "left", apart_mm: float = 6.0) -> list[Entry[Pose]]:
        """Return the best entries on an edge that are apart from each other, best first.

        Parameters
        ----------
        count : int, default 5
            Largest number of entries.
        edge : {"left", "right", "bottom", "top"}
            Edge of the workspace at which the needle enters.
        apart_mm : float, default 6.0
            Least distance of two entries in mm.

        Returns
        -------
        list of Entry
            Each is the best of its position, ranked as by `best_entry`.

        Raises
        ------
        PoseError
            As `best_entry`.

        Examples
        --------
        >>> import needleplan as npl
        >>> first, second = npl.plan("four_obstacles").entries(2)
        >>> first.success >= second.success, abs(first.pose.y_mm - second.pose.y_mm) >= 6
        (True, True)
        """
        count = whole_number("count", count, 1, _MOST_ENTRIES, f"from 1 to {_MOST_ENTRIES:,}")
        poses, success, value = self._edge_answers(edge, None, None, nearest=False)
        entries: list[Entry[Pose]] = []
        while len(poses) and len(entries) < count:
            entries.append(best_of(edge, poses, success, value))
            far = np.hypot(*(poses[:, :2] - entries[-1].pose[:2]).T) >= apart_mm
            poses, success, value = poses[far], success[far], value[far]
        return entries

    def _edge_answers(
        self, edge: str, x_mm: float | None, y_mm: float | None, *, nearest: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
        """Return the poses on an edge outside of all obstacles, their success and cost. Raises PoseError."""
        poses = edge_poses(self.scenario, edge, x_mm, y_mm)
        poses = poses[self.lattice.events(np.ascontiguousarray(poses[:, :2])) != Outcome.COLLISION.code]
        if not len(poses):
            rule = "must have a position outside of all obstacles; choose another edge or position"
            raise PoseError(Mistake("edge", f'"{edge}"', rule))
        decisions = self.lookup_many(poses, nearest=nearest)
        return poses, decisions.success, decisions.value
