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
from numpy.typing import NDArray

from needleplan.errors import DataError, Mistake
from needleplan.estimation import FilterSample, FilterStep, JointFilter, JointSystem, SampleUse
from needleplan.models import Model, simulate
from needleplan.signals import Array, MovingAverage, Record

__all__ = [
    "FilterRun",
    "FilterStatus",
    "Recipe",
    "Track",
    "feed",
    "identify_by_passes",
    "mean_absolute_error",
    "replay",
    "track_of",
]


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
    counts: dict[SampleUse, int]

    @property
    def ok(self) -> bool:
        """Whether the filter kept its estimate."""
        return self.status is FilterStatus.DONE


def identify_by_passes(
    joint: JointSystem,
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
    last: list[list[FilterStep]] = []
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
        innovations = np.array([each.innovation for steps in last for each in steps if each.use is SampleUse.USED])
        with np.errstate(over="ignore"):
            rmse.append(float(np.sqrt(np.mean(innovations**2))) if innovations.size else math.nan)
        mae.append(mean_absolute_error(filtered.model, records, smooth=smooth))
    lost = filtered.diverged
    tracks = tuple(track_of(joint, record, steps) for record, steps in zip(records, last, strict=False))
    return FilterRun(
        model if lost else filtered.model, FilterStatus.DIVERGED if lost else FilterStatus.DONE, tracks,
        tuple(rmse), tuple(mae), dict(filtered.counts),
    )  # fmt: skip


@dataclass(frozen=True)
class Track:
    """What a filter said along one record; every array has the shape (samples,).

    `values` holds for every free parameter its lower limit, estimate and upper limit: the estimate -+ 3 standard
    deviations in coordinates, carried back. `state` is the same for the first state, if there is one.
    """

    time_s: Array
    depth_mm: Array
    predicted: Array
    innovation: Array
    innovation_sd: Array
    used: NDArray[np.bool_]
    values: dict[str, tuple[Array, Array, Array]]
    state: tuple[Array, Array, Array] | None

    def innovation_rmse(self, rows: NDArray[np.bool_] | None = None) -> float:
        """Return the root mean square of the innovations that were used, of all rows or of some; NaN for none."""
        chosen = self.innovation[self.used if rows is None else self.used & rows]
        return float(np.sqrt(np.mean(chosen**2))) if chosen.size else float("nan")


def feed(filtered: JointFilter, record: Record, settle: int = 0) -> list[FilterStep]:
    """Feed one record, sample by sample, and return what the filter said; ends where it diverges.

    With `settle` the sample before each reversal is masked too, which a filter on line cannot know of. Raises DataError
    for a record without motion, or without the channel of the model.
    """
    motion = record.motion()
    measured = record[filtered.channel]
    masked = np.zeros(len(motion), bool)
    if settle:
        masked[:-1] = motion.direction[1:] * motion.direction[:-1] < 0
    columns = (motion.time_s, motion.depth_mm, measured, motion.velocity_mm_s, motion.angle_rad)
    steps = []
    for mask, *values in zip(masked.tolist(), *(each.tolist() for each in columns), strict=True):
        steps.append(filtered.update(FilterSample(*values), masked=mask))
        if steps[-1].use is SampleUse.DIVERGED:
            break
    return steps


def track_of(joint: JointSystem, record: Record, steps: list[FilterStep]) -> Track:
    """Return the steps of a record as arrays; shorter than the record where the filter diverged."""
    n = len(steps)
    x, sd = np.array([each.x for each in steps]), np.array([each.x_sd for each in steps])
    # [lower, estimate, upper] by [sample] by [parameter]
    limits = np.array([
        [list(joint.values(row).values()) for row in x + offset * sd] for offset in (-3.0, 0.0, 3.0)
    ])  # fmt: skip
    values = {name: (limits[0, :, k], limits[1, :, k], limits[2, :, k]) for k, name in enumerate(joint.free)}
    state = (x[:, 0] - 3 * sd[:, 0], x[:, 0], x[:, 0] + 3 * sd[:, 0]) if joint.states else None
    return Track(
        record["time_s"][:n], record["depth_mm"][:n], np.array([each.predicted for each in steps]),
        np.array([each.innovation for each in steps]), np.array([each.sd for each in steps]),
        np.array([each.use is SampleUse.USED for each in steps]), values, state,
    )  # fmt: skip


def replay(model: Model, record: Record, *, smooth: MovingAverage | None = None) -> Array:
    """Return what the model predicts for a record, shape (samples,), averaged as the sensor does if told."""
    output = simulate(model, record.motion()).output
    return output if smooth is None else smooth.apply(output)


def mean_absolute_error(model: Model, records: Sequence[Record], *, smooth: MovingAverage | None = None) -> float:
    """Return the mean of |measured - replayed| over all samples that were measured, in the channel's unit.

    Infinite where the simulation grows without bound, NaN where nothing was measured.
    """
    measured = np.concatenate([np.isfinite(record[model.channel]) for record in records])
    if not measured.any():
        return float("nan")
    with np.errstate(over="ignore", invalid="ignore"):
        errors = [np.abs(record[model.channel] - replay(model, record, smooth=smooth)) for record in records]
        error = float(np.mean(np.concatenate(errors)[measured]))
    return error if np.isfinite(error) else float("inf")
