"""Estimates of success by executions from poses of a 3D table, which are made once and kept with the table.

A table file holds those that were known when it was written as the dataset `estimates`, one row each: position (mm),
tangent, number of executions, success, and the ends of its 95 % interval. All are by the seed 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from needleplan.planning._space_input import MOST_RUNS
from needleplan.planning._success import Success, SuccessSource

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan.planning._space_part import PartialSpace

__all__ = ["ESTIMATE_COLUMNS", "Estimates", "are_estimates"]

# Columns of the rows of a file: the pose, and what is known of it.
ESTIMATE_COLUMNS = ("x_mm", "y_mm", "z_mm", "dx", "dy", "dz", "runs", "success", "low", "high")
_POSE = 6
# Seed of the executions of all estimates that are kept.
SEED = 0


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of the success of poses by executions. An estimate is computed once, and kept."""

    solved: _ppvi.SolvedSpace | PartialSpace
    known: dict[tuple[float, ...], Success] = field(default_factory=dict)

    @classmethod
    def of(cls, solved: _ppvi.SolvedSpace | PartialSpace, rows: NDArray[np.float64] | None) -> Self:
        """Return the estimates that are stored in the rows of a file, shape (n, 10); None: no estimates."""
        known = {
            (*row[:_POSE], int(row[_POSE])): Success(
                row[_POSE + 1], (row[_POSE + 2], row[_POSE + 3]), SuccessSource.EXECUTIONS, int(row[_POSE])
            )
            for row in ([] if rows is None else rows.tolist())
        }
        return cls(solved, known)

    def rows(self) -> NDArray[np.float64]:
        """Return the rows for a file, shape (n, 10)."""
        rows = [(*key, success.value, *(success.interval or (0.0, 1.0))) for key, success in self.known.items()]
        return np.array(rows, np.float64).reshape(-1, len(ESTIMATE_COLUMNS))

    def find(self, pose: NDArray[np.float64], runs: int) -> Success | None:
        """Return the estimate of a pose, shape (6,), if it is known."""
        return self.known.get((*pose.tolist(), runs))

    def make(self, pose: NDArray[np.float64], runs: int) -> Success:
        """Return the estimate of a pose, shape (6,), which is known from then on."""
        key = (*pose.tolist(), runs)
        if key not in self.known:
            self.known[key] = Success.of_executions(self.solved.estimate(pose[None], runs=runs, seed=SEED))
        return self.known[key]


def are_estimates(rows: NDArray[np.float64]) -> bool:
    """Return whether the numbers of all rows are possible, and no pose has two estimates with equal runs."""
    if rows.shape[1:] != (len(ESTIMATE_COLUMNS),) or not np.isfinite(rows).all():
        return False
    if len(np.unique(rows[:, : _POSE + 1], axis=0)) != len(rows):
        return False
    runs, value, low, high = rows[:, _POSE:].T
    whole = (runs >= 1) & (runs <= MOST_RUNS) & (runs == np.round(runs))
    return bool((whole & (low >= 0) & (low <= value) & (value <= high) & (high <= 1)).all())
