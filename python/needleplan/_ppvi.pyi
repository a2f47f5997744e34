"""The compiled module, built from the crate `needleplan-py`.

Only `planning`, `anatomy`, `models`, `estimation`, `devices` and `control` import it.

Tables have the shape [nx, ny, headings, 2]; the last axis is bevel -1, bevel +1. Wrong input raises

- ValueError with one sentence, if a rule is broken;
- TypeError or OverflowError, if an argument is not of the type in the signature;
- MemoryError, if a problem does not fit.

A RuntimeError is a defect of this module. All work but a look-up of few poses, `rod_stations`, `path_moved`,
`path_corrected` and the guard is done by other threads, without the GIL; Ctrl-C ends it within 0.1 s. Arrays that can
be written to are copied first.
"""

import os
from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from needleplan._ppvi_guard import *
from needleplan._ppvi_mechanics import *
from needleplan._ppvi_results import (
    DependenciesResult,
    ExecutionResult,
    ExpectationsResult,
    LatticeSolution,
    RolloutResult,
    SpaceAnswers,
    SpaceDecisions,
    SpacePathsResult,
    SpaceReport,
    SpaceRolloutResult,
    SparseMdp,
    SparseRowsResult,
    SuccessResult,
    TabularSolution,
)
from needleplan._ppvi_robot import *

__all__ = [
    "DeadmanTimer",
    "ForceWindow",
    "HeartbeatTimer",
    "Lattice",
    "RepeatedStop",
    "RobotLine",
    "RobotSupervisor",
    "SolvedSpace",
    "Space",
    "Tabular",
    "__version__",
    "dragged",
    "guard_against_insertion",
    "guard_against_retraction",
    "guard_against_rotation",
    "guard_causes",
    "guard_delay",
    "guard_freshness",
    "guard_ordered",
    "guard_validated",
    "impossible",
    "lattice_codes",
    "lookup_many",
    "path_corrected",
    "path_moved",
    "rod_stations",
    "slid",
    "yielding",
]

__version__: str

_Progress = Callable[[float, float, float], None]

