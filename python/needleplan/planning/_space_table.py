"""The 3D policy table: best action, expected cost and success for every position and direction of the tip."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from needleplan.anatomy import SpaceScenario
from needleplan.errors import Mistake, OutputError, PoseError, ScenarioError, TableError
from needleplan.planning._lattice import Status, compiled_call
from needleplan.planning._space_file import (
    SpaceContent,
    read_space,
    solved_in_file,
    space_digest,
    table_digests,
    write_space,
)
from needleplan.planning._space_input import MOST_RUNS, pose_numbers, run_number, seed_number, thread_number
from needleplan.planning._space_part import PartialSpace, part_ahead
from needleplan.planning._space_path import SpacePaths, normals, space_paths, valid_poses
from needleplan.planning._space_places import TYPES, exceeds_memory
from needleplan.planning._space_problem import space_of
from needleplan.planning._space_ranking import ESTIMATE_RUNS, EntryRanking
from needleplan.planning._success import Success

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from needleplan import _ppvi

__all__ = [
    "SpaceDecision",
    "SpacePose",
    "SpaceStats",
    "SpaceTable",
    "SpaceTask",
    "plan_ahead",
    "plan_space",
]

# Angle (rad) outside of the cone up to which a tangent is turned to the rim, and its angle inside of the rim then.
_BEYOND_RAD, _INSIDE_RAD = math.radians(10.0), 1e-6
_SAME_AXES = 1e-6  # largest difference between the components of equal axes of two lattices
# Largest number of executions with their points; limited by memory.
_MOST_DRAWN = 100_000


class SpacePose(NamedTuple):
    """Position (mm) and unit tangent of the tip in the frame of the lattice; `SpaceFrame` converts from and to RAS."""

    x_mm: float
    y_mm: float
    z_mm: float
    dx: float
    dy: float
    dz: float

    @property
    def position_mm(self) -> tuple[float, float, float]:
        """The position."""
        return self.x_mm, self.y_mm, self.z_mm

    @property
    def tangent(self) -> tuple[float, float, float]:
        """The unit tangent."""
        return self.dx, self.dy, self.dz

    def __str__(self) -> str:
        heading, elevation = (math.degrees(each) for each in self.angles_rad)
        return (
            f"lattice x {self.x_mm:.2f} mm, y {self.y_mm:.2f} mm, z {self.z_mm:.2f} mm, heading {heading:.1f} deg, "
            f"elevation {elevation:.1f} deg"
        )

    @property
    def angles_rad(self) -> tuple[float, float]:
        """Heading of the tangent from +x to +y, and elevation towards +z."""
        return math.atan2(self.dy, self.dx), math.atan2(self.dz, math.hypot(self.dx, self.dy))


class SpaceDecision(NamedTuple):
    """Best action at a pose, with its expected cost and success; `roll_rad` is None for a straight step.

    At the roll angle a the needle bends towards cos(a) e1 + sin(a) e2, where e1 and e2 are y and z after the shortest
    rotation of the x axis to the tangent.
    """

    action: int
    roll_rad: float | None
    value: float
    success: float


@dataclass(frozen=True)
class SpaceStats:
    """How a solve went: number of states, status ("converged" if it is complete), and duration (s)."""

    states: int
    status: Status
    seconds: float


@dataclass(frozen=True, eq=False, repr=False)
class SpaceTable:
    """Optimal cost-to-go, policy and success of every state of a scenario in 3D.

    Parameters
    ----------
    scenario : SpaceScenario
        What was planned.
    solved : needleplan._ppvi.SolvedSpace or PartialSpace
        The tables, with the shape (slices, directions, ny, nz), or those of a part of the lattice.
    known_digests : dict, optional
        SHA-256 of `values`, `policy` and `success`. Default: computed when they are asked for.
    """

    scenario: SpaceScenario
    solved: _ppvi.SolvedSpace | PartialSpace
    known_digests: dict[str, str] | None = None

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of slices, directions, and grid points along y and z."""
        slices, directions, ny, nz = self.space.shape
        return slices, directions, ny, nz

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.shape))
        return f'<SpaceTable "{self.scenario.title}": {size} = {math.prod(self.shape):,} states, {self.stats.status}>'

    @cached_property
    def space(self) -> _ppvi.Space:
        """The compiled problem."""
        return space_of(self.scenario)

    @cached_property
    def stats(self) -> SpaceStats:
        """How the solve went."""
        report = self.solved.report()
        return SpaceStats(int(report["backups"]), Status(report["status"]), float(report["seconds"]))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scenario's digest and the three arrays; other files refer to the table by this digest."""
        return space_digest(self.scenario, self._digests)

    @cached_property
    def _digests(self) -> dict[str, str]:
        return self.known_digests or table_digests({name: getattr(self.solved, name) for name in TYPES})

    def contains(self, pose: SpacePose) -> bool:
        """Return whether a pose lies in the lattice and in the cone of directions."""
        known = bool(valid_poses(self.scenario.grid, self.scenario.cone_rad, np.array([pose], np.float64))[0])
        return known and not (isinstance(self.solved, PartialSpace) and not self.solved.contains(pose.position_mm))

    def clamped(self, pose: SpacePose) -> SpacePose:
        """Return the pose; a tangent that is at most 10 degrees outside of the cone is turned to its rim."""
        angle, rim = math.atan2(math.hypot(pose.dy, pose.dz), pose.dx), self.scenario.cone_rad - _INSIDE_RAD
        if not rim < angle <= self.scenario.cone_rad + _BEYOND_RAD:
            return pose
        across = math.sin(rim) / math.hypot(pose.dy, pose.dz)
        return pose._replace(dx=math.cos(rim), dy=across * pose.dy, dz=across * pose.dz)

    def lookup(self, pose: SpacePose | Sequence[float]) -> SpaceDecision:
        """Return the decision at a pose, by a look one step ahead in the continuous model.

        `success` is that of the table, which takes about 1 ms; `estimate` has no error of the grid.

        Raises PoseError if the pose is no position and unit tangent, or outside the lattice or the cone.
        """
        row = self._row(pose)
        found = self.solved.look_up(row)
        action, rolls = int(found["action"][0]), self.scenario.file.lattice.rolls
        roll = 2 * math.pi * action / rolls if action < rolls else None
        return SpaceDecision(action, roll, float(found["value"][0]), float(found["success"][0]))

    def path(self, start: SpacePose | Sequence[float]) -> SpacePaths:
        """Return the execution without noise from a pose. Raises PoseError as `lookup`."""
        return space_paths(self.solved, self.scenario.grid, self.scenario.file.lattice, self._row(start))

    def executions(self, start: SpacePose | Sequence[float], runs: int = 40, seed: int = 0) -> SpacePaths:
        """Return seeded executions with noise, with their points; `rollout` is faster and makes other runs.

        Raises PoseError as `rollout`; `runs` is at most 100,000.
        """
        random, noise = np.random.default_rng(seed_number(seed)), self.scenario.noise_rad_sqrt_mm

        def disturbed(tangents: NDArray[np.float64], lengths_mm: NDArray[np.float64]) -> NDArray[np.float64]:
            # Two normal angles across the tangent; the tangent turns by the length of this vector, towards it.
            angles = random.standard_normal((len(tangents), 2)) * (noise * np.sqrt(lengths_mm))[:, None]
            size = np.hypot(*angles.T)
            across = normals(tangents, np.arctan2(angles[:, 1], angles[:, 0]))
            return np.asarray(tangents * np.cos(size)[:, None] + across * np.sin(size)[:, None])

        poses = np.repeat(self._row(start), run_number(runs, _MOST_DRAWN), 0)
        return space_paths(self.solved, self.scenario.grid, self.scenario.file.lattice, poses, disturbed)

    def rollout(self, start: SpacePose | Sequence[float], runs: int = 10_000, seed: int = 0) -> dict[str, NDArray[Any]]:
        """Return seeded executions with noise: `success`, `length_mm`, `rotations`, `cost`, each of the shape (runs,).

        Raises PoseError as `lookup`, and for `runs` that is no whole number from 1 to 50,000,000 or a negative `seed`.
        """
        return self.solved.rollout(self._row(start), runs=run_number(runs, MOST_RUNS), seed=seed_number(seed))

    def estimate(
        self,
        start: SpacePose | Sequence[float],
        runs: int = ESTIMATE_RUNS,
        seed: int = 0,
        *,
        threads: int | None = None,
    ) -> Success:
        """Estimate the success from a pose by executions in the continuous model, with the table as a control variate.

        The estimate is unbiased, whatever the errors of the table are, and its variance is about a quarter of that of
        the share of as many executions (docs/explanation/space.md). Its random numbers differ from those of `rollout`
        and `executions`, whatever the seeds, so these check it independently.

        Parameters
        ----------
        start : SpacePose or sequence of float
            Position (mm) and tangent.
        runs : int, optional
            From 1 to 50,000,000 executions. Default: 2,000, for a standard error below 0.7 percentage points.
        seed : int, optional
            From 0. The same seed gives the same estimate. Default: 0.
        threads : int, optional
            Number of threads. Default: all processors.

        Returns
        -------
        Success

        Raises
        ------
        PoseError
            If the pose is outside the lattice or the cone, or `runs`, `seed` or `threads` is no such whole number.
        """
        runs, seed, threads = run_number(runs, MOST_RUNS), seed_number(seed), thread_number(threads)
        numbers = self.solved.estimate(self._row(start), runs=runs, seed=seed, threads=threads)
        return Success.of_executions(numbers)

    @cached_property
    def entry_poses(self) -> NDArray[np.float64]:
        """Entry points with the direction of the least cost, shape (n, 6)."""
        points, grid = self.scenario.grid.entry_points_mm(), self.scenario.grid
        nearest = grid.nearest_points(points)
        i, j, k = nearest.T
        best = self.solved.values[i, :, j, k].argmin(-1)
        tangents = np.asarray(self.space.tangents())
        between = np.flatnonzero((abs(points - nearest * grid.frame.spacing_mm) > 1e-9).any(-1))
        for place in between.tolist():
            poses = np.concatenate([np.repeat(points[place : place + 1], len(tangents), 0), tangents], -1)
            best[place] = self.solved.decide(poses)["value"].argmin()
        return np.concatenate([points, tangents[best]], -1)

    def best_entry(self, *, exact: bool = False) -> SpacePose:
        """Return the best entry, as `EntryMap.first` and `needleplan entry` do.

        It is the first of the entries that are compared by executions (`EntryRanking.best`), which takes some seconds.
        If `exact`, they are compared by their success without an error of the entry.
        """
        return SpacePose(*self.entry_poses[self.ranking.first(exact=exact)].tolist())

    @cached_property
    def ranking(self) -> EntryRanking:
        """The ranking of the entry points, with the estimates that were made for it."""
        return EntryRanking.of(self.scenario, self.solved, self.entry_poses)

    def write(self, path: str | os.PathLike[str], *, sign_key: bytes | None = None, compressed: bool = False) -> None:
        """Write the table to an HDF5 file. Raises OutputError if it cannot be written, or the solve was not complete.

        If `compressed`, the arrays are compressed without loss (gzip); the file is about a fifth as large.
        """
        if isinstance(self.solved, PartialSpace):
            raise OutputError(Mistake("table", os.fspath(path), "must be a plan of the whole lattice"))
        content = SpaceContent(self.scenario, self.space, self.solved, self._digests)
        write_space(path, content, sign_key, compressed=compressed)

    @staticmethod
    def read(
        path: str | os.PathLike[str], *, verify_key: bytes | None = None, mapped: bool | None = None
    ) -> SpaceTable:
        """Read a table file. Raises TableError if the file is no such table, ChecksumError if bytes have changed.

        A table that needs more than half of the available memory is verified in pieces and mapped into memory; so is
        every table if `mapped` is true, and none if it is false. While a table is mapped, its file may be replaced or
        removed, but must not be changed in place. Answers are the same. Compressed tables are always loaded.
        """
        return _table_of(read_space(path, verify_key, mapped=mapped))

    def moved_to(self, scenario: SpaceScenario) -> SpaceTable:
        """Return this table for a scenario of the same anatomy, whose lattice begins at another point.

        The lattice depends on the curvature; poses of the table that is returned are in the frame of `scenario`. Raises
        TableError if axes or spacing differ.
        """
        own, its = self.scenario.grid.frame, scenario.grid.frame
        if own.spacing_mm != its.spacing_mm or not np.allclose(own.axes, its.axes, atol=_SAME_AXES):
            raise TableError(Mistake("table", self.scenario.title, "has other axes or another spacing"))
        if isinstance(self.solved, PartialSpace):
            raise TableError(Mistake("table", self.scenario.title, "must be a plan of the whole lattice"))
        return SpaceTable(scenario, PartialSpace(self.solved, its.local(own.origin_mm), own.spacing_mm, own.shape))

    def _row(self, pose: SpacePose | Sequence[float]) -> NDArray[np.float64]:
        row = pose_numbers(pose)
        if not self.contains(SpacePose(*row.tolist())):
            rule = f"must lie in the lattice, with a tangent in the cone of {self.scenario.file.lattice.cone_deg:g} deg"
            raise PoseError(Mistake("pose", str(SpacePose(*row.tolist())), rule))
        return row[None]


