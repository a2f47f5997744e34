"""Tables of the part of a lattice through which a path from a pose to the target can lead.

With tangents in a cone of the half angle t about the x axis, a path from the tip p to the target lies in the cone
behind the target and in the cone in front of the tip. With the distance L of the last slice of the target from the tip,
the radius r of the target's box around its centre c, and a = tan(t), the lateral coordinate y obeys

    (p_y + c_y - r - a L) / 2  <=  y  <=  (p_y + c_y + r + a L) / 2.

Outside of this box no policy reaches the target, so that tables of the box are those of the whole lattice where they
matter. A plan on the way takes a fraction of the time of the first one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import SpaceFrame, SpaceScenario

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan._ppvi_results import (
        SpaceAnswers,
        SpaceDecisions,
        SpacePathsResult,
        SpaceReport,
        SpaceRolloutResult,
    )

__all__ = ["PartialSpace", "part_ahead"]

# Angle (rad) beyond the cone that the tip may have, and number of grid points around the box.
_BEYOND_RAD, _MARGIN = math.radians(10.0), 2


@dataclass(frozen=True, eq=False)
class PartialSpace:
    """Tables of a box of a lattice, looked up by poses in the frame of the whole lattice.

    `corner_mm` is the first grid point of the box, shape (3,), `shape` its number of grid points, and `voxel_mm` the
    size of its voxels.
    """

    solved: _ppvi.SolvedSpace
    corner_mm: NDArray[np.float64]
    spacing_mm: float
    shape: tuple[int, int, int]
    voxel_mm: float

    @property
    def values(self) -> NDArray[np.float32]:
        """Optimal costs of the states in the box, as `SpaceTable.values`."""
        return self.solved.values

    @property
    def policy(self) -> NDArray[np.uint8]:
        """Numbers of the best actions of the states in the box, as `SpaceTable.policy`."""
        return self.solved.policy

    @property
    def success(self) -> NDArray[np.uint16]:
        """Success probabilities of the states in the box, in units of 1/65535."""
        return self.solved.success

    def report(self) -> SpaceReport:
        """Return the statistics of the solve."""
        return self.solved.report()

    def contains(self, positions_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which positions, shape (n, 3), lie in the box."""
        beyond = positions_mm - self.corner_mm + self.voxel_mm / 2
        return np.asarray(((beyond >= 0) & (beyond < np.array(self.shape) * self.spacing_mm)).all(-1))

    def look_up(self, poses_mm: NDArray[np.float64], *, threads: int | None = None) -> SpaceAnswers:
        """Return arrays `action`, `value` and `success`, shape (n,) each, at poses, shape (n, 6)."""
        return self.solved.look_up(self._moved(poses_mm), threads=threads)

    def decide(self, poses_mm: NDArray[np.float64], *, threads: int | None = None) -> SpaceDecisions:
        """Return arrays `action` and `value`, shape (n,) each, at poses, shape (n, 6)."""
        return self.solved.decide(self._moved(poses_mm), threads=threads)

    def rollout(
        self, pose_mm: NDArray[np.float64], *, runs: int, seed: int, threads: int | None = None
    ) -> SpaceRolloutResult:
        """Return executions from a pose, shape (1, 6)."""
        return self.solved.rollout(self._moved(pose_mm), runs=runs, seed=seed, threads=threads)

    def paths(
        self, poses_mm: NDArray[np.float64], *, seed: int | None = None, threads: int | None = None
    ) -> SpacePathsResult:
        """Return executions from poses, shape (n, 6), with their points."""
        executions = self.solved.paths(self._moved(poses_mm), seed=seed, threads=threads)
        executions["poses"][:, :3] += self.corner_mm
        return executions

    def estimate(
        self, pose_mm: NDArray[np.float64], *, runs: int, seed: int, threads: int | None = None
    ) -> NDArray[np.float64]:
        """Return independent numbers whose mean is the success from a pose, shape (1, 6)."""
        return self.solved.estimate(self._moved(pose_mm), runs=runs, seed=seed, threads=threads)

    def true_outcomes(
        self,
        poses_mm: NDArray[np.float64],
        truths: NDArray[np.float64],
        *,
        center_mm: Sequence[float],
        seed: int,
        threads: int | None = None,
    ) -> NDArray[np.uint8]:
        """Return the outcomes of executions from poses, shape (n, 6), with the rows of their truths, shape (n, 14)."""
        moved, rows = truths.copy(), truths[:, :12].reshape(-1, 3, 4)
        moved[:, 3:12:4] += rows[:, :, :3] @ self.corner_mm - self.corner_mm
        center = (np.asarray(center_mm) - self.corner_mm).tolist()
        return self.solved.true_outcomes(self._moved(poses_mm), moved, center_mm=center, seed=seed, threads=threads)

    def _moved(self, poses_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([poses_mm[:, :3] - self.corner_mm, poses_mm[:, 3:]], -1)


def part_ahead(scenario: SpaceScenario, position_mm: Sequence[float]) -> tuple[SpaceScenario, NDArray[np.int64]]:
    """Return the part of a scenario through which a path from a position can lead, and its first grid point.

    The part begins a step behind the position. It is the whole scenario if the target is not ahead.
    """
    frame, spacing = scenario.grid.frame, scenario.grid.frame.spacing_mm
    target = scenario.grid.target_points_mm / spacing
    least, most = np.floor(target.min(0)), np.ceil(target.max(0))
    at = np.array(position_mm, float) / spacing
    ahead = most[0] - at[0]
    if ahead < 1:
        return scenario, np.zeros(3, np.int64)
    reach = math.tan(min(scenario.cone_rad + _BEYOND_RAD, math.radians(80))) * (ahead + scenario.advance)
    low = np.floor((at + least - reach) / 2).astype(np.int64) - _MARGIN
    high = np.ceil((at + most + reach) / 2).astype(np.int64) + _MARGIN + 1
    low[0], high[0] = math.floor(at[0]) - scenario.advance, frame.shape[0]
    low, high = np.maximum(low, 0), np.minimum(high, frame.shape)
    box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    grid = scenario.grid
    arrays: dict[str, Any] = {}
    for name in ("voxels", "possible", "clearance_mm", "entry", "tissues"):
        array = getattr(grid, name)
        finer = array.shape[0] // frame.shape[0]
        arrays[name] = np.ascontiguousarray(array[tuple(slice(finer * side.start, finer * side.stop) for side in box)])
    sizes = (int(high[0] - low[0]), int(high[1] - low[1]), int(high[2] - low[2]))
    part = SpaceFrame(frame.world(low * spacing), frame.axes, spacing, sizes)
    arrays["target"] = grid.target.moved(low * spacing)
    return SpaceScenario(scenario.file, replace(grid, frame=part, **arrays)), low
