"""The entries of a 3D table that keep the limits of the anatomy file, and how many each limit leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import SpaceLimits
from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ScenarioError
from needleplan.planning._space_path import space_paths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan.anatomy import SpaceScenario
    from needleplan.planning._space_part import PartialSpace

__all__ = ["LENGTHS", "KeptEntries", "LimitCount", "kept_entries"]

LENGTHS = ("limits.insertion_mm", "needle.length_mm")
"""Keys of the limits of the length of a path."""


@dataclass(frozen=True)
class LimitCount(ShortRepr):
    """Effect of a limit: its key, and the numbers of entries after (`left`) and before (`before`) the limit."""

    key: str
    left: int
    before: int

    def __str__(self) -> str:
        return f"{self.left} of {self.before} entries left after {self.key}"


@dataclass(frozen=True, eq=False)
class KeptEntries(ShortRepr):
    """Entries within the limits: poses with the permitted direction of the least cost, shape (n, 6), and the counts."""

    poses: NDArray[np.float64]
    counts: tuple[LimitCount, ...]


def kept_entries(
    scenario: SpaceScenario,
    solved: _ppvi.SolvedSpace | PartialSpace,
    tangents: NDArray[np.float64],
    points_mm: NDArray[np.float64],
) -> KeptEntries:
    """Return the entries at points of the lattice, shape (n, 3), that keep the limits of the anatomy file.

    `tangents` are the directions of the table. Raises ScenarioError if a limit leaves no entry.
    """
    grid, frame, needle = scenario.grid, scenario.grid.frame, scenario.needle
    limits, counts, points = scenario.file.limits or SpaceLimits(), [], points_mm

    def keep(key: str, kept: NDArray[np.bool_], value: Any) -> NDArray[np.bool_]:
        counts.append(LimitCount(key, int(kept.sum()), len(kept)))
        if not kept.any():
            rule = f"leaves none of {len(kept)} entries: change this limit or the entry region"
            raise ScenarioError(Mistake(key, value, rule), scenario.source)
        return kept

    left = np.ones(len(points), bool)
    for key, kept in limits.reachable(frame.world(points)):
        left[left] = keep(key, kept[left], "")
    points = points[left]
    permitted = limits.permits(tangents @ frame.axes)
    if limits.toward is not None:
        some = np.full(len(points), bool(permitted.any()))
        keep("limits.toward_deg", some, f"{limits.toward_deg:g}")
    tangents = tangents[permitted]
    nearest = grid.nearest_points(points)
    i, j, k = nearest.T
    best = solved.values[i, :, j, k][:, permitted].argmin(-1)
    between = np.flatnonzero((abs(points - nearest * frame.spacing_mm) > 1e-9).any(-1))
    for place in between.tolist():
        poses = np.concatenate([np.repeat(points[place : place + 1], len(tangents), 0), tangents], -1)
        best[place] = solved.decide(poses)["value"].argmin()
    poses = np.concatenate([points, tangents[best]], -1)
    for key, most_mm in zip(LENGTHS, (limits.insertion_mm, needle.length_mm), strict=True):
        if most_mm is not None:
            poses = poses[keep(key, space_paths(solved, grid, poses).length_mm <= most_mm, f"{most_mm:g}")]
    return KeptEntries(poses, tuple(counts))
