"""Curvature of a steered needle in 3D, from recorded insertions with rotations.

Unknown is one ratio of the true to the planned curvature, in all tissues. The direction of a steered needle is a random
walk with a known drift. Residuals along its path are not independent, so that the intervals of a least-squares fit
would be too narrow. The tip filter is the estimator of this model: its state has the ratio, its process noise is the
tip noise of the plan, and it takes rolls, torsional lag and tracker noise into account. Here the filter runs over the
samples of an insertion, with a wide prior and a constant ratio. The estimate at the end uses the whole path.

The ratio is the mean over the insertions, and its interval that of `trials.combine`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.anatomy import SpaceScenario
from needleplan.artifacts import ShortRepr
from needleplan.devices import Health, PoseSample, StageSample
from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipFilter, TipSettings
from needleplan.models.trials import combine

__all__ = ["SpaceCurvature", "SpaceInsertion", "entry_of", "space_curvature"]

# Standard deviation of the ratio before the first pose.
_PRIOR_SD = 1.0
# Distance of the stage (mm) from its first depth below which the needle still rests before the entry.
_REST_MM = 0.05
# Least number of usable poses at rest.
_POSES = 5


@dataclass(frozen=True)
class SpaceInsertion(ShortRepr):
    """Samples of one insertion, in the order of their arrival, with the registration and the zeros of the stage.

    `registration` leads to the frame of the lattice. `entry_depth_mm` and `roll_left_rad` are the zeros of the stage.
    """

    name: str
    samples: Sequence[StageSample | PoseSample]
    registration: Registration
    settings: TipSettings
    entry_depth_mm: float = 0.0
    roll_left_rad: float = 0.0


@dataclass(frozen=True)
class SpaceCurvature(ShortRepr):
    """Ratio of the true to the planned curvature.

    - `ratio`, `sd`: mean over the insertions, and its standard deviation.
    - `interval`: 95 % interval of the mean. With one insertion, it lacks the scatter between insertions.
    - `insertions`: name, ratio and standard deviation of each insertion.
    """

    ratio: float
    sd: float
    interval: tuple[float, float]
    insertions: tuple[tuple[str, float, float], ...]

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.ratio:.3f} times the planned curvature (95 % interval {low:.3f} to {high:.3f})"


def space_curvature(scenario: SpaceScenario, insertions: Sequence[SpaceInsertion]) -> SpaceCurvature:
    """Return the ratio of the true to the planned curvature of insertions.

    Parameters
    ----------
    scenario : SpaceScenario
        The planned curvature at each position.
    insertions : sequence of SpaceInsertion
        At least one insertion.

    Returns
    -------
    SpaceCurvature

    Raises
    ------
    DataError
        If there is no insertion, one has no samples of the needle at rest before its entry or loses the tip, or the
        ratio is not above 0.
    """
    ratios = [(insertion.name, *_of_one(scenario, insertion)) for insertion in insertions]
    if not ratios:
        raise DataError(Mistake("insertions", "", "must be at least one"))
    mean = combine([ratio for _, ratio, _ in ratios], [sd for _, _, sd in ratios])
    if not mean.value > 0:
        rule = "must be above 0: the insertions do not show to which side the needle bends"
        raise DataError(Mistake("ratio of the curvature", f"{mean.value:.3g}", rule))
    return SpaceCurvature(mean.value, mean.sd, mean.interval(), tuple(ratios))


def _of_one(scenario: SpaceScenario, insertion: SpaceInsertion) -> tuple[float, float]:
    """Return ratio and standard deviation of one insertion."""
    settings = replace(insertion.settings, factor_sd=_PRIOR_SD, factor_sd_sqrt_mm=0.0, change_sd_per_mm=0.0)
    tip = TipFilter(insertion.registration, entry_of(insertion), scenario.planned_per_mm, settings)
    for sample in insertion.samples:
        if isinstance(sample, StageSample):
            depth, roll = sample.depth_mm - insertion.entry_depth_mm, sample.roll_rad - insertion.roll_left_rad
            tip.predict(replace(sample, depth_mm=depth, roll_rad=roll))
        else:
            tip.update(sample)
    estimate = tip.tip
    if not estimate.usable:
        rule = f"must end with a known tip, and its status is {estimate.status}"
        raise DataError(Mistake("insertion", insertion.name, rule))
    return estimate.curvature_factor, estimate.curvature_factor_sd


def entry_of(insertion: SpaceInsertion) -> tuple[float, float, float, float, float]:
    """Return the measured entry: the mean over the poses of the needle at rest before it.

    Parameters
    ----------
    insertion : SpaceInsertion
        Samples that begin with the needle at rest.

    Returns
    -------
    tuple of float
        x_mm, y_mm, heading_rad, z_mm, elevation_rad in the frame of the lattice.

    Raises
    ------
    DataError
        If the insertion does not begin with at least 5 usable poses of the needle at rest.
    """
    rows: list[list[float]] = []
    first: float | None = None
    for sample in insertion.samples:
        if isinstance(sample, StageSample):
            first = sample.depth_mm if first is None else first
            if abs(sample.depth_mm - first) > _REST_MM:
                break
        elif sample.health is Health.GOOD and first is not None:
            position, direction = insertion.registration.place(sample.position_mm, sample.quaternion)
            ahead = insertion.registration.coil_offset_mm - (first - insertion.entry_depth_mm)
            rows.append([*(at + ahead * along for at, along in zip(position, direction, strict=True)), *direction])
    if len(rows) < _POSES:
        rule = f"must begin with at least {_POSES} usable poses of the needle at rest"
        raise DataError(Mistake("insertion", insertion.name, rule))
    x, y, z, dx, dy, dz = np.mean(rows, axis=0).tolist()
    return x, y, math.atan2(dy, dx), z, math.atan2(dz, math.hypot(dx, dy))