@dataclass(frozen=True)
class SpaceTask:
    """A plan to make during an insertion: a scenario, and the pose from which on it is needed."""

    scenario: SpaceScenario
    start: SpacePose


def plan_ahead(task: SpaceTask, *, threads: int | None = None) -> SpaceTable:
    """Return the plan of the part of a lattice that a path from a pose on can use; see `_space_part.py`."""
    part, corner = part_ahead(task.scenario, task.start.position_mm)
    solved, spacing = space_of(part).solve(threads=threads), part.grid.frame.spacing_mm
    return SpaceTable(
        task.scenario, PartialSpace(solved, corner.astype(np.float64) * spacing, spacing, part.grid.frame.shape)
    )


def plan_space(
    scenario: SpaceScenario,
    *,
    file: str | os.PathLike[str] | None = None,
    sign_key: bytes | None = None,
    streamed: bool | None = None,
    threads: int | None = None,
    progress: Any = None,
) -> SpaceTable:
    """Solve a scenario in 3D.

    Parameters
    ----------
    scenario : SpaceScenario
        What is planned.
    file : path, optional
        File that the table is written to, as by `SpaceTable.write`. Default: none.
    sign_key : bytes, optional
        Secret key that signs the file. Default: not signed.
    streamed : bool, optional
        Whether each slice is written to `file`, or to a temporary file, when it is finished, so that the tables need no
        memory. Default: if they need more than half of the available memory.
    threads : int, optional
        Number of threads. Default: all processors.
    progress : callable, optional
        Called with reports of the solver. Default: none.

    Returns
    -------
    SpaceTable
        Mapped from the file if `streamed`.

    Raises
    ------
    ScenarioError
        If the problem cannot be compiled.
    OutputError
        If the file cannot be written, or `progress` ended a solve that writes a file. A file that was there before is
        then unchanged.
    """
    space = space_of(scenario)
    if exceeds_memory(tuple(space.shape)) if streamed is None else streamed:
        return _table_of(solved_in_file(scenario, space, file, sign_key, threads=threads, progress=progress))
    table = SpaceTable(scenario, compiled_call(ScenarioError, space.solve, threads=threads, progress=progress))
    if file is not None:
        table.write(file, sign_key=sign_key)
    return table


def _table_of(content: SpaceContent) -> SpaceTable:
    return SpaceTable(content.scenario, content.solved, content.digests)
