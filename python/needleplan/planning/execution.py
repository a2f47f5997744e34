"""Executing a policy in the continuous bicycle model: one noise-free path, or many noisy runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import Mistake, PoseError
from needleplan.planning.pose import Action, Outcome, Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning.table import PolicyTable

__all__ = ["Path", "Rollouts", "follow", "roll_out", "wilson"]

MOST_STEPS = 10_000
_MOST_RUNS = 50_000_000


@dataclass(frozen=True, eq=False)
class Path:
    """One execution. `poses` [k, 4] are x_mm, y_mm, heading_rad, bevel; `actions` [k - 1] lead from one to the next.

    `cost` is the sum of the stage costs, discounted as in the table, that of a failure included.
    """

    poses: NDArray[np.float64]
    actions: NDArray[np.uint8]
    outcome: Outcome
    length_mm: float
    cost: float

    @property
    def start(self) -> Pose:
        """The first pose."""
        return Pose.of(self.poses[0].tolist())

    @property
    def turns(self) -> NDArray[np.float64]:
        """Poses [turns, 4] at which the needle was rotated, before the rotation."""
        return self.poses[np.flatnonzero(self.actions == Action.ROTATE)]


@dataclass(frozen=True)
class Rollouts:
    """Many noisy executions from one pose, and what the table predicted for it.

    `success` is the share of runs that reached the target, `interval` its 95 % confidence interval (Wilson). The means
    are over all runs, failures included; `mean_cost` is discounted as in the table.
    """

    start: Pose
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


def follow(table: PolicyTable, start: Pose, greedy: bool, noise_seed: int | None) -> Path:
    """Execute the policy of `table` from `start` once, without noise or with that of a seed."""
    execution = table.lattice.path(
        policy=table.policy,
        values=table.values,
        start=start,
        greedy=greedy,
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
    )


def roll_out(table: PolicyTable, start: Pose, runs: int, seed: int, greedy: bool) -> Rollouts:
    """Execute the policy of `table` from `start` `runs` times with noise. Raises PoseError."""
    if not 1 <= runs <= _MOST_RUNS:
        raise PoseError(Mistake("runs", str(runs), f"must be a whole number from 1 to {_MOST_RUNS:,}"))
    if not 0 <= seed < 2**64:
        raise PoseError(Mistake("seed", str(seed), "must be a whole number from 0 to 2^64 - 1"))
    predicted = table.lookup(*start)
    run = table.lattice.rollout(
        policy=table.policy,
        values=table.values,
        starts=np.array([start], dtype=np.float64),
        runs=runs,
        seed=seed,
        greedy=greedy,
        max_steps=MOST_STEPS,
    )
    outcomes = {outcome: int(np.count_nonzero(run["outcome"] == outcome)) for outcome in Outcome}
    return Rollouts(
        start=start,
        runs=runs,
        seed=seed,
        success=outcomes[Outcome.TARGET] / runs,
        interval=wilson(outcomes[Outcome.TARGET], runs),
        outcomes=outcomes,
        mean_turns=float(run["turns"].mean()),
        mean_length_mm=float(run["length_mm"].mean(dtype=np.float64)),
        mean_cost=float(run["cost"].mean()),
        predicted_success=predicted.success,
        predicted_value=predicted.value,
    )


def wilson(successes: int, runs: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return the score interval of a proportion, 95 % for the default `z`.

    E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927) 209-212.
    """
    share = successes / runs
    middle = share + z * z / (2 * runs)
    reach = z * math.sqrt(share * (1 - share) / runs + z * z / (4 * runs * runs))
    scale = 1 + z * z / runs
    return max(0.0, (middle - reach) / scale), min(1.0, (middle + reach) / scale)
