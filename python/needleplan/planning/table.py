"""The policy table: for every pose of the tip what to do, what it will cost, and how likely it is to succeed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from needleplan import _ppvi
from needleplan.artifacts import digest
from needleplan.errors import Mistake, PoseError, TableError
from needleplan.planning import entry, execution, table_file
from needleplan.planning.lattice import lattice_of
from needleplan.planning.pose import Action, Pose
from needleplan.planning.stats import Stats
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Decision", "Decisions", "Expectations", "PolicyTable"]


@dataclass(frozen=True)
class Decision:
    """What to do at one pose, the expected cost from there, and the probability of reaching the target."""

    action: Action
    value: float
    success: float


class Decisions(NamedTuple):
    """What to do at many poses: arrays [n] of 0 (insert) or 1 (rotate, then insert), of costs, of probabilities."""

    action: NDArray[np.uint8]
    value: NDArray[np.float32]
    success: NDArray[np.float32]


class Expectations(NamedTuple):
    """What an execution from each state takes on average: float32 [nx, ny, headings, 2], inf where it need not end.

    `length_mm` is the insertion length, `turns` the number of rotations; failures count with what they took.
    """

    length_mm: NDArray[np.float32]
    turns: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PolicyTable:
    """Optimal cost-to-go, policy and success probability of every state of a scenario.

    `values` float32, `policy` uint8 (0 insert, 1 rotate then insert) and `success` float32 are [nx, ny, headings, 2]
    and read-only; the last axis is bevel -1, bevel +1. Axes: `scenario.x_mm`, `scenario.y_mm`, `scenario.headings_rad`.
    """

    values: NDArray[np.float32]
    policy: NDArray[np.uint8]
    success: NDArray[np.float32]
    stats: Stats
    scenario: Scenario

    def __post_init__(self) -> None:
        for name, kind in (("values", np.float32), ("policy", np.uint8), ("success", np.float32)):
            array = getattr(self, name)
            if array.shape != self.scenario.shape or array.dtype != kind:
                rule = f"must be {np.dtype(kind).name} of the shape {self.scenario.shape}, as the scenario says"
                raise TableError(Mistake(name, f"{array.dtype} {array.shape}", rule))
            array.flags.writeable = False

    @cached_property
    def lattice(self) -> _ppvi.Lattice:
        """The compiled lattice of the scenario."""
        return lattice_of(self.scenario)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scenario's digest and the three tables, by which children of the table name it."""
        tables = (digest(array.data) for array in (self.values, self.policy, self.success))
        return digest("\n".join([self.scenario.digest, *tables]))

    def lookup(self, x_mm: float, y_mm: float, heading_rad: float, bevel: int) -> Decision:
        """Return the decision at the state nearest to a pose. Raises PoseError for a pose outside, or no number."""
        decisions = self.lookup_many([(x_mm, y_mm, heading_rad, bevel)])
        return Decision(Action(decisions.action[0]), float(decisions.value[0]), float(decisions.success[0]))

    def lookup_many(self, poses: ArrayLike) -> Decisions:
        """Return the decisions at the states nearest to `poses` [n, 4], rows of x_mm, y_mm, heading_rad, bevel.

        Raises PoseError naming the first row that is outside, or no number.
        """
        try:
            rows = np.ascontiguousarray(poses, dtype=np.float64)
            return Decisions(
                *_ppvi.lookup_many(
                    values=self.values,
                    policy=self.policy,
                    success=self.success,
                    spacing_mm=self.scenario.grid.spacing_mm,
                    poses=rows,
                )
            )
        except (ValueError, TypeError) as error:
            raise PoseError(str(error)) from None

    def expectations(self) -> Expectations:
        """Evaluate the expected length and number of turns of the policy, for all states; takes as long as a solve."""
        found = self.lattice.expectations(self.policy, threads=self.scenario.solver.threads)
        return Expectations(found["length_mm"], found["turns"])

    def start(self, pose: Sequence[float]) -> Pose:
        """Return a pose that the table holds; a missing bevel becomes the one of the lower cost. Raises PoseError."""
        if len(pose) == 3:
            pair = self.start((*pose, -1)), self.start((*pose, 1))
            return min(pair[::-1], key=lambda each: self.lookup(*each).value)
        found = Pose.of(pose)
        try:
            self.lookup(*found)
        except PoseError:
            workspace = self.scenario.workspace
            rule = f"must lie in the workspace, [0, {workspace.width_mm:g}] x [0, {workspace.height_mm:g}] mm"
            raise PoseError(Mistake("pose", str(found), rule)) from None
        return found

    def path(self, start: Sequence[float], *, greedy: bool = False, noise_seed: int | None = None) -> execution.Path:
        """Execute the policy once from x_mm, y_mm, heading_rad[, bevel]. Raises PoseError.

        Without noise, or with the tip noise of a `noise_seed`. Decisions come from the nearest state, or with `greedy`
        from the values interpolated at the true pose.
        """
        return execution.follow(self, self.start(start), greedy, noise_seed)

    def rollout(
        self, start: Sequence[float], runs: int = 10_000, seed: int = 0, *, greedy: bool = False
    ) -> execution.Rollouts:
        """Execute the policy `runs` times with tip noise in the continuous bicycle model. Raises PoseError.

        The same seed gives the same runs. `greedy` as for `path`.
        """
        return execution.roll_out(self, self.start(start), runs, seed, greedy)

    def best_entry(self, edge: str = "left", *, x_mm: float | None = None, y_mm: float | None = None) -> entry.Entry:
        """Return the entry on an edge with the highest success, and among equals (0.1 %) the lowest cost.

        All grid points of the edge are searched, or the one at `y_mm` (left, right) or `x_mm` (bottom, top), and all
        headings that lead into the workspace. Raises PoseError.
        """
        return entry.best_entry(self, edge, x_mm, y_mm)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the table to an HDF5 file, whole or not at all. Raises OutputError."""
        table_file.write(self, path)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> PolicyTable:
        """Read a table, every byte of it verified. Raises TableError."""
        content = table_file.read(path)
        try:
            return cls(content.values, content.policy, content.success, content.stats, content.scenario)
        except TableError as error:
            raise TableError(error.mistakes, os.fspath(path)) from None
