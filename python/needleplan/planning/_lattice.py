"""The compiled lattice of a scenario, the statistics of a solve, and the success probability of a policy."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np

from needleplan import _ppvi
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.scenario import Transition

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan._ppvi import _Solution
    from needleplan.scenario import Scenario

__all__ = [
    "Progress",
    "Stats",
    "Status",
    "compiled_call",
    "every",
    "finer",
    "lattice_of",
    "require_callable",
    "stats_of",
    "success_of",
]

_P = ParamSpec("_P")
_N = TypeVar("_N", np.float32, np.uint8)
_T = TypeVar("_T")

Progress = Callable[[float, float, float], None]
"""Called now and then in a solve: number of sweeps so far, residual, and the residual at which the solve ends."""


class Status(StrEnum):
    """Why a solve ended.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.plan("four_obstacles").stats.status == "converged"
    True
    """

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    PRECISION_LIMIT = "precision_limit"
    """No further sweeps bring the error bound below the tolerance: rounding, or storing the values in single precision,
    adds more, or the problem allows no bound."""

    INTERRUPTED = "interrupted"


@dataclass(frozen=True, repr=False)
class Stats:
    """Counts, certificates and times of a solve.

    Attributes
    ----------
    states : int
        Number of states.
    partitions : int
        Number of partitions; for the directional sweeps, number of sectors.
    partitions_processed : int
        Number of visits to partitions, including repeated visits.
    backups : int
        Number of Bellman backups of single states.
    sweeps : float
        `backups` divided by `states`.
    residual : float
        Largest Bellman residual max |TV - V| of the returned values; for the directional sweeps, an upper bound of it.
    error_bound : float
        Upper bound of max |V - V*| of the returned values, rounding included; infinite if nothing is proven.
    status : Status
        Why the solve ended.
    seconds : float
        Time from the scenario to the table in s.
    seconds_solving, seconds_priorities : float
        Time spent on backups and on priorities in s.
    order : tuple of int
        Partitions ix * py + iy in the order of their first visit.
    success_error_bound : float
        Upper bound of the error of the success probabilities, as probabilities of the policy on the grid on which they
        are evaluated; 1 if nothing is proven.

    Examples
    --------
    >>> import needleplan as npl
    >>> stats = npl.plan("four_obstacles").stats
    >>> stats.states, stats.error_bound < 0.01
    (10440120, True)
    """

    states: int
    partitions: int
    partitions_processed: int
    backups: int
    sweeps: float
    residual: float
    error_bound: float
    status: Status
    seconds: float
    seconds_solving: float
    seconds_priorities: float
    order: tuple[int, ...]
    success_error_bound: float = 1.0

    def __repr__(self) -> str:
        return (
            f"<Stats: {self.status.replace('_', ' ')} after {self.sweeps:.4g} sweeps of {self.states:,} states, "
            f"residual {self.residual:.3g}, error at most {self.error_bound:.3g}, {self.seconds:.3g} s>"
        )


def stats_of(solved: _Solution, states: int, seconds: float, success_error_bound: float = 1.0) -> Stats:
    """Return the statistics of a solve from the result of the compiled solver; `seconds` is the total time."""
    return Stats(
        states=states,
        partitions=solved["partitions"],
        partitions_processed=solved["partitions_processed"],
        backups=solved["backups"],
        sweeps=solved["sweeps"],
        residual=solved["residual"],
        error_bound=solved["error_bound"],
        status=Status(solved["status"]),
        seconds=seconds,
        seconds_solving=solved["seconds_solving"],
        seconds_priorities=solved["seconds_priorities"],
        order=tuple(solved["order"].tolist()),
        success_error_bound=success_error_bound,
    )


def require_callable(progress: Progress | None, kind: type[InputError]) -> None:
    """Raise the error `kind` unless `progress` can be called or is None."""
    if progress is not None and not callable(progress):
        rule = "must be a function of sweeps, residual and threshold, or None"
        raise kind(Mistake("progress", repr(progress), rule))


def compiled_call(kind: type[InputError], function: Callable[_P, _T], *args: _P.args, **options: _P.kwargs) -> _T:
    """Call a function of the compiled module and return its result; its errors are raised as `kind`.

    An exception that a Python callback raises during the call is not changed.
    """
    try:
        return function(*args, **options)
    except (ValueError, MemoryError) as error:
        if error.__traceback__ is not None and error.__traceback__.tb_next is not None:
            raise  # the traceback has further frames, so the exception is from a callback
        parts = re.fullmatch(r"(\w+) = (.*): (must .*)", str(error), re.DOTALL)
        raise kind(Mistake(*parts.groups()) if parts else str(error)) from error


def lattice_of(scenario: Scenario) -> _ppvi.Lattice:
    """Compile the lattice of a scenario: classify its grid points and the events of all arcs. Raises ScenarioError."""
    objective = scenario.objective
    share, price = scenario.motion.straight_curvature_share, objective.straight_per_mm
    return compiled_call(
        ScenarioError,
        _ppvi.Lattice,
        width_mm=scenario.workspace.width_mm,
        height_mm=scenario.workspace.height_mm,
        spacing_mm=scenario.grid.spacing_mm,
        obstacles=[(obstacle.rings_mm, obstacle.reach_mm) for obstacle in scenario.obstacles],
        target_center_mm=scenario.target.center_mm,
        target_radius_mm=scenario.target.radius_mm,
        curvature_radius_mm=scenario.needle.curvature_radius_mm,
        headings=scenario.motion.headings,
        tip_noise=scenario.motion.tip_noise,
        arc_samples=scenario.motion.arc_samples or 0,
        interpolated=scenario.grid.transition is Transition.INTERPOLATED,
        insertion_per_mm=objective.insertion_per_mm,
        rotation=objective.rotation,
        collision=objective.collision,
        exit=objective.exit,
        discount=objective.discount,
        layers=[(layer.from_mm, layer.curvature_radius_mm) for layer in scenario.needle.layers],
        tissues=[(each.rings_mm, each.reach_mm, each.curvature_radius_mm) for each in scenario.tissues],
        step_mm=scenario.motion.step_mm,
        clearance_mm=objective.clearance_mm or 0.0,
        clearance_per_mm=objective.clearance_per_mm or 0.0,
        tip_noise_step_rad=None if scenario.motion.tip_noise_step_deg is None else scenario.motion.noise_step_rad,
        straight=None if share is None else (share, objective.insertion_per_mm if price is None else price),
    )


def success_of(scenario: Scenario, lattice: _ppvi.Lattice, solved: _Solution) -> tuple[NDArray[np.float32], float]:
    """Return the success probability [nx, ny, headings, 2] of the policy of a solve, and a bound on its error.

    If `grid.success_refinement` is above 1, the policy is evaluated on a finer grid, where each point uses the policy
    of the nearest coarse point. The reason: with every step, the bilinear weights spread the tip position in proportion
    to the square of the spacing. Near obstacles a part of this spread collides, so a coarse grid underestimates the
    success. Raises ScenarioError.
    """
    times, threads = scenario.grid.success_refinement, scenario.solver.threads
    policy: NDArray[np.uint8] = solved["policy"]
    success: NDArray[np.float32]
    if times == 1:
        values, residual = solved["values"], solved["residual"]
        for array in (values, policy):
            array.flags.writeable = False  # the compiled module copies arrays that other threads could write to
        result = compiled_call(
            ScenarioError, lattice.success, policy=policy, values=values, residual=residual, threads=threads
        )
        success = result["success"]
    else:
        fine = finer(scenario, times)
        nearest = np.ix_(*(
            np.minimum(np.rint(np.arange(points) / times).astype(np.intp), most - 1)
            for points, most in zip(fine.shape[:2], policy.shape[:2], strict=True)
        ))  # fmt: skip
        refined = np.ascontiguousarray(policy[nearest])
        result = compiled_call(ScenarioError, lattice_of(fine).success, policy=refined, threads=threads)
        success = every(times, result["success"], policy.shape)
    np.minimum(success, 1, out=success)  # weights in single precision can sum to slightly more than one
    return success, result["error_bound"]


def finer(scenario: Scenario, times: int) -> Scenario:
    """Return the scenario on a grid `times` finer in x and y, without refinements."""
    grid = scenario.grid
    dx, dy = (spacing / times for spacing in grid.spacing_mm)
    return replace(scenario, grid=replace(grid, spacing_mm=(dx, dy), success_refinement=1, refinement=None))


def every(times: int, fine: NDArray[_N], shape: tuple[int, ...]) -> NDArray[_N]:
    """Return the values of a table with a shape at every `times`-th point, along x and y, of a finer table.

    A coarse point beyond the last fine point represents the border, as the last fine point does.
    """
    places = (
        np.minimum(np.arange(points) * times, most - 1) for points, most in zip(shape[:2], fine.shape[:2], strict=True)
    )
    return fine[np.ix_(*places)]
