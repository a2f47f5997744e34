"""3D plans: the tables of an anatomy, its entries ranked, and a proof where none exists."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan import _ppvi
from needleplan.anatomy import FREE, OBSTACLE, TARGET, SpaceScenario, entered_cells, possible_codes
from needleplan.artifacts import ShortRepr
from needleplan.planning._space_path import SpacePaths, space_paths
from needleplan.planning._space_places import SUCCESS_STEPS
from needleplan.planning._space_plan import plan_space
from needleplan.planning._space_ranking import UNREACHABLE, EntryRanking
from needleplan.planning._space_table import SpaceTable
from needleplan.planning._success import Success

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy import Anatomy, AnatomyGrid
    from needleplan.planning._lattice import Progress
    from needleplan.planning._space_part import PartialSpace

__all__ = ["EntryMap", "SpaceEntry", "entry_map", "rank_entries"]

# Side of the squares of slopes in the proof that no path exists.
_SLOPES = 0.1
# Difference between table and estimate from which on exports carry the estimate.
_DISAGREEMENT = 0.03
# Cells that are asked for together in that proof, which bounds the memory.
_CELLS_AT_ONCE = 2_000_000


@dataclass(frozen=True)
class SpaceEntry(ShortRepr):
    """An entry of an anatomy, with its success and the properties of its path.

    Parameters
    ----------
    position_mm, direction : tuple of float
        Entry point in RAS mm, and unit vector of insertion in RAS.
    success : Success
        Predicted probability of reaching the target: that of `SpaceTable.estimate`, or of the table without executions.
    table_success : float
        Success by the table.
    clearance_mm, length_mm : float
        Smallest distance to an obstacle, and length, of the path without noise.
    turns : int
        Number of changes of the roll angle on this path.
    reached : bool
        Whether this path ends in the target.
    shift_cost, tilt_cost : float
        Largest loss of success, by the table, if the entry is shifted by 2 mm across the axis, or tilted by 2 degrees.
    expected_success : float
        Value of `success` less the expected loss by an error of the entry; see `EntryMap.expected_success`.
    """

    position_mm: tuple[float, float, float]
    direction: tuple[float, float, float]
    success: Success
    table_success: float
    clearance_mm: float
    length_mm: float
    turns: int
    reached: bool
    shift_cost: float
    tilt_cost: float
    expected_success: float

    def record(self) -> dict[str, Any]:
        """Return the JSON record of the entry: all fields by name, and the keys of `Success.record` for `success`."""
        numbers = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "success"}
        return {**numbers, **self.success.record()}


@dataclass(frozen=True, eq=False)
class EntryMap(ShortRepr):
    """The entry points of an anatomy, each with its best direction.

    Parameters
    ----------
    table : SpaceTable
        The plan.
    poses : numpy.ndarray
        Entry points in the frame (mm) and best directions, shape (n, 6).
    success, value : numpy.ndarray
        Success by the table and cost of each, shape (n,).
    paths : SpacePaths
        Executions without noise.
    impossible : bool
        Whether no path exists from any point of the entry region, in any direction of the cone: a proof for the file.
    stats : dict
        Shape of the tables, number of states, seconds.
    """

    table: SpaceTable
    poses: NDArray[np.float64]
    success: NDArray[np.float64]
    value: NDArray[np.float64]
    paths: SpacePaths
    impossible: bool
    stats: dict[str, Any]

    @property
    def grid(self) -> AnatomyGrid:
        """The anatomy on the lattice."""
        return self.table.scenario.grid

    @property
    def solved(self) -> _ppvi.SolvedSpace | PartialSpace:
        """Values, policy and success of `table`, as the compiled solver holds them."""
        return self.table.solved

    @property
    def ranking(self) -> EntryRanking:
        """The ranking of the entry points."""
        return self.table.ranking

    @property
    def order(self) -> NDArray[np.int64]:
        """Numbers of the entry points, best first: by success at the exact pose, rounded to 0.1 %, then by cost."""
        return self.ranking.order

    @property
    def reachable(self) -> bool:
        """Whether an entry point reaches the target in at least 0.1 % of executions."""
        return bool(self.success.max() >= UNREACHABLE)

    def success_field(self) -> NDArray[np.float32]:
        """Return the success of the best direction at every grid point, shape (nx, ny, nz), to get an overview.

        At entry points it is `success`, or the estimate by executions where that is known and differs by more than 3
        percentage points. Elsewhere it is the largest stored success of a direction, without a look
        ahead, which may be off by tens of percentage points near obstacles. It is 0 in obstacles and outside, and 1 in
        the target.
        """
        best = np.zeros(self.grid.codes.shape, np.float32)
        for number, slice_ in enumerate(self.solved.success):
            best[number] = slice_.max(0) / SUCCESS_STEPS
        best[self.grid.codes >= OBSTACLE] = 0
        best[self.grid.codes == TARGET] = 1
        best[tuple(self.grid.nearest_points(self.poses[:, :3]).T)] = self.exported_success()
        return best

    def first(self, *, exact: bool = False) -> int:
        """Return the number of the best entry, which `SpaceTable.best_entry` returns; `exact` as in `best`."""
        return self.ranking.first(exact=exact)

    def best(self, count: int, apart_mm: float = 6.0, *, exact: bool = False) -> list[int]:
        """Return the numbers of the best entry points, best first.

        The table proposes at least five candidates. They are ordered by their expected success by executions, rounded
        to 0.1 %; candidates with equal success are ordered by clearance, length and rotations.

        Parameters
        ----------
        count : int
            Number of entry points.
        apart_mm : float, default 6.0
            Smallest distance between two of them (mm).
        exact : bool, default False
            Whether to rank by the success without an error of the entry.

        Returns
        -------
        list of int
        """
        return self.ranking.best(count, apart_mm, exact=exact)

    def expected_success(self, number: int) -> float:
        """Return the expected success of an entry if the needle enters with an error, by the table.

        The policy knows the pose with the error. The errors are normal and independent: 1 mm along each of two axes
        across the needle, and 1 degree about each. The mean over both shifts, and over both tilts, is a cubature of
        degree 5 (Stroud 1971): half of the weight is on the entry, the other half on a ring of two standard deviations.
        The losses by shift and tilt are added. The result is at most the success without an error.
        """
        return self.ranking.expected_success(number)

    def entry(self, number: int, runs: int | None = None) -> SpaceEntry:
        """Return an entry, with its success and the loss of success by errors of its pose.

        Parameters
        ----------
        number : int
            Number of the entry point.
        runs : int, optional
            Number of executions that estimate its success; 2,000 by default. 0: the result has `known_success`.

        Returns
        -------
        SpaceEntry
        """
        pose, frame, table = self.poses[number], self.grid.frame, float(self.success[number])
        success = self.known_success(number) if runs == 0 else self.estimate(number, runs)
        costs = [self.success[number] - nearby.min() for nearby in self.ranking.around(number)]
        (x, y, z), (u, v, w) = frame.world(pose[:3]).tolist(), (pose[3:] @ frame.axes).tolist()
        return SpaceEntry(
            position_mm=(x, y, z),
            direction=(u, v, w),
            success=success,
            table_success=table,
            clearance_mm=float(self.paths.clearance_mm[number]),
            length_mm=float(self.paths.length_mm[number]),
            turns=int(self.paths.turns[number]),
            reached=bool(self.paths.reached[number]),
            shift_cost=max(float(costs[0]), 0.0),
            tilt_cost=max(float(costs[1]), 0.0),
            expected_success=self.ranking.with_error(number, success),
        )

    def estimate(self, number: int, runs: int | None = None) -> Success:
        """Return the success of an entry as `SpaceTable.estimate` does.

        Parameters
        ----------
        number : int
            Number of the entry point.
        runs : int, optional
            Number of executions, at least 1; 2,000 by default. They are the same ones in every call.

        Returns
        -------
        Success

        Raises
        ------
        PoseError
            `runs` is out of range.
        """
        return self.ranking.estimate(number, runs)

    def known_success(self, number: int) -> Success:
        """Return the success of an entry by executions if it has been estimated, else by the table."""
        return self.ranking.known_success(number)

    def exported_success(self) -> NDArray[np.float64]:
        """Return the success of each entry point for files that have one number for each, shape (n,).

        It is the success by the table, or the estimate by executions where that is known and differs by more than 3
        percentage points.
        """
        known = [self.known_success(number).value for number in range(len(self.success))]
        return np.where(abs(known - self.success) > _DISAGREEMENT, known, self.success)

    def realised(self, number: int, runs: int = 1000, seed: int = 0) -> float:
        """Return the share of executions with noise from an entry that reach the target.

        Parameters
        ----------
        number : int
            Number of the entry point.
        runs : int, default 1000
            Number of executions.
        seed : int, default 0
            Seed of the noise.

        Returns
        -------
        float
            Share, from 0 to 1.
        """
        return self.table.rollout(self.poses[number], runs, seed).success

    def path_mm(self, number: int) -> NDArray[np.float64]:
        """Return the positions of the path without noise from an entry, in RAS mm, shape (m, 3)."""
        return self.grid.frame.world(self.paths.points(number))


def rank_entries(anatomy: Anatomy, *, threads: int | None = None, progress: Progress | None = None) -> EntryMap:
    """Solve an anatomy and rank its entries.

    Parameters
    ----------
    anatomy : Anatomy
        What is planned in.
    threads : int, optional
        Number of threads. Default: all processors.
    progress : callable, optional
        Called with reports of the solver. Default: none.

    Returns
    -------
    EntryMap

    Raises
    ------
    ScenarioError
        If target or entry region are not on the lattice, or the tables do not fit into the memory.
    """
    return entry_map(plan_space(SpaceScenario.of(anatomy), threads=threads, progress=progress), threads=threads)


def entry_map(table: SpaceTable, *, threads: int | None = None) -> EntryMap:
    """Return the map of the entries of a table.

    Parameters
    ----------
    table : SpaceTable
        Table in 3D.
    threads : int, optional
        Number of threads. Default: all processors.

    Returns
    -------
    EntryMap
    """
    scenario, poses = table.scenario, table.entry_poses
    success, value = table.ranking.success, table.ranking.value
    paths = space_paths(table.solved, scenario.grid, poses)
    impossible = bool(success.max() < UNREACHABLE) and _no_path(table, threads)
    stats = {"shape": list(table.shape), "states": table.stats.states, "seconds": table.stats.seconds}
    return EntryMap(table, poses, success, value, paths, impossible, stats)


def _no_path(table: SpaceTable, threads: int | None) -> bool:
    """Return whether no path leads from the entry region of the file to the target, in any direction of the cone.

    Obstacles are those of the file, neither grown nor rounded up to voxels (`needleplan.anatomy.possible_codes`). A
    path that begins between two slices passes the next slice at most `lateral_cells` cells from its start. The
    directions of the cone are divided into squares of slopes (dy/dx, dz/dx). Each start cell is tested with the centre
    of every square that the cone touches; `_ppvi.impossible` answers for all points and slopes of cell and square.
    """
    from scipy import ndimage

    scenario, grid = table.scenario, table.scenario.grid
    codes, steepest = possible_codes(grid.possible), math.tan(scenario.cone_rad)
    lateral_cells = math.ceil(steepest) + 1
    neighbours = np.ones((3, 2 * lateral_cells + 1, 2 * lateral_cells + 1), bool)
    starts = ndimage.binary_dilation(entered_cells(grid.possible), neighbours)
    if (starts & (codes == TARGET)).any():
        return False
    finer = codes.shape[0] // grid.frame.shape[0]
    spacing = grid.frame.spacing_mm / finer
    points = np.argwhere(starts & (codes == FREE)) * spacing
    if not len(points):
        return True
    reach = math.ceil(steepest / _SLOPES + 0.5)
    squares = _SLOPES * np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), -1).reshape(-1, 2)
    nearest = np.maximum(abs(squares) - _SLOPES / 2, 0)
    squares = squares[np.hypot(*nearest.T) <= steepest]
    tangents = np.concatenate([np.ones((len(squares), 1)), squares], -1)
    tangents /= np.linalg.norm(tangents, axis=-1)[:, None]
    at_once = max(1, _CELLS_AT_ONCE // len(squares))
    for part in np.array_split(points, math.ceil(len(points) / at_once)):
        poses = np.concatenate([np.repeat(part, len(squares), 0), np.tile(tangents, (len(part), 1))], -1)
        is_impossible = _ppvi.impossible(
            poses,
            voxels=codes,
            spacing_mm=[spacing] * 3,
            curvature_radii_mm=list(grid.radii_mm),
            cone_rad=scenario.cone_rad,
            slopes=_SLOPES,
            advance=finer * scenario.advance,
            threads=threads,
        )
        if not is_impossible.all():
            return False
    return True
