"""Identification by several passes of a joint filter over records, and the open-loop simulation of a model.

The passes converge to the noise floor from initial values that are far off. Measured contributions to this
reliability, in decreasing order:

1. coordinates in which the model cannot become unstable (logarithms; see `JointForce`),
2. masked samples around reversals,
3. several passes with decreasing initial standard deviations,
4. a large R in the first passes, which acts as a trust region,
5. one joint filter instead of a bank of filters,
6. the exponential step of the state.

The form of the covariance update makes no difference: Joseph form, square root and plain form agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import CallRepr, ShortRepr
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
]


@dataclass(frozen=True)
class Recipe(CallRepr):
    """Settings of the passes; the defaults suit forces in N.

    A coordinate is a transformed parameter, usually its logarithm.

    - `variances`: measurement variance R of each pass, in the squared unit of the channel.
    - `spreads`: initial standard deviation of a coordinate in each pass, in units of ln(`factor`).
    - `factor`: factor by which an initial parameter may be wrong.
    - `walk`: variance that a coordinate gains per sample.
    - `settle`: number of masked samples after a reversal of the motion; above 0, the sample before the reversal is
      masked too.
    - `reach`: largest distance of a coordinate from its value at the start of the first pass, in units of ln(`factor`).
    - `limit`: largest change of a coordinate in one sample.

    Raises DataError if `variances` is empty or `spreads` has another length.
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
            rule = "must be one number for each pass, as many as there are variances"
            raise DataError(Mistake("spreads", f"{len(self.spreads)} numbers", rule))


class FilterStatus(StrEnum):
    """Outcome of the passes of the joint filter over the records of a motion."""

    DONE = "done"
    """All passes were completed."""

    DIVERGED = "diverged"
    """A state or a parameter stopped being finite."""


@dataclass(frozen=True)
class FilterRun(ShortRepr):
    """Result of the passes of the joint filter over the records.

    - `model`: the identified model, or the initial model if the filter diverged.
    - `tracks`: the tracks of the last pass, one for each record up to the record at which the filter diverged.
    - `innovation_rmse`: for each completed pass, root mean square of the used innovations, in the unit of the channel.
    - `replay_mae`: for each completed pass, mean absolute error of the open loop (the model after the pass, simulated
      along all records), in the unit of the channel. The innovations of a filter may be small although its parameters
      are wrong; the open loop reveals wrong parameters.
    - `counts`: number of samples for each kind of use, over all passes.
    """

    model: Model
    status: FilterStatus
    tracks: tuple[Track, ...]
    innovation_rmse: tuple[float, ...]
    replay_mae: tuple[float, ...]
    counts: dict[SampleUse, int]

    @property
    def ok(self) -> bool:
        """Whether the filter did not diverge."""
        return self.status is FilterStatus.DONE


