"""Joint identification of tissue stiffness, tissue damping and friction from the force of a periodic motion.

The joint identification is the alternative to a slow observer. Nothing is tuned: stiffness and damping, with intervals,
determine amplitude and lag of the tissue. Records of several amplitudes and frequencies are used together. The start
values come from the data: the friction from the measured force, the stiffness from the opening of the friction-velocity
loop. A coarse fit to thinned records chooses among the starts; the final fit uses all samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.models._estimates import Fit
from needleplan.models._fit import fit
from needleplan.models._simulate import simulate
from needleplan.models.tissue._moving import LumpedOnTissue
from needleplan.models.tissue._slow_observer import tune_slow_observer
from needleplan.signals import Array, MovingAverage, Record, dominant_frequency_hz, lag_rad, sine_at

__all__ = ["fit_on_tissue", "lag_with_sd", "tissue_lag_rad", "tissue_start"]

# Sampling rate of the coarse fit, Hz.
_COARSE_HZ = 40.0
# Smallest phase lag of the tissue that the start values assume, rad.
_SMALL_LAG_RAD = 0.03
# Largest number of evaluations of each coarse fit, which only selects the best local optimum.
_COARSE = 25


def tissue_start(record: Record) -> LumpedOnTissue:
    """Return a model with start values for a fit, from the magnitudes of force and velocity in a record.

    The stiffness also depends on the lag of a tuned slow observer, if the record allows the tuning. Raises DataError if
    a column is missing, the force is zero, or the needle is at rest.
    """
    motion, force = record.motion(), record["force_n"]
    frequency = dominant_frequency_hz(motion.time_s, motion.depth_mm)
    top = float(np.percentile(np.abs(motion.velocity_mm_s), 98))
    largest = float(np.nanpercentile(np.abs(force), 98))
    if not top > 0 or not largest > 0:
        raise DataError(Mistake("force_n", "", "is zero, or the needle is at rest: there is no friction"), record.trial)
    seen = np.isfinite(force)
    fundamental = sine_at(frequency, motion.time_s[seen], force[seen]).amplitude
    lag = _SMALL_LAG_RAD
    if seen.all():
        try:
            tuned = tune_slow_observer(motion.time_s, motion.depth_mm, force)
        except DataError:  # uneven times: keep the default start
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
    """Fit friction and tissue to all records at once.

    Parameters
    ----------
    records : sequence of Record
        Records with the columns time_s, depth_mm, velocity_mm_s and force_n. The velocity must have no delay
        (`needleplan.signals.velocity_without_delay`).
    start : LumpedOnTissue, optional
        First start. The default is `tissue_start` of the first record.
    average : int
        Number of samples that the force sensor averages; 1 for no averaging.
    starts : int
        Number of starts. Further starts are drawn around the first one, within a factor of about two.
    free : sequence of str, optional
        Names of the parameters to estimate. The default is all free parameters.
    mask : callable, optional
        Function from a record to the samples to use, bool of shape (samples,).

    Returns
    -------
    Fit
        The fit of a `LumpedOnTissue`.

    Raises
    ------
    DataError
        If there is no record, or `fit` or `tissue_start` cannot use a record.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, sinusoid
    >>> true = npl.models.LumpedOnTissue(
    ...     mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09, stiffness=0.5, damping=0.1
    ... )
    >>> motion = sinusoid(offset_mm=60.0, amplitude_mm=10.0, frequency_hz=0.2, cycles=2.0, rate_hz=20.0)
    >>> force = npl.models.simulate(true, motion).output
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm,
    ...                  "velocity_mm_s": motion.velocity_mm_s, "force_n": force})
    >>> found = npl.models.fit_on_tissue([record], start=true, average=1, starts=1, free=["stiffness", "damping"])
    >>> abs(found.model.stiffness - 0.5) < 0.01
    True
    """
    if not records:
        raise DataError(Mistake("records", "", "must contain at least one record"))
    first = start or tissue_start(records[0])
    smooth = MovingAverage(average).apply
    strides = [max(round(1 / (_COARSE_HZ * float(np.median(np.diff(record["time_s"]))))), 1) for record in records]
    if max(strides) > 1:
        coarse = [record.select(slice(None, None, stride)) for record, stride in zip(records, strides, strict=True)]
        try:
            coarse_fit = fit(first, coarse, free=free, mask=mask, starts=starts, spread=0.7, max_evaluations=_COARSE)
            first, starts = coarse_fit.model if isinstance(coarse_fit.model, LumpedOnTissue) else first, 1
        except DataError:  # too short after thinning: use all samples
            pass
    return fit(first, records, free=free, mask=mask, smooth=smooth, starts=starts, spread=0.7)


def tissue_lag_rad(model: LumpedOnTissue, record: Record, frequency_hz: float) -> float:
    """Return the phase lag (rad) of the sliding velocity (needle minus tissue) behind the velocity of the needle.

    The first cycle is left out, but at most half of the record.
    """
    motion = record.motion()
    states = simulate(model, motion).states
    settled = motion.time_s - motion.time_s[0] >= min(1 / frequency_hz, 0.5 * float(np.ptp(motion.time_s)))
    relative = motion.velocity_mm_s - states[2]
    return lag_rad(frequency_hz, motion.time_s[settled], relative[settled], motion.velocity_mm_s[settled])


def lag_with_sd(found: Fit, record: Record, frequency_hz: float) -> tuple[float, float]:
    """Return `tissue_lag_rad` of a fit and the standard deviation of this lag (rad), to first order in the parameters.

    Raises TypeError unless the fitted model is a `LumpedOnTissue`.
    """
    model = found.model
    if not isinstance(model, LumpedOnTissue):
        raise TypeError(f"`found` must be a fit of LumpedOnTissue, not of {type(model).__name__}")
    parameters = model.parameters()
    slopes = []
    for name in found.free:
        coordinate = parameters[name].coordinate(getattr(model, name))
        values = [parameters[name].value(coordinate + step) for step in (-0.01, 0.01)]
        ends = [float(np.clip(value, parameters[name].lower, parameters[name].upper)) for value in values]
        lags = [tissue_lag_rad(model.with_values(**{name: end}), record, frequency_hz) for end in ends]
        slopes.append((lags[1] - lags[0]) / 0.02)
    gradient = np.array(slopes)
    known = np.isfinite(np.diag(found.covariance))
    variance = gradient[known] @ found.covariance[np.ix_(known, known)] @ gradient[known]
    return tissue_lag_rad(model, record, frequency_hz), float(np.sqrt(max(variance, 0.0)))