@final
class Lattice:
    """The MDP of a bevel-tip needle on a grid.

    `obstacles` are pairs of rings of vertices and the distance from them within which a point is in the obstacle; a
    ring of one vertex is a disc, one of two a capsule. `arc_samples` is the number of tested points of every arc; 0
    tests the whole arc. `layers` are pairs (from_mm, curvature_radius_mm) and `tissues` triples (rings, distance,
    curvature_radius_mm), with rings and distance as of an obstacle: the regions with a radius of their own.
    Steps that begin within `clearance_mm` of an obstacle cost `clearance_per_mm` more per mm. `straight` adds the
    straight action: the share of the curvature that is left, and the cost of a mm.
    """

    def __new__(
        cls,
        *,
        width_mm: float,
        height_mm: float,
        spacing_mm: tuple[float, float],
        obstacles: Sequence[tuple[Sequence[Sequence[tuple[float, float]]], float]],
        target_center_mm: tuple[float, float],
        target_radius_mm: float,
        curvature_radius_mm: float,
        headings: int,
        tip_noise: Sequence[float],
        arc_samples: int,
        interpolated: bool,
        insertion_per_mm: float,
        rotation: float,
        collision: float,
        exit: float,
        discount: float,
        layers: Sequence[tuple[float, float]] = ...,
        tissues: Sequence[tuple[Sequence[Sequence[tuple[float, float]]], float, float]] = ...,
        step_mm: float | None = ...,
        tip_noise_step_rad: float | None = ...,
        clearance_mm: float = ...,
        clearance_per_mm: float = ...,
        straight: tuple[float, float] | None = ...,
    ) -> Lattice: ...
    @property
    def shape(self) -> tuple[int, int, int, int]: ...
    @property
    def step_mm(self) -> float: ...
    def solve(
        self,
        *,
        method: str,
        partitions: tuple[int, int],
        priority: str,
        tolerance: float,
        max_sweeps: int | None = None,
        time_limit_s: float | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> LatticeSolution: ...
    def success(
        self,
        policy: NDArray[np.uint8],
        *,
        values: NDArray[np.float32] | None = None,
        residual: float = ...,
        cubic: bool = True,
        bound: bool = True,
        threads: int | None = None,
    ) -> SuccessResult: ...
    def executed_policy(
        self, values: NDArray[np.float32], times: int, threads: int | None = None
    ) -> NDArray[np.uint8]: ...
    def expectations(self, policy: NDArray[np.uint8], threads: int | None = None) -> ExpectationsResult: ...
    def events(self, points: NDArray[np.float64]) -> NDArray[np.uint8]: ...
    def outcomes(self) -> NDArray[np.uint8]: ...
    def predict(
        self,
        policy: NDArray[np.uint8],
        values: NDArray[np.float32],
        success: NDArray[np.float32],
        poses: NDArray[np.float64],
        threads: int | None = None,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]: ...
    def rollout(
        self,
        policy: NDArray[np.uint8],
        values: NDArray[np.float32],
        starts: NDArray[np.float64],
        *,
        runs: int,
        seed: int,
        greedy: bool = False,
        arc_samples: int | None = None,
        noise: bool = True,
        max_steps: int,
        truths: NDArray[np.float64] | None = None,
        threads: int | None = None,
    ) -> RolloutResult: ...
    def path(
        self,
        policy: NDArray[np.uint8],
        values: NDArray[np.float32],
        start: Sequence[float],
        *,
        greedy: bool = False,
        noise: bool = False,
        seed: int = 0,
        arc_samples: int | None = None,
        max_steps: int,
    ) -> ExecutionResult: ...
    def tabular(self) -> SparseMdp: ...

def lookup_many(
    values: NDArray[np.float32],
    policy: NDArray[np.uint8],
    success: NDArray[np.float32],
    spacing_mm: tuple[float, float],
    size_mm: tuple[float, float],
    poses: NDArray[np.float64],
    threads: int | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]: ...
def lattice_codes(
    *,
    codes: NDArray[np.uint8],
    obstacles: NDArray[np.uint8],
    growth_mm: Sequence[float],
    axes: Sequence[Sequence[float]],
    sizes_mm: Sequence[float],
    origin_mm: Sequence[float],
    count: Sequence[int],
    size_mm: float,
    threads: int | None = None,
) -> NDArray[np.uint8]: ...
def impossible(
    poses_mm: NDArray[np.float64],
    *,
    voxels: NDArray[np.uint8],
    spacing_mm: Sequence[float],
    curvature_radii_mm: Sequence[float],
    cone_rad: float,
    slopes: float,
    advance: int,
    threads: int | None = None,
) -> NDArray[np.bool_]: ...

@final
class Tabular:
    """Any finite MDP in compressed sparse rows."""

    def __new__(
        cls,
        *,
        action_offsets: NDArray[np.int64],
        row_offsets: NDArray[np.int64],
        successors: NDArray[np.uint32],
        probabilities: NDArray[np.float64],
        stage_costs: NDArray[np.float64],
        discount: float,
    ) -> Tabular: ...
    @property
    def states(self) -> int: ...
    def solve(
        self,
        *,
        method: str,
        labels: NDArray[np.uint32] | None = None,
        priority: str = "bound",
        start: NDArray[np.float64] | None = None,
        tolerance: float,
        max_sweeps: int | None = None,
        time_limit_s: float | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> TabularSolution: ...
    def q_values(self, values: NDArray[np.float64], discount: float) -> NDArray[np.float64]: ...
    def rows(self) -> SparseRowsResult: ...
    def with_discount(self, discount: float) -> Tabular: ...
    def under_policy(self, policy: NDArray[np.uint32]) -> Tabular: ...
    def dependencies(self, labels: NDArray[np.uint32]) -> DependenciesResult: ...

@final
class Space:
    """A steering problem in a volume. Voxels: 0 free, 1 target, 2 obstacle, 3 outside."""

    def __new__(
        cls,
        *,
        voxels: NDArray[np.uint8],
        spacing_mm: Sequence[float],
        curvature_radii_mm: Sequence[float],
        advance: int,
        rolls: int,
        cone_rad: float,
        direction_spacing_rad: float,
        noise_rad_per_sqrt_mm: float,
        insertion_per_mm: float,
        rotation: float,
        collision: float,
        exit: float,
        refinement: int = 1,
        tissues: NDArray[np.uint8] | None = None,
        prices: NDArray[np.float32] | None = None,
        straight: tuple[float, float] | None = None,
        target_ball: Sequence[float] | None = None,
        target_voxels: tuple[Sequence[Sequence[float]], NDArray[np.uint8]] | None = None,
    ) -> Space: ...
    @property
    def shape(self) -> list[int]: ...
    def tangents(self) -> NDArray[np.float64]: ...
    def solve(
        self,
        *,
        cubic_success: bool = True,
        time_limit_s: float | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> SolvedSpace: ...
    def solve_to(
        self,
        path: str | os.PathLike[str],
        offsets: Sequence[int],
        *,
        cubic_success: bool = True,
        time_limit_s: float | None = None,
        threads: int | None = None,
        progress: _Progress | None = None,
    ) -> SpaceReport: ...
    def restore(
        self, *, values: NDArray[np.float32], policy: NDArray[np.uint8], success: NDArray[np.uint16], seconds: float
    ) -> SolvedSpace: ...

@final
class SolvedSpace:
    """Read-only tables of a `Space`, [slices, directions, ny, nz]; success in 1 / 65535. A pose: position, tangent."""

    @property
    def values(self) -> NDArray[np.float32]: ...
    @property
    def policy(self) -> NDArray[np.uint8]: ...
    @property
    def success(self) -> NDArray[np.uint16]: ...
    def report(self) -> SpaceReport: ...
    def look_up(self, poses_mm: NDArray[np.float64], *, threads: int | None = None) -> SpaceAnswers: ...
    def decide(self, poses_mm: NDArray[np.float64], *, threads: int | None = None) -> SpaceDecisions: ...
    def estimate(
        self, pose_mm: NDArray[np.float64], *, runs: int, seed: int, threads: int | None = None
    ) -> NDArray[np.float64]: ...
    def rollout(
        self, pose_mm: NDArray[np.float64], *, runs: int, seed: int, threads: int | None = None
    ) -> SpaceRolloutResult: ...
    def true_outcomes(
        self,
        poses_mm: NDArray[np.float64],
        truths: NDArray[np.float64],
        *,
        center_mm: Sequence[float],
        seed: int,
        anatomy: Space | None = None,
        threads: int | None = None,
    ) -> NDArray[np.uint8]: ...
    def paths(
        self, poses_mm: NDArray[np.float64], *, seed: int | None = None, threads: int | None = None
    ) -> SpacePathsResult: ...
