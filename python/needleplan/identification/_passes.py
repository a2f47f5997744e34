"""Several passes of a joint filter over records: from a start that may be far off to the noise floor.

What makes the filter reliable is, in this order: coordinates in which nothing can become unstable (logarithms; see
`JointForce`), no use of samples around reversals, several passes with a shrinking uncertainty, a large R at first that
acts as a trust region, one joint filter rather than a bank, and the exponential step of the state. The arithmetic is
not among them: the form of Joseph, square roots and the plain form agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.estimation.joint import Joint
from needleplan.estimation.joint_filter import JointFilter
from needleplan.estimation.replay import mean_absolute_error
from needleplan.estimation.sample import Step, Use
from needleplan.estimation.track import Track, feed, track_of
from needleplan.models import Model
from needleplan.signals import MovingAverage, Record

__all__ = ["FilterRun", "FilterStatus", "Recipe", "identify_by_passes"]


@dataclass(frozen=True)
class Recipe:
    """How the passes differ.

    `variances` is R of each pass, in the square of the channel's unit. A start may be wrong by `factor`: the standard
    deviation of a coordinate is ln(factor) at first, and `spreads` is the share of it that each pass begins with.
    `walk` is the variance that a coordinate gains in a sample. `settle` is the number of samples that are masked after
    a reversal, besides one before it; 0 masks none. No coordinate moves by more than `limit` in a sample, nor away from
    its start by more than `reach` times ln(factor). The defaults are those for forces in N.
    """

    variances: tuple[float, ...] = (1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-3, 1e-4)
    spreads: tuple[float, ...] = (1.0, 0.67, 0.67, 0.33, 0.33, 0.17, 0.1)
    factor: float = 6.0
    walk: float = 1e-8
    settle: int = 5
    reach: float = 1.5
    limit: float = 0.1

    def __post_init__(self) -> None:
        if len(self.variances) != len(self.spreads) or not self.variances:
            rule = "must be one for each pass, as many as there are variances"
            raise DataError(Mistake("spreads", f"{len(self.spreads)} numbers", rule))


class FilterStatus(StrEnum):
    """How the passes ended."""

    DONE = "done"
    DIVERGED = "diverged"
    """A state or a parameter stopped being a finite number."""


@dataclass(frozen=True)
class FilterRun:
    """What passes over records gave: the model, and how well it predicts.

    `tracks` are those of the last pass, one a record. `innovation_rmse` is over the innovations that were used,
    `replay_mae` the mean absolute error of the open loop, the model at the end of a pass simulated along all records:
    each has one entry per pass, in the channel's unit. A filter that follows the data can have small innovations with
    parameters that mean nothing; only the replay tells.
    """

    model: Model
    status: FilterStatus
    tracks: tuple[Track, ...]
    innovation_rmse: tuple[float, ...]
    replay_mae: tuple[float, ...]
    counts: dict[Use, int]

    @property
    def ok(self) -> bool:
        """Whether the filter kept its estimate."""
        return self.status is FilterStatus.DONE


def identify_by_passes(
    joint: Joint,
    model: Model,
    records: Sequence[Record],
    recipe: Recipe | None = None,
    *,
    smooth: MovingAverage | None = None,
) -> FilterRun:
    """Filter all `records`, from the parameters of `model`, as often as the recipe says.

    Within a pass the covariance goes on from record to record, between passes it starts again. `smooth` is the average
    of the sensor, for the replay only. Raises DataError for records without the channel or without motion.
    """
    recipe = recipe or Recipe()
    if not records:
        raise DataError(Mistake("records", "", "there is none"))
    sd = math.log(recipe.factor)
    rmse, mae = [], []
    last: list[list[Step]] = []
    filtered = JointFilter(
        joint, model, variance=recipe.variances[0], sd=sd * recipe.spreads[0], walk=recipe.walk, settle=recipe.settle,
        reach=sd * recipe.reach, limit=recipe.limit,
    )  # fmt: skip
    for number, (variance, spread) in enumerate(zip(recipe.variances, recipe.spreads, strict=True)):
        if number:
            filtered.restart(variance=variance, sd=sd * spread)
        last = []
        for place, record in enumerate(records):
            if place:
                filtered.next_record()
            last.append(feed(filtered, record, recipe.settle))
            if filtered.diverged:
                break
        if filtered.diverged:
            break
        innovations = np.array([each.innovation for steps in last for each in steps if each.use is Use.USED])
        with np.errstate(over="ignore"):
            rmse.append(float(np.sqrt(np.mean(innovations**2))) if innovations.size else math.nan)
        mae.append(mean_absolute_error(filtered.model, records, smooth=smooth))
    lost = filtered.diverged
    tracks = tuple(track_of(joint, record, steps) for record, steps in zip(records, last, strict=False))
    return FilterRun(
        model if lost else filtered.model, FilterStatus.DIVERGED if lost else FilterStatus.DONE, tracks,
        tuple(rmse), tuple(mae), dict(filtered.counts),
    )  # fmt: skip