def identify_by_passes(
    joint: JointSystem,
    model: Model,
    records: Sequence[Record],
    recipe: Recipe | None = None,
    *,
    smooth: MovingAverage | None = None,
) -> FilterRun:
    """Identify a model by filtering all records in several passes, starting from the parameters of `model`.

    A start at a bound is moved away from the bound first (`JointSystem.released`).

    The covariance continues from record to record within a pass, and is reset between passes. The passes end early if
    the filter diverges.

    Parameters
    ----------
    joint
        Joint system of the model.
    model
        Model with the initial values of the parameters.
    records
        Records with the channel of the model and a motion.
    recipe
        Settings of the passes; the default is `Recipe()`.
    smooth
        Moving average of the sensor, applied to the open loop only.

    Returns
    -------
    FilterRun

    Raises
    ------
    DataError
        There is no record, or a record lacks the channel or the motion.
    """
    recipe = recipe or Recipe()
    if not records:
        raise DataError(Mistake("records", "", "there is none"))
    sd = math.log(recipe.factor)
    rmse, mae = [], []
    last: list[list[FilterStep]] = []
    start = joint.released(model, recipe.factor)
    filtered = JointFilter(
        joint, start, variance=recipe.variances[0], sd=sd * recipe.spreads[0], walk=recipe.walk, settle=recipe.settle,
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
        innovations = np.array([step.innovation for steps in last for step in steps if step.use is SampleUse.USED])
        with np.errstate(over="ignore"):
            rmse.append(float(np.sqrt(np.mean(innovations**2))) if innovations.size else math.nan)
        mae.append(mean_absolute_error(filtered.model, records, smooth=smooth))
    lost = filtered.diverged
    tracks = tuple(_track_of(joint, record, steps) for record, steps in zip(records, last, strict=False))
    return FilterRun(
        model if lost else filtered.model, FilterStatus.DIVERGED if lost else FilterStatus.DONE, tracks,
        tuple(rmse), tuple(mae), dict(filtered.counts),
    )  # fmt: skip


@dataclass(frozen=True)
class Track(ShortRepr):
    """Results of a filter along one record. Every array has the shape (samples,).

    `values` maps each free parameter to lower limit, estimate and upper limit, in the unit of the parameter. The limits
    are 3 standard deviations from the estimate in the coordinates of the filter. `state` holds the same for the first
    state of the model, or is None if the model has no state. `used` marks the samples that corrected the estimate.
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
        """Return the root mean square of the used innovations; NaN if there are none.

        `rows` is a mask of the samples to include, shape (samples,); None includes all.
        """
        chosen = self.innovation[self.used if rows is None else self.used & rows]
        return float(np.sqrt(np.mean(chosen**2))) if chosen.size else float("nan")


def feed(filtered: JointFilter, record: Record, settle: int = 0) -> list[FilterStep]:
    """Filter one record and return the result of each sample, up to the sample at which the filter diverges.

    Parameters
    ----------
    filtered : JointFilter
        Filter. It masks the samples after a reversal.
    record : Record
        Record with the motion and the channel of the model.
    settle : int, default 0
        If not 0, the sample before each reversal is masked too, which an online filter cannot do.

    Returns
    -------
    list of FilterStep

    Raises
    ------
    DataError
        The record lacks the motion or the channel of the model.
    """
    motion = record.motion()
    measured = record[filtered.channel]
    masked = np.zeros(len(motion), bool)
    if settle:
        masked[:-1] = motion.direction[1:] * motion.direction[:-1] < 0
    columns = (motion.time_s, motion.depth_mm, measured, motion.velocity_mm_s, motion.angle_rad)
    steps = []
    for mask, *values in zip(masked.tolist(), *(column.tolist() for column in columns), strict=True):
        steps.append(filtered.update(FilterSample(*values), masked=mask))
        if steps[-1].use is SampleUse.DIVERGED:
            break
    return steps


def _track_of(joint: JointSystem, record: Record, steps: list[FilterStep]) -> Track:
    """Return the filter results of a record as arrays.

    Parameters
    ----------
    joint : JointSystem
        Joint system of the filter.
    record : Record
        Record that was filtered.
    steps : list of FilterStep
        Result of `feed`, at least one; fewer than the samples of the record if the filter diverged.

    Returns
    -------
    Track
        Arrays of the length of `steps`, with limits at 3 standard deviations.
    """
    n = len(steps)
    x, sd = np.array([step.x for step in steps]), np.array([step.x_sd for step in steps])
    # [lower, estimate, upper] by [sample] by [parameter]
    limits = np.array([
        [list(joint.values(row).values()) for row in x + offset * sd] for offset in (-3.0, 0.0, 3.0)
    ])  # fmt: skip
    values = {name: (limits[0, :, k], limits[1, :, k], limits[2, :, k]) for k, name in enumerate(joint.free)}
    state = (x[:, 0] - 3 * sd[:, 0], x[:, 0], x[:, 0] + 3 * sd[:, 0]) if joint.states else None
    return Track(
        record["time_s"][:n], record["depth_mm"][:n], np.array([step.predicted for step in steps]),
        np.array([step.innovation for step in steps]), np.array([step.sd for step in steps]),
        np.array([step.use is SampleUse.USED for step in steps]), values, state,
    )  # fmt: skip


def replay(model: Model, record: Record, *, smooth: MovingAverage | None = None) -> Array:
    """Simulate the model along the motion of a record (open loop).

    Parameters
    ----------
    model : Model
        Model with the parameters to simulate.
    record : Record
        Record with the motion.
    smooth : MovingAverage, optional
        Moving average of the sensor, applied to the output. Default: none.

    Returns
    -------
    numpy.ndarray
        Output in the unit of the channel, shape (samples,).
    """
    output = simulate(model, record.motion()).output
    return output if smooth is None else smooth.apply(output)


def mean_absolute_error(model: Model, records: Sequence[Record], *, smooth: MovingAverage | None = None) -> float:
    """Return the mean absolute error of the simulated output (open loop) over all measured samples.

    Parameters
    ----------
    model : Model
        Model with the parameters to simulate.
    records : sequence of Record
        Records with the motion and the channel of the model.
    smooth : MovingAverage, optional
        Moving average of the sensor, applied to the output. Default: none.

    Returns
    -------
    float
        Error in the unit of the channel; infinite if the simulation grows without bound, NaN if there is no measured
        sample.
    """
    measured = np.concatenate([np.isfinite(record[model.channel]) for record in records])
    if not measured.any():
        return float("nan")
    with np.errstate(over="ignore", invalid="ignore"):
        errors = [np.abs(record[model.channel] - replay(model, record, smooth=smooth)) for record in records]
        error = float(np.mean(np.concatenate(errors)[measured]))
    return error if np.isfinite(error) else float("inf")
