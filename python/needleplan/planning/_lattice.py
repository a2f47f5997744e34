"""The compiled lattice of a scenario, the statistics of a solve, and the success probability of a policy."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np

from needleplan import _ppvi
from needleplan.artifacts import short_html
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.scenario import Transition

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan._ppvi_results import LatticeSolution, TabularSolution
    from needleplan.scenario import Scenario

__all__ = [
    "Progress",
    "Stats",
    "Status",
    "compiled_call",
    "every",
    "finer",
    "heading_refinement",
    "heading_variance",
    "lattice_of",
    "require_callable",
    "stats_of",
    "success_of",
    "success_refinement",
    "with_headings",
]

# Least number of cells of the grid of the success in a step if `grid.success_refinement` is absent. With fewer,
# obstacles and changes of the policy are not resolved: with 4 cells, 2 % of predictions are off by over 3 points.
_STEP_CELLS = 8

# Largest refinement by that rule. The time grows with its square.
_MOST_BY_RULE = 3

# Largest refinement of the headings by rule. The time grows with it.
_MOST_HEADINGS = 9

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
    (1176120, True)
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

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return (
            f"<Stats: {self.status.replace('_', ' ')} after {self.sweeps:.4g} sweeps of {self.states:,} states, "
            f"residual {self.residual:.3g}, error at most {self.error_bound:.3g}, {self.seconds:.3g} s>"
        )


def stats_of(
    solved: LatticeSolution | TabularSolution, states: int, seconds: float, success_error_bound: float = 1.0
) -> Stats:
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


def require_callable(progress: object, kind: type[InputError]) -> None:
    """Raise the error `kind` unless `progress` can be called or is None."""
    if progress is not None and not callable(progress):
        rule = "must be a function of sweeps, residual and threshold, True for a bar, or None"
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
    objective, half_mm = scenario.objective, 0.5 * (scenario.needle.diameter_mm or 0.0)
    share, price = scenario.motion.straight_curvature_share, objective.straight_per_mm
    return compiled_call(
        ScenarioError,
        _ppvi.Lattice,
        width_mm=scenario.workspace.width_mm,
        height_mm=scenario.workspace.height_mm,
        spacing_mm=scenario.grid.spacing_mm,
        obstacles=[(obstacle.rings_mm, obstacle.reach_mm + half_mm) for obstacle in scenario.obstacles],
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
        tissues=[(tissue.rings_mm, tissue.reach_mm, tissue.curvature_radius_mm) for tissue in scenario.tissues],
        step_mm=scenario.motion.step_mm,
        clearance_mm=objective.clearance_mm or 0.0,
        clearance_per_mm=objective.clearance_per_mm or 0.0,
        tip_noise_step_rad=None if scenario.motion.tip_noise_step_deg is None else scenario.motion.noise_step_rad,
        straight=None if share is None else (share, objective.insertion_per_mm if price is None else price),
    )


def success_refinement(scenario: Scenario) -> int:
    """Return how many times finer than the grid of the table the grid is that evaluates the success.

    The number is `grid.success_refinement`. By default, it is the least number with which a step covers `_STEP_CELLS`
    cells of the finer grid, at most 3, and at least the refinement of the solve.
    """
    grid = scenario.grid
    if grid.transition is Transition.NEAREST:
        return grid.refinement or 1
    if grid.success_refinement is not None:
        return grid.success_refinement
    needed = math.ceil(min(_STEP_CELLS * max(grid.spacing_mm) / scenario.step_mm, _MOST_BY_RULE))
    return max(needed, grid.refinement or 1)


def heading_refinement(scenario: Scenario) -> int:
    """Return the number of headings of the table, divided by the number of headings of the scenario.

    The number is `grid.heading_refinement`. By default, it is the least number with which the change of the heading in
    a step has the variance of the tip noise (`heading_variance`), and 1 without noise.

    Parameters
    ----------
    scenario : Scenario
        A scenario of the plane.

    Returns
    -------
    int
        1 to 9.

    Raises
    ------
    ScenarioError
        If 9 times the headings are not enough.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.planning.heading_refinement(npl.Scenario.read("four_obstacles"))
    1
    """
    grid, motion = scenario.grid, scenario.motion
    if grid.heading_refinement is not None:
        return grid.heading_refinement
    if motion.tip_noise[0] == 1:
        return 1
    for times in range(1, _MOST_HEADINGS + 1):
        true, solved = heading_variance(scenario, times)
        if solved <= true * (1 + 1e-9):
            return times
    needed = math.ceil(math.pi / math.sqrt(heading_variance(scenario)[0]))
    rule = (
        f"must be at least {needed}: between so few headings a step adds more noise than tip_noise; or accept that "
        "with grid.heading_refinement = 1"
    )
    raise ScenarioError(Mistake("motion.headings", f"{motion.headings}", rule))


def heading_variance(scenario: Scenario, times: int = 1) -> tuple[float, float]:
    """Return the variance (rad^2) of the tip noise, and the largest heading variance (rad^2) of a step on the grid.

    The grid has `times` the headings of the scenario. A step that ends between two headings is split between them. If
    it ends at the fraction f of a heading step, the split has at least the variance f (1 - f), in squared heading
    steps. Only a scenario with `step_mm`, or with straight steps, has such steps.
    """
    motion, needle = scenario.motion, scenario.needle
    heading_rad = 2 * math.pi / (motion.headings * times)
    true = 2 * motion.noise_step_rad**2 * math.fsum(k**2 * share for k, share in enumerate(motion.tip_noise))
    radii = [needle.curvature_radius_mm, *(layer.curvature_radius_mm for layer in needle.layers)]
    radii += [tissue.curvature_radius_mm for tissue in scenario.tissues]
    turns = [2 * math.pi / motion.headings if motion.step_mm is None else motion.step_mm / radius for radius in radii]
    if motion.straight_curvature_share is not None:
        turns += [turn * motion.straight_curvature_share for turn in turns]
    fractions = (turn / heading_rad % 1 for turn in turns)
    added = max(fraction * (1 - fraction) for fraction in fractions)
    return true, max(true, added * heading_rad**2 if added > 1e-9 else 0.0)


def success_of(
    scenario: Scenario, lattice: _ppvi.Lattice, solved: LatticeSolution, values: NDArray[np.float32]
) -> tuple[NDArray[np.float32], float]:
    """Return the success probability [nx, ny, headings, 2] of executions of a table, and a bound on its error.

    An execution looks ahead with the values of the table, interpolated between its grid points. That policy is
    evaluated on a grid `success_refinement` times finer, with cubic interpolation if the transitions are interpolated.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the table.
    lattice : Lattice
        The lattice that was solved, `grid.refinement` times finer.
    solved : dict
        Its solution.
    values : ndarray of float32
        The values of the table.

    Raises ScenarioError.
    """
    times, solved_times, threads = success_refinement(scenario), scenario.grid.refinement or 1, scenario.solver.threads
    start: NDArray[np.float32] | None = None
    residual = math.inf
    if scenario.grid.transition is Transition.NEAREST or times == solved_times == 1:
        policy, start, residual = solved["policy"], solved["values"], solved["residual"]
        start.flags.writeable = False  # the compiled module copies arrays that other threads could write to
    else:
        if times != solved_times:
            lattice = lattice_of(finer(scenario, times))
        policy = compiled_call(ScenarioError, lattice.executed_policy, values, times, threads)
    policy.flags.writeable = False
    result = compiled_call(
        ScenarioError,
        lattice.success,
        policy=policy,
        values=start,
        residual=residual,
        bound=scenario.solver.success_bound,
        threads=threads,
    )
    success = every(times, result["success"], values.shape)
    np.minimum(success, 1, out=success)  # weights in single precision can sum to slightly more than one
    return success, result["error_bound"]


def finer(scenario: Scenario, times: int) -> Scenario:
    """Return the scenario on a grid `times` finer in x and y, without refinements."""
    grid = scenario.grid
    dx, dy = (spacing / times for spacing in grid.spacing_mm)
    return replace(scenario, grid=replace(grid, spacing_mm=(dx, dy), success_refinement=1, refinement=None))


def with_headings(scenario: Scenario) -> Scenario:
    """Return the scenario with `heading_refinement` times the headings, and the same steps and noise."""
    times, motion = heading_refinement(scenario), scenario.motion
    if times == 1:
        return scenario
    more = replace(
        motion,
        headings=motion.headings * times,
        step_mm=scenario.step_mm,
        tip_noise_step_deg=math.degrees(motion.noise_step_rad),
    )
    return replace(scenario, motion=more, grid=replace(scenario.grid, heading_refinement=1))


def every(times: int, fine: NDArray[_N], shape: tuple[int, ...]) -> NDArray[_N]:
    """Sample a finer table at every `times`-th point along x and y, to a table of the given shape.

    A coarse point beyond the last fine point represents the border, as the last fine point does.
    """
    if times == 1:
        return fine
    places = (
        np.minimum(np.arange(points) * times, most - 1) for points, most in zip(shape[:2], fine.shape[:2], strict=True)
    )
    return fine[np.ix_(*places)]
