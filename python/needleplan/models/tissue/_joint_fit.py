"""Stiffness and damping of the tissue together with its friction, from the force of a periodic motion.

The alternative to a slow observer: nothing is tuned, amplitude and lag of the tissue follow from two parameters with
intervals, and data of several amplitudes and frequencies go in together. Starts come from the data: friction as large
as the force, tissue as soft as the gap of the loop says. The first fit is on every fifth sample, and shows which start
leads where; the last one on all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.models._fit import Fit, fit
from needleplan.models._simulate import simulate
from needleplan.models.tissue._moving import LumpedOnTissue
from needleplan.models.tissue._slow_observer import tune_slow_observer
from needleplan.signals import Array, MovingAverage, Record, dominant_frequency_hz, lag_rad, sine_at

__all__ = ["fit_on_tissue", "lag_with_sd", "tissue_lag_rad", "tissue_start"]

_COARSE_HZ = 40.0
_SMALL_LAG_RAD = 0.03
_COARSE = 25
"""Evaluations of each coarse fit: it has to find the valley and not its bottom."""


def tissue_start(record: Record) -> LumpedOnTissue:
    """Return where to start: of the size of the record's force and velocity. Raises DataError for missing columns."""
    motion, force = record.motion(), record["force_n"]
    frequency = dominant_frequency_hz(motion.time_s, motion.depth_mm)
    top = float(np.percentile(np.abs(motion.velocity_mm_s), 98))
    largest = float(np.nanpercentile(np.abs(force), 98))
    if not top > 0 or not largest > 0:
        raise DataError(Mistake("force_n", "", "is zero, or the needle at rest: there is no friction"), record.trial)
    seen = np.isfinite(force)
    fundamental = sine_at(frequency, motion.time_s[seen], force[seen]).amplitude
    lag = _SMALL_LAG_RAD
    if seen.all():
        try:
            tuned = tune_slow_observer(motion.time_s, motion.depth_mm, force)
        except DataError:  # uneven times: only the start is coarser
            tuned = None
        if tuned and tuned.projection:
            lag = max(float(tuned.projection.lag_rad(frequency)), lag)
    stiffness = float(np.clip(2 * np.pi * frequency * fundamental / (top * np.tan(min(lag, 1.2))), 1e-3, 1e2))
    return LumpedOnTissue(
        sigma0=25 / top, sigma1=5 / top, sigma2=0.2 * largest / top, mu_c=largest, mu_s=0.15 * largest, alpha=2.5 / top,
        stiffness=stiffness, damping=0.2 * stiffness,
    )  # fmt: skip


def fit_on_tissue(
    records: Sequence[Record],
    *,
    start: LumpedOnTissue | None = None,
    average: int = 5,
    starts: int = 2,
    free: Sequence[str] | None = None,
    mask: Callable[[Record], Array] | None = None,
) -> Fit:
    """Fit friction and tissue to all records at once; columns time_s, depth_mm, velocity_mm_s, force_n.

    The velocity must not be late (`velocity_without_delay`). `average` is the number of samples that the force sensor
    has averaged; 1 for none. Further `starts` are drawn around the first, within a factor of about two. Raises
    DataError for records that cannot be used.
    """
    if not records:
        raise DataError(Mistake("records", "", "there is none"))
    first = start or tissue_start(records[0])
    smooth = MovingAverage(average).apply
    strides = [max(round(1 / (_COARSE_HZ * float(np.median(np.diff(each["time_s"]))))), 1) for each in records]
    if max(strides) > 1:
        coarse = [each.select(slice(None, None, stride)) for each, stride in zip(records, strides, strict=True)]
        try:
            found = fit(first, coarse, free=free, mask=mask, starts=starts, spread=0.7, max_evaluations=_COARSE)
            first, starts = found.model if isinstance(found.model, LumpedOnTissue) else first, 1
        except DataError:  # too short once thinned out: all of it then
            pass
    return fit(first, records, free=free, mask=mask, smooth=smooth, starts=starts, spread=0.7)


def tissue_lag_rad(model: LumpedOnTissue, record: Record, frequency_hz: float) -> float:
    """Return by how much the velocity against the tissue lags that of the needle, without the first cycle."""
    motion = record.motion()
    states = simulate(model, motion).states
    settled = motion.time_s - motion.time_s[0] >= min(1 / frequency_hz, 0.5 * float(np.ptp(motion.time_s)))
    relative = motion.velocity_mm_s - states[2]
    return lag_rad(frequency_hz, motion.time_s[settled], relative[settled], motion.velocity_mm_s[settled])


def lag_with_sd(found: Fit, record: Record, frequency_hz: float) -> tuple[float, float]:
    """Return the lag of the fitted tissue and its standard deviation (rad), to first order in the parameters."""
    model = found.model
    if not isinstance(model, LumpedOnTissue):
        raise TypeError(f"a fit of LumpedOnTissue is needed, this is one of {type(model).__name__}")
    what = model.parameters()
    slopes = []
    for name in found.free:
        u = what[name].coordinate(getattr(model, name))
        ends = [
            float(np.clip(what[name].value(u + step), what[name].lower, what[name].upper)) for step in (-0.01, 0.01)
        ]
        lags = [tissue_lag_rad(model.with_values(**{name: end}), record, frequency_hz) for end in ends]
        slopes.append((lags[1] - lags[0]) / 0.02)
    gradient = np.array(slopes)
    known = np.isfinite(np.diag(found.covariance))
    variance = gradient[known] @ found.covariance[np.ix_(known, known)] @ gradient[known]
    return tissue_lag_rad(model, record, frequency_hz), float(np.sqrt(max(variance, 0.0)))
