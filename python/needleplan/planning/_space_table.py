"""The 3D policy table: best action, expected cost and success for every position and direction of the tip."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from needleplan.anatomy import SpaceScenario, target_slices
from needleplan.artifacts import short_html
from needleplan.errors import Mistake, OutputError, PoseError, TableError
from needleplan.planning._contract import Table
from needleplan.planning._drawing import draw_success_slice
from needleplan.planning._execution import SAMPLES, Rollouts, rollouts_of
from needleplan.planning._labelled import labelled_dataset
from needleplan.planning._lattice import Status
from needleplan.planning._lookup import Decisions
from needleplan.planning._poses import Entry
from needleplan.planning._space_estimates import SEED, Estimates
from needleplan.planning._space_file import SpaceContent, write_space
from needleplan.planning._space_input import MOST_RUNS, pose_numbers, pose_rows, run_number, seed_number, thread_number
from needleplan.planning._space_limits import KeptEntries, kept_entries
from needleplan.planning._space_part import PartialSpace
from needleplan.planning._space_path import SpacePath, SpacePaths, space_paths, valid_poses
from needleplan.planning._space_places import SUCCESS_STEPS, TYPES
from needleplan.planning._space_pose import SpacePose
from needleplan.planning._space_problem import space_of
from needleplan.planning._space_ranking import ESTIMATE_RUNS, EntryRanking
from needleplan.planning._space_truth import reached_in_space, scattered_space_poses
from needleplan.planning._success import Success
from needleplan.planning._table_file import array_digests, table_digest
from needleplan.plotting import axes_or_new, picture_html

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    import xarray
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from needleplan import _ppvi
    from needleplan.planning._plane_file import PlaneContent
    from needleplan.planning._promise import Truths
    from needleplan.planning._uncertainty import Uncertainty
    from needleplan.signals import RigidError

__all__ = ["SpaceDecision", "SpaceStats", "SpaceTable"]

# Angle (rad) outside of the cone up to which a tangent is turned to the rim, and its angle inside of the rim then.
_BEYOND_RAD, _INSIDE_RAD = math.radians(10.0), 1e-6
_SAME_AXES = 1e-6  # largest difference between the components of equal axes of two lattices
# Largest number of executions with their points; limited by memory.
_MOST_DRAWN = 100_000


class SpaceDecision(NamedTuple):
    """Best action at a pose, with its expected cost and success; `roll_rad` is None for a straight step.

    At the roll angle a the needle bends towards cos(a) e1 + sin(a) e2, where e1 and e2 are y and z after the shortest
    rotation of the x axis to the tangent.
    """

    action: int
    roll_rad: float | None
    value: float
    success: float

    def _repr_html_(self) -> str:
        return short_html(self)


@dataclass(frozen=True)
class SpaceStats:
    """How a solve went: number of states, status ("converged" if it is complete), and duration (s)."""

    states: int
    status: Status
    seconds: float


@dataclass(frozen=True, eq=False, repr=False)
class SpaceTable(Table):
    """Optimal cost-to-go, policy and success of every state of a scenario in 3D.

    Parameters
    ----------
    scenario : SpaceScenario
        What was planned.
    solved : needleplan._ppvi.SolvedSpace or PartialSpace
        The tables, with the shape (slices, directions, ny, nz), or those of a part of the lattice.
    known_digests : dict, optional
        SHA-256 of `values`, `policy` and `success`. Default: computed when they are asked for.
    known_estimates : numpy.ndarray, optional
        Rows of the estimates of success that are known, from a file. Default: none.
    entry_points_mm : numpy.ndarray, optional
        Entry points (mm), shape (n, 3), before the limits. Default: those of the grid.
    """

    scenario: SpaceScenario
    solved: _ppvi.SolvedSpace | PartialSpace
    known_digests: dict[str, str] | None = None
    known_estimates: NDArray[np.float64] | None = None
    entry_points_mm: NDArray[np.float64] | None = None

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of slices, directions, and grid points along y and z."""
        slices, directions, ny, nz = self.space.shape
        return slices, directions, ny, nz

    def _repr_html_(self) -> str:
        return picture_html(self.scenario.workspace, self.plot, repr(self))

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.shape))
        return f'<SpaceTable "{self.scenario.title}": {size} = {math.prod(self.shape):,} states, {self.stats.status}>'

    @cached_property
    def space(self) -> _ppvi.Space:
        """The compiled problem."""
        return space_of(self.scenario)

    @cached_property
    def stats(self) -> SpaceStats:
        """Statistics of the solve: backups, status and duration."""
        report = self.solved.report()
        return SpaceStats(int(report["backups"]), Status(report["status"]), float(report["seconds"]))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scenario's digest and the three arrays; other files refer to the table by this digest."""
        return table_digest(self.scenario.digest, self._digests)

    @cached_property
    def _digests(self) -> dict[str, str]:
        return self.known_digests or array_digests({name: getattr(self.solved, name) for name in TYPES})

    def contains(self, pose: SpacePose) -> bool:
        """Return whether a pose lies in the lattice and in the cone of directions."""
        return bool(self._contained(np.array([pose], np.float64))[0])

    def clamped(self, pose: SpacePose) -> SpacePose:
        """Return the pose; a tangent that is at most 10 degrees outside of the cone is turned to its rim."""
        angle, rim = math.atan2(math.hypot(pose.dy, pose.dz), pose.dx), self.scenario.cone_rad - _INSIDE_RAD
        if not rim < angle <= self.scenario.cone_rad + _BEYOND_RAD:
            return pose
        across = math.sin(rim) / math.hypot(pose.dy, pose.dz)
        return pose._replace(dx=math.cos(rim), dy=across * pose.dy, dz=across * pose.dz)

    def lookup(self, pose: Entry[SpacePose] | SpacePose | Sequence[float]) -> SpaceDecision:
        """Return the decision at a pose, by a look one step ahead in the continuous model.

        `success` is taken from the table, in about 1 ms. The success of `estimate` has no error of the grid.

        Raises PoseError if the pose is not a position and a unit tangent, or outside the lattice or the cone.
        """
        row = self._row(pose)
        answers = self.solved.look_up(row)
        action, rolls = int(answers["action"][0]), self.scenario.file.lattice.rolls
        roll = 2 * math.pi * action / rolls if action < rolls else None
        return SpaceDecision(action, roll, float(answers["value"][0]), float(answers["success"][0]))

    def lookup_many(self, poses: ArrayLike) -> Decisions:
        """Return the decisions of `lookup` at many poses, shape (n, 6).

        Actions are numbers of roll angles; the number of roll angles is the straight step. Raises PoseError.
        """
        rows = pose_rows(poses)
        wrong = ~self._contained(rows)
        if wrong.any():
            raise PoseError(self._mistake(f"poses[{int(wrong.argmax())}]", rows[wrong.argmax()]))
        answers = self.solved.look_up(rows)
        return Decisions(answers["action"], *(answers[name].astype(np.float32) for name in ("value", "success")))

    def start(self, pose: Entry[SpacePose] | SpacePose | Sequence[float]) -> SpacePose:
        """Return the pose at which an execution begins. Raises the PoseErrors of `lookup`."""
        return SpacePose(*self._row(pose)[0].tolist())

    def path(
        self, start: Entry[SpacePose] | SpacePose | Sequence[float], *, noise_seed: int | None = None
    ) -> SpacePath:
        """Execute the policy once from a pose, and return the path.

        There is no tip noise if `noise_seed` is None; else the path is the first run of `rollout` with this seed.
        Raises the PoseErrors of `lookup`.
        """
        seed = None if noise_seed is None else seed_number(noise_seed)
        return space_paths(self.solved, self.scenario.grid, self._row(start), seed).path(0, self.scenario)

    def executions(
        self, start: Entry[SpacePose] | SpacePose | Sequence[float], runs: int = 40, seed: int = 0
    ) -> SpacePaths:
        """Return the first executions of `rollout`, with their points.

        Parameters
        ----------
        start : Entry, SpacePose or sequence of float
            Entry or pose at which the executions start.
        runs : int, default 40
            Number of executions, at most 100,000.
        seed : int, default 0
            Seed of the noise.

        Returns
        -------
        SpacePaths

        Raises
        ------
        PoseError
            The start is not valid, as in `lookup`, or `runs` or `seed` is out of range.
        """
        poses = np.repeat(self._row(start), run_number(runs, _MOST_DRAWN), 0)
        return space_paths(self.solved, self.scenario.grid, poses, seed_number(seed))

    def rollout(
        self, start: Entry[SpacePose] | SpacePose | Sequence[float], runs: int = 10_000, seed: int = 0
    ) -> Rollouts[SpacePose]:
        """Execute the policy many times with tip noise, and return the statistics.

        Raises the PoseErrors of `lookup`, and PoseError if `runs` is not a whole number from 1 to 50,000,000 or
        `seed` is negative.
        """
        runs, seed, row = run_number(runs, MOST_RUNS), seed_number(seed), self._row(start)
        executed, predicted = self.solved.rollout(row, runs=runs, seed=seed), self.solved.look_up(row)
        samples = self.executions(start, min(runs, SAMPLES), seed)
        return rollouts_of(
            executed,
            start=SpacePose(*row[0].tolist()),
            seed=seed,
            predicted_success=float(predicted["success"][0]),
            predicted_value=float(predicted["value"][0]),
            samples=tuple(samples.path(run, self.scenario) for run in range(len(samples.reached))),
            scenario=self.scenario,
        )

    def estimate(
        self,
        start: Entry[SpacePose] | SpacePose | Sequence[float],
        runs: int = ESTIMATE_RUNS,
        seed: int = 0,
        *,
        threads: int | None = None,
    ) -> Success:
        """Estimate the success from a pose by executions in the continuous model, with the table as a control variate.

        The estimate is unbiased, whatever the errors of the table are, and its variance is about a quarter of that of
        the share of as many executions (docs/explanation/space.md). Its random numbers differ from those of `rollout`
        and `executions` for every seed, so both check the estimate independently.

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
        row = self._row(start)
        known = self.estimates.find(row[0], runs) if seed == SEED else None
        return known or Success.of_executions(self.solved.estimate(row, runs=runs, seed=seed, threads=threads))

    def _exact_success(self, pose: Any, executions: int, seed: int) -> Success:
        return self.estimate(pose, executions, seed)

    def _scattered(self, pose: Any, uncertainty: Uncertainty, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        shift = uncertainty.entry_sd_mm * numbers[:, :2]
        tilt = math.radians(uncertainty.heading_sd_deg) * numbers[:, 2:]
        return scattered_space_poses(self.scenario, self._row(pose)[0], shift, tilt)

    def _error_in_plan(self, error: RigidError) -> RigidError:
        frame = self.scenario.grid.frame
        return error.moved(frame.axes, frame.origin_mm)

    def _reached(self, starts: NDArray[np.float64], truths: Truths, seed: int) -> NDArray[np.bool_]:
        places = np.where(self._contained(starts)[:, None], starts, np.nan)
        return reached_in_space(self.solved, self.scenario, places, truths, seed)

    @cached_property
    def estimates(self) -> Estimates:
        """The estimates of success that were made to rank entries, which `write` keeps in the file."""
        return Estimates.of(self.solved, self.known_estimates)

    @property
    def entry_poses(self) -> NDArray[np.float64]:
        """Entry points within the limits, with the permitted direction of the least cost, shape (n, 6)."""
        return self.kept_entries.poses

    @cached_property
    def kept_entries(self) -> KeptEntries:
        """The entries within the limits of the file, and how many each limit leaves. Raises ScenarioError."""
        points = self.scenario.grid.entry_points_mm() if self.entry_points_mm is None else self.entry_points_mm
        return kept_entries(self.scenario, self.solved, np.asarray(self.space.tangents()), points)

    def best_entry(self, *, exact: bool = False) -> Entry[SpacePose]:
        """Return the best entry, as `EntryMap.first` and `needleplan entry` do.

        Executions decide between the candidates (`EntryRanking.best`). This takes some seconds, unless a file of
        `needleplan plan` holds their results. If `exact`, the success is that without an error of the entry.
        """
        return self._entry(self.ranking.first(exact=exact))

    def entries(self, count: int = 5, apart_mm: float = 6.0) -> list[Entry[SpacePose]]:
        """Return the best entries that are at least `apart_mm` from each other, best first, as `EntryRanking.best`."""
        return [self._entry(number) for number in self.ranking.best(count, apart_mm)]

    def _entry(self, number: int) -> Entry[SpacePose]:
        pose = SpacePose(*self.entry_poses[number].tolist())
        return Entry(pose, float(self.ranking.success[number]), float(self.ranking.value[number]))

    @cached_property
    def ranking(self) -> EntryRanking:
        """The ranking of the entry points, with the estimates that were made for it."""
        return EntryRanking.of(self.scenario, self.solved, self.entry_poses, self.estimates)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the success in the best direction on the slice across z through the target, with the bodies in it."""
        axes = axes_or_new(ax, self.scenario.workspace)
        self.scenario.plot(axes)
        number = dict(target_slices(self.scenario.grid))[2]
        shown = self.solved.success[:, :, :, number].max(axis=1) / SUCCESS_STEPS
        draw_success_slice(axes, self.scenario.grid, number, shown)
        return axes

    def to_xarray(self) -> xarray.Dataset:
        """Return the table as an xarray dataset over x, direction, y and z (mm). Raises InputError without xarray."""
        frame, tangents = self.scenario.grid.frame, np.asarray(self.space.tangents())
        points = [np.arange(count) * frame.spacing_mm for count in frame.shape]
        axes = {"x": (points[0], "mm"), "direction": (np.arange(len(tangents)), "1"),
                "y": (points[1], "mm"), "z": (points[2], "mm")}  # fmt: skip
        arrays: dict[str, tuple[NDArray[Any], str, str]] = {
            "values": (self.solved.values, "expected cost", "cost"),
            "policy": (self.solved.policy, "number of the roll angle; the number of roll angles: straight", "1"),
            "success": (self.solved.success / np.float32(SUCCESS_STEPS), "probability of reaching the target", "1"),
        }
        extra = {f"d{name}": ("direction", tangents[:, axis]) for axis, name in enumerate("xyz")}
        return labelled_dataset(arrays, axes, self.scenario, self.digest).assign_coords(extra)

    def _write(self, path: str | os.PathLike[str], key: bytes | None, compressed: bool) -> None:
        if isinstance(self.solved, PartialSpace):
            raise OutputError(Mistake("table", os.fspath(path), "must be a plan of the whole lattice"))
        content = SpaceContent(self.scenario, self.space, self.solved, self._digests, self.estimates.rows())
        write_space(path, content, key, compressed=compressed)

    @classmethod
    def of_content(cls, content: SpaceContent) -> Self:
        """Return the table of the content of a file."""
        return cls(content.scenario, content.solved, content.digests, content.estimates)

    @classmethod
    def _of(cls, content: PlaneContent | SpaceContent) -> Self | None:
        return cls.of_content(content) if isinstance(content, SpaceContent) else None

    def moved_to(self, scenario: SpaceScenario) -> SpaceTable:
        """Return this table for a scenario of the same anatomy, whose lattice begins at another point.

        The lattice depends on the curvature; poses of the table that is returned are in the frame of `scenario`. Raises
        TableError if axes or spacing differ.
        """
        present, its = self.scenario.grid.frame, scenario.grid.frame
        if present.spacing_mm != its.spacing_mm or not np.allclose(present.axes, its.axes, atol=_SAME_AXES):
            raise TableError(Mistake("table", self.scenario.title, "has other axes or another spacing"))
        if isinstance(self.solved, PartialSpace):
            raise TableError(Mistake("table", self.scenario.title, "must be a plan of the whole lattice"))
        corner, voxel = its.local(present.origin_mm), self.scenario.grid.voxel_mm
        return SpaceTable(scenario, PartialSpace(self.solved, corner, present.spacing_mm, present.shape, voxel))

    def _contained(self, rows: NDArray[np.float64]) -> NDArray[np.bool_]:
        known = valid_poses(self.scenario.grid, self.scenario.cone_rad, rows)
        return known & self.solved.contains(rows[:, :3]) if isinstance(self.solved, PartialSpace) else known

    def _mistake(self, key: str, row: NDArray[np.float64]) -> Mistake:
        rule = f"must lie in the lattice, with a tangent in the cone of {self.scenario.file.lattice.cone_deg:g} deg"
        return Mistake(key, str(SpacePose(*row.tolist())), rule)

    def _row(self, pose: Entry[SpacePose] | SpacePose | Sequence[float]) -> NDArray[np.float64]:
        row = pose_numbers(pose.pose if isinstance(pose, Entry) else pose)[None]
        if not self._contained(row)[0]:
            raise PoseError(self._mistake("pose", row[0]))
        return row
