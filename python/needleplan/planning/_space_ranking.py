"""The ranking of the entry points of a 3D table. It is the one meaning of "the best entry".

The table proposes candidates: the entries of the highest expected success with an error of the entry, in steps of
0.1 %, and then of the lowest cost. Executions decide between them, since the table is off by some points. Estimates of
all entries would take minutes. Entries are ordered by the numbers as they are printed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from needleplan.anatomy import OUTSIDE
from needleplan.planning._space_estimates import Estimates
from needleplan.planning._space_input import MOST_RUNS, run_number
from needleplan.planning._space_path import space_paths, valid_poses
from needleplan.planning._success import Success

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan.anatomy import SpaceScenario
    from needleplan.planning._space_part import PartialSpace

__all__ = ["COMPARED", "EQUAL_SUCCESS", "ESTIMATE_RUNS", "UNREACHABLE", "EntryRanking", "spread_out"]

# Number of executions of an estimate of success: its standard error is below 0.7 percentage points.
ESTIMATE_RUNS = 2000
# Number of candidates that executions compare to find the best entry; a longer list compares all that it has.
COMPARED = 5

# Success below which an entry counts as one that does not reach the target.
UNREACHABLE = 0.001
# Successes that differ by less are equal; then the cost decides.
EQUAL_SUCCESS = 0.001
# Errors of the entry whose cost is computed: shift (mm) and tilt (rad), each in so many directions. They are two
# standard deviations of the error in the expected success.
_SHIFT_MM, _TILT_RAD, _AROUND = 2.0, math.radians(2.0), 8


def spread_out(
    order: list[int],
    points_mm: NDArray[np.float64],
    count: int,
    apart_mm: float,
    first: Callable[[list[int]], int] = lambda left: left[0],
) -> list[int]:
    """Choose at most `count` numbers of an order whose points are at least `apart_mm` from each other.

    `first` chooses among the numbers that are left, in their order; by default the first of them.
    """
    chosen: list[int] = []
    left = order
    while left and len(chosen) < count:
        chosen.append(first(left))
        gaps = np.linalg.norm(points_mm[left] - points_mm[chosen[-1]], axis=-1)
        left = [number for number, gap in zip(left, gaps, strict=True) if gap >= apart_mm and number != chosen[-1]]
    return chosen


@dataclass(frozen=True, eq=False)
class EntryRanking:
    """Entry points with their success and cost by the table, which are ranked.

    `poses` has the shape (n, 6), in the frame of the lattice (mm); `success` and `value` have the shape (n,).
    """

    runs: ClassVar[int] = ESTIMATE_RUNS
    """Number of executions of an estimate."""

    scenario: SpaceScenario
    solved: _ppvi.SolvedSpace | PartialSpace
    poses: NDArray[np.float64]
    success: NDArray[np.float64]
    value: NDArray[np.float64]
    estimates: Estimates

    @classmethod
    def of(
        cls,
        scenario: SpaceScenario,
        solved: _ppvi.SolvedSpace | PartialSpace,
        poses: NDArray[np.float64],
        estimates: Estimates,
    ) -> EntryRanking:
        """Return the ranking of entries whose success and cost are looked up."""
        answers = solved.look_up(poses)
        success, value = answers["success"].astype(np.float64), answers["value"].astype(np.float64)
        return cls(scenario, solved, poses, success, value, estimates)

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """Numbers of the entry points, best first: by success at the exact pose, rounded to 0.1 %, then by cost."""
        return np.lexsort((self.value, -np.round(self.success / EQUAL_SUCCESS)))

    def first(self, *, exact: bool = False) -> int:
        """Return the number of the best entry: the first of `best`, or of `order` if no entry reaches the target."""
        return int((*self.best(1, exact=exact), self.order[0])[0])

    def best(self, count: int, apart_mm: float = 6.0, *, exact: bool = False) -> list[int]:
        """Return the numbers of the best entry points that are at least `apart_mm` from each other, best first.

        At least five `candidates` are ordered by their expected success by executions, rounded to 0.1 %, or if `exact`
        by their success without an error of the entry; candidates with equal success are ordered by the other columns
        of the list. The first entry is the same for every `count` up to five.
        """
        compared = self.candidates(max(count, COMPARED), apart_mm, exact=exact)
        paths = space_paths(self.solved, self.scenario.grid, self.poses[compared].reshape(-1, 6))
        keys = {
            number: (
                *(-figure for figure in self._shown(number, exact=exact)),
                -round(float(paths.clearance_mm[place]), 1),
                round(float(paths.length_mm[place])),
                int(paths.turns[place]),
            )
            for place, number in enumerate(compared)
        }
        return sorted(compared, key=lambda number: keys[number])[:count]

    def candidates(self, count: int, apart_mm: float = 6.0, *, exact: bool = False) -> list[int]:
        """Return the numbers of the best entry points by the table, at least `apart_mm` from each other, best first.

        They are ranked by `expected_success`, in steps of 0.1 %, and then by cost; if `exact`, by `order`.
        """
        order = [int(number) for number in self.order if self.success[number] >= UNREACHABLE]
        first = (lambda left: left[0]) if exact else self._first
        return spread_out(order, self.poses[:, :3], count, apart_mm, first)

    def estimate(self, number: int, runs: int | None = None) -> Success:
        """Return the success of an entry by executions, as `SpaceTable.estimate` does."""
        runs = run_number(self.runs if runs is None else runs, MOST_RUNS)
        return self.estimates.make(self.poses[number], runs)

    def known_success(self, number: int) -> Success:
        """Return the success of an entry by executions if it has been estimated, else by the table."""
        known = self.estimates.find(self.poses[number], self.runs)
        return known or Success(min(float(self.success[number]), 1.0))

    def with_error(self, number: int, success: Success) -> float:
        """Return `success` minus the expected loss of success, by the table, by an error of the entry."""
        return max(success.value + self.expected_success(number) - float(self.success[number]), 0.0)

    def _shown(self, number: int, *, exact: bool) -> tuple[float, ...]:
        """Return the numbers on the success of an entry in the order of the list, in percent, as they are printed."""
        success = self.estimate(number)
        low, high = success.interval or (0.0, 1.0)
        alone, expected = (success.value, low, high), (self.with_error(number, success),)
        return tuple(float(f"{100 * share:.1f}") for share in ((*alone, *expected) if exact else (*expected, *alone)))

    def expected_success(self, number: int) -> float:
        """Return the expected success of an entry if the needle enters with an error; see `EntryMap`."""
        losses = [self.success[number] - successes.mean() for successes in self.around(number)]
        return float(np.clip(self.success[number] - sum(losses) / 2, 0, self.success[number]))

    def around(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the success of an entry shifted by 2 mm, and tilted by 2 degrees, each in eight directions."""
        if number not in self._known:
            pose = self.poses[number]
            around = 2 * math.pi * np.arange(_AROUND) / _AROUND
            across = np.stack([np.zeros(_AROUND), np.cos(around), np.sin(around)], -1)
            shifted, tilted = np.repeat(pose[None], _AROUND, 0), np.repeat(pose[None], _AROUND, 0)
            shifted[:, :3] += _SHIFT_MM * across
            shifted[:, 0] += self._depth_of_skin(shifted)
            sideways = across - (across @ pose[3:])[:, None] * pose[3:]
            sideways /= np.linalg.norm(sideways, axis=-1)[:, None]
            tilted[:, 3:] = math.cos(_TILT_RAD) * pose[3:] + math.sin(_TILT_RAD) * sideways
            successes = self._success_at(np.concatenate([shifted, tilted]))
            self._known[number] = successes[:_AROUND], successes[_AROUND:]
        return self._known[number]

    @cached_property
    def _known(self) -> dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        return {}

    def _first(self, numbers: list[int]) -> int:
        """Return the entry with the highest expected success of `numbers`, which are in the order of `order`."""
        best, highest, least = numbers[0], -1, math.inf
        for number in numbers:
            if round(self.success[number] / EQUAL_SUCCESS) < highest:
                break  # an expected success is at most the success, and those that follow have less
            steps = round(self.expected_success(number) / EQUAL_SUCCESS)
            if (steps, -self.value[number]) > (highest, -least):
                best, highest, least = number, steps, float(self.value[number])
        return best

    def _depth_of_skin(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far (mm) poses outside of the body move along the axis to enter it; 0 if they do not enter."""
        grid = self.scenario.grid
        spacing, shape = grid.frame.spacing_mm, np.array(grid.frame.shape)
        deeper = spacing * np.arange(math.ceil(2 * _SHIFT_MM / spacing) + 1)
        cells = np.floor(poses[:, None, :3] / spacing + 0.5).astype(np.int64)
        cells = np.repeat(cells, len(deeper), 1)
        cells[..., 0] += np.arange(len(deeper))
        within = ((cells >= 0) & (cells < shape)).all(-1)
        inside = within & (grid.codes[tuple(np.clip(cells, 0, shape - 1).transpose(2, 0, 1))] != OUTSIDE)
        return np.asarray(deeper[inside.argmax(1)])

    def _success_at(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the predicted success of poses; 0 outside the lattice and the cone."""
        successes = np.zeros(len(poses))
        valid = valid_poses(self.scenario.grid, self.scenario.cone_rad, poses)
        if valid.any():
            successes[valid] = self.solved.look_up(np.ascontiguousarray(poses[valid]))["success"]
        return successes
