"""Executions of a policy in the continuous bicycle model: a single path, or the statistics of many noisy runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from needleplan.planning._coded import Action, Outcome
from needleplan.planning._drawing import draw_noisy, draw_path
from needleplan.planning._poses import Pose, PoseOf
from needleplan.plotting import axes_or_new, legend_below, picture_html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan.anatomy import SpaceScenario
    from needleplan.planning._space_path import SpacePath
    from needleplan.scenario import Scenario

__all__ = ["MOST_STEPS", "SAMPLES", "Execution", "Path", "Rollouts", "rollouts_of", "wilson"]

# Number of insertion steps after which an execution ends with the outcome `STEP_LIMIT`.
MOST_STEPS = 10_000

# Pose that stands for a start that does not exist.
_SOMEWHERE = (0.0, 0.0, 0.0, 1.0)

# Number of points along each arc of a path.
_ARC_POINTS = 8

# Largest number of executions that `Rollouts` keeps for its figure.
SAMPLES = 40


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """One execution of a policy.

    Attributes
    ----------
    poses : ndarray of float64, shape (k, 4)
        The poses: x_mm, y_mm, heading_rad, bevel. Headings are not wrapped, so their size can exceed 2 pi.
    actions : ndarray of uint8, shape (k - 1,)
        The action that leads from each pose to the next: 0 insert, 1 rotate, then insert, 2 insert straight.
    outcome : Outcome
        How the execution ended.
    length_mm : float
        Inserted length in mm.
    straight_mm : float
        The part of it that was inserted straight, in mm.
    cost : float
        Sum of the stage costs, discounted as in the table, including the cost of a failure.
    scenario : Scenario
        The scenario in which the policy was executed.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> table.path(npl.Pose.deg(0, 28, 18, -1))
    <Path: target after 104.7 mm in 25 steps, 16 turns>
    """

    poses: NDArray[np.float64]
    actions: NDArray[np.uint8]
    outcome: Outcome
    length_mm: float
    cost: float
    scenario: Scenario
    straight_mm: float = 0.0

    @property
    def start(self) -> Pose:
        """The first pose."""
        return Pose.wound(self.poses[0].tolist())

    @property
    def end(self) -> Pose:
        """The last pose, without whole turns in its heading."""
        return Pose.wound(self.poses[-1].tolist())

    @property
    def turns(self) -> NDArray[np.float64]:
        """Poses directly before the rotations of the needle, array of shape (turns, 4)."""
        return self.poses[np.flatnonzero(self.actions == Action.ROTATE.code)]

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """Points along the arcs of the path (mm), shape (n, 2)."""
        # A chord of a circle has the mean direction of its ends, and the part f of an arc that turns by a has a chord
        # of sin(f a / 2) / sin(a / 2) times the length of the whole one.
        share = np.arange(1, _ARC_POINTS + 1) / _ARC_POINTS
        chord, half = np.diff(self.poses[:, :2], axis=0), np.diff(self.poses[:, 2]) / 2
        ratio = share * np.sinc(np.outer(half, share) / np.pi) / np.sinc(half / np.pi)[:, None]
        angle = np.arctan2(chord[:, 1], chord[:, 0])[:, None] + np.outer(half, share - 1)
        length = np.hypot(chord[:, 0], chord[:, 1])[:, None] * ratio
        along = self.poses[:-1, None, :2] + np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)
        return np.vstack([self.poses[:1, :2], along.reshape(-1, 2)])

    @property
    def clearance_mm(self) -> float:
        """Smallest distance of the path to an obstacle (mm); infinite without obstacles."""
        import shapely

        points = self.points_mm
        line = shapely.linestrings(points) if len(points) > 1 else shapely.points(points[0])
        distances = (float(shapely.distance(obstacle.region(), line)) for obstacle in self.scenario.obstacles)
        return min(distances, default=math.inf)

    def plot(self, ax: Axes | None = None, *, scene: bool = True, label: str = "without noise") -> Axes:
        """Draw the execution in its workspace, with a circle at every rotation of the needle and straight steps thick.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Without them a new pyplot figure is made.
        scene : bool, default True
            Draw workspace, obstacles and target first. False adds the path to axes that show them already.
        label : str, optional
            Label of the path in the legend.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm.

        Examples
        --------
        >>> import needleplan as npl
        >>> from matplotlib.figure import Figure
        >>> table = npl.plan("four_obstacles")
        >>> axes = table.path(table.best_entry()).plot(Figure().subplots())
        >>> axes.get_xlabel()
        'x (mm)'
        """
        axes = axes_or_new(ax, self.scenario.workspace)
        if scene:
            self.scenario.plot(axes)
        straight = np.flatnonzero(self.actions == Action.STRAIGHT.code)
        draw_path(axes, self.poses, self.turns, self.outcome, label, straight)
        if ax is None:
            legend_below(axes)
        return axes

    def __repr__(self) -> str:
        steps = f"{len(self.actions)} steps, {len(self.turns)} turns"
        steps += f", {self.straight_mm:.1f} mm straight" if self.straight_mm else ""
        return f"<Path: {self.outcome} after {self.length_mm:.1f} mm in {steps}>"

    def _repr_html_(self) -> str:
        return picture_html(self.scenario.workspace, self.plot, repr(self))


@dataclass(frozen=True, repr=False)
class Rollouts(Generic[PoseOf]):
    """Statistics of many noisy executions from one pose, with the predictions of the table for this pose.

    Attributes
    ----------
    start : Pose or SpacePose
        The pose at which every run began.
    runs : int
        Number of runs.
    seed : int
        Seed of the tip noise.
    success : float
        Share of the runs that reached the target.
    interval : tuple of float
        95 % confidence interval of `success` (Wilson).
    outcomes : mapping of Outcome to int
        Number of runs with each outcome.
    mean_turns, mean_length_mm, mean_straight_mm, mean_cost : float
        Means over all runs, failures included: of the turns, the inserted length, its straight part, and the cost,
        which is discounted as in the table.
    predicted_success, predicted_value : float
        Success probability and expected cost of `start` as `PolicyTable.lookup` predicts them.
    samples : tuple of Path or SpacePath
        Up to 40 executions for the figure, with the noise seeds `seed`, `seed` + 1 ...
    scenario : Scenario
        The scenario in which the policy was executed.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> rollouts = table.rollout(npl.Pose.deg(0, 28, 18, -1), runs=1000)
    >>> rollouts.runs, rollouts.interval[0] < rollouts.success < rollouts.interval[1]
    (1000, True)
    """

    start: PoseOf
    runs: int
    seed: int
    success: float
    interval: tuple[float, float]
    outcomes: Mapping[Outcome, int]
    mean_turns: float
    mean_length_mm: float
    mean_cost: float
    predicted_success: float
    predicted_value: float
    samples: tuple[Path | SpacePath, ...] = field(compare=False)
    scenario: Scenario | SpaceScenario = field(compare=False)
    mean_straight_mm: float = 0.0

    def plot(self, ax: Axes | None = None, *, scene: bool = True) -> Axes:
        """Draw the sampled executions in their workspace, in different colours if they reach the target or fail.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Without them a new pyplot figure is made.
        scene : bool, default True
            Draw workspace, obstacles and target first. False adds the executions to axes that show them already.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm.

        Examples
        --------
        >>> import needleplan as npl
        >>> from matplotlib.figure import Figure
        >>> table = npl.plan("four_obstacles")
        >>> axes = table.rollout(table.best_entry(), runs=100).plot(Figure().subplots())
        >>> len(axes.lines) >= 40
        True
        """
        axes = axes_or_new(ax, self.scenario.workspace)
        if scene:
            self.scenario.plot(axes)
        reached = [path.poses for path in self.samples if path.outcome is Outcome.TARGET]
        failed = [path.poses for path in self.samples if path.outcome is not Outcome.TARGET]
        draw_noisy(axes, reached, failed)
        if ax is None:
            legend_below(axes)
        return axes

    def __repr__(self) -> str:
        low, high = self.interval
        return (
            f"<Rollouts: success {self.success:.3f} in {self.runs:,} runs, 95 % interval {low:.3f} to {high:.3f}; "
            f"predicted {self.predicted_success:.3f}>"
        )

    def _repr_html_(self) -> str:
        return picture_html(self.scenario.workspace, self.plot, repr(self))


@dataclass(frozen=True, eq=False)
class Execution:
    """Executes a policy: by a look one step ahead, or, if `nearest`, by its decision at the nearest state."""

    lattice: _ppvi.Lattice
    policy: NDArray[np.uint8]
    values: NDArray[np.float32]
    scenario: Scenario
    nearest: bool

    def path(self, start: Pose, noise_seed: int | None) -> Path:
        """Execute the policy once, with tip noise of the seed `noise_seed`, or without noise if it is None."""
        execution = self.lattice.path(
            policy=self.policy,
            values=self.values,
            start=start,
            greedy=not self.nearest,
            noise=noise_seed is not None,
            seed=noise_seed or 0,
            max_steps=MOST_STEPS,
        )
        return Path(
            poses=execution["poses"],
            actions=execution["actions"],
            outcome=Outcome(execution["outcome"]),
            length_mm=execution["length_mm"],
            cost=execution["cost"],
            scenario=self.scenario,
            straight_mm=execution["straight_mm"],
        )

    def rollouts(
        self, start: Pose, runs: int, seed: int, predicted_success: float, predicted_value: float
    ) -> Rollouts[Pose]:
        """Execute the policy `runs` times with tip noise, and return the statistics with the given predictions."""
        run = self.lattice.rollout(
            policy=self.policy,
            values=self.values,
            starts=np.array([start], dtype=np.float64),
            runs=runs,
            seed=seed,
            greedy=not self.nearest,
            max_steps=MOST_STEPS,
        )
        return rollouts_of(
            run,
            start=start,
            seed=seed,
            predicted_success=predicted_success,
            predicted_value=predicted_value,
            samples=tuple(self.path(start, (seed + k) % 2**64) for k in range(min(runs, SAMPLES))),
            scenario=self.scenario,
        )

    def reached(self, starts: NDArray[np.float64], truths: NDArray[np.float64], seed: int) -> NDArray[np.bool_]:
        """Return which executions reach the target although the true anatomy or curvature differs from the plan.

        One execution begins at each of `starts`, shape (n, 4); an execution from a start of NaN fails. `truths`, shape
        (n, 6), are the differences, as in `plane_truths`. The tip noise is that of the first runs of `rollouts`.
        """
        known = ~np.isnan(starts[:, 0])
        places = np.where(known[:, None], starts, _SOMEWHERE)
        run = self.lattice.rollout(
            policy=self.policy, values=self.values, starts=places, runs=1, seed=seed, greedy=not self.nearest,
            max_steps=MOST_STEPS, truths=truths,
        )  # fmt: skip
        return np.asarray(known & (run["outcome"][:, 0] == Outcome.TARGET.code))


def rollouts_of(found: Mapping[str, Any], **known: Any) -> Rollouts[Any]:
    """Return the statistics of compiled runs. `known` are the other attributes of `Rollouts`."""
    outcomes = {outcome: int(np.count_nonzero(found["outcome"] == outcome.code)) for outcome in Outcome}
    runs = found["outcome"].size
    return Rollouts(
        runs=runs,
        success=outcomes[Outcome.TARGET] / runs,
        interval=wilson(outcomes[Outcome.TARGET], runs),
        outcomes=outcomes,
        mean_turns=float(found["turns"].mean()),
        mean_length_mm=float(found["length_mm"].mean(dtype=np.float64)),
        mean_cost=float(found["cost"].mean()),
        mean_straight_mm=float(found["straight_mm"].mean(dtype=np.float64)),
        **known,
    )


def wilson(successes: int, runs: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return the Wilson score interval of a proportion.

    Parameters
    ----------
    successes : int
        Number of successes.
    runs : int
        Number of runs, at least 1.
    z : float, optional
        Quantile of the normal distribution. The default gives an interval of 95 %.

    Returns
    -------
    tuple of float
        Lower and upper limit, from 0 to 1.

    Notes
    -----
    Source: E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927) 209-212.
    """
    share = successes / runs
    middle = share + z * z / (2 * runs)
    reach = z * math.sqrt(share * (1 - share) / runs + z * z / (4 * runs * runs))
    scale = 1 + z * z / runs
    return max(0.0, (middle - reach) / scale), min(1.0, (middle + reach) / scale)
