"""Automatic tuning of the slow observer of chapter 4: the opening of the friction-velocity loop at zero force.

The thesis chooses alpha1 of the slow observer "by trial and error" until the friction-velocity loop is centred. Here
the force F passes the same low-pass filter as the velocity of the fast observer; otherwise alpha1 would be 1 to 4 1/s
too large. The width of the loop at zero force is::

    G(alpha1) = median of v_s at rising zero crossings of F - median of v_s at falling zero crossings of F

v_s is the velocity of the slow observer. G is positive if the slow observer delays too little; more delay makes G
smaller. The tuned alpha1 is the largest alpha1 at which G becomes positive as alpha1 grows.

**Accuracy** (docs/explanation/tissue-motion.md). If friction rises with the velocity, the lag is correct to within two
degrees. If friction is almost dry, the lag is 8 to 12 degrees too large, because bristles that bend before they slide
open the loop too. On stiff tissue the damping of the bristles closes the loop. There is then nothing to compensate, and
the status is `NO_COMPENSATION`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals import FAST_ALPHA1, Array, HighGainObserver, Projection

__all__ = ["SlowObserver", "TuningStatus", "tune_slow_observer"]

# Range of alpha1 that is searched, 1/s; alpha1 of the fast observer is 40.
_SLOWEST, _FASTEST = 1.5, 39.9
# Number of values of alpha1 at which G is computed before the bisection.
_TRIED = 40
# Relative deviation of a sampling interval above which a record is refused.
_UNEVEN = 0.02
# Precision of the tuned alpha1, 1/s.
_PRECISION = 1e-6


class TuningStatus(StrEnum):
    """How the tuning of a slow observer ended."""

    COMPENSATED = "compensated"
    """A slow observer that closes the loop was found."""

    NO_COMPENSATION = "no_compensation"
    """G does not become positive as alpha1 grows: no slow observer closes the loop. Use the fast observer."""

    TOO_FEW_CROSSINGS = "too_few_crossings"
    """The force does not cross zero at least once in each direction."""


@dataclass(frozen=True)
class SlowObserver(CallRepr):
    """Result of the tuning of a slow observer.

    `projection` is None unless the status is COMPENSATED. `alphas` (1/s) and `gaps_mm_s`, shape (40,), are the curve
    G(alpha1); `gaps_mm_s` is empty if the status is TOO_FEW_CROSSINGS. `upward` and `downward` are the numbers of
    rising and falling zero crossings. `gap_sd_mm_s` is the standard deviation of G at the tuned alpha1, from the
    scatter of the crossings; infinite unless compensated, and for only one rising or only one falling crossing.
    """

    status: TuningStatus
    projection: Projection | None
    alphas: Array
    gaps_mm_s: Array
    upward: int
    downward: int
    gap_sd_mm_s: float = np.inf

    @property
    def alpha1(self) -> float | None:
        """alpha1 of the slow observer, 1/s; None if the status is not COMPENSATED."""
        return self.projection.slow.alpha1 if self.projection else None

    def lag_sd_rad(self, frequency_hz: float) -> float:
        """Return the standard deviation (rad) of the lag at a frequency, to first order; infinite without compensation.

        The standard deviation follows from the scatter of the zero crossings of the force, without the bias that
        friction causes in all crossings.
        """
        if self.projection is None or self.alpha1 is None:
            return np.inf
        near = int(np.clip(np.searchsorted(self.alphas, self.alpha1), 1, self.alphas.size - 1))
        fast, interval = self.projection.fast.alpha1, self.projection.fast.interval_s
        ends = [
            Projection.critically_damped(alpha, interval, fast) for alpha in self.alphas[near - 1 : near + 1].tolist()
        ]
        lags = [float(end.lag_rad(frequency_hz)) for end in ends]
        change = float(self.gaps_mm_s[near] - self.gaps_mm_s[near - 1])
        return self.gap_sd_mm_s * abs((lags[1] - lags[0]) / change) if change else np.inf


def tune_slow_observer(
    time_s: Array, depth_mm: Array, force_n: Array, *, fast_alpha1: float = FAST_ALPHA1, skip_s: float = 1.0
) -> SlowObserver:
    """Choose alpha1 of the slow observer for a record.

    Parameters
    ----------
    time_s, depth_mm, force_n : Array
        Evenly spaced samples, shape (samples,) each.
    fast_alpha1 : float
        alpha1 of the fast observer, 1/s.
    skip_s : float
        Time at the beginning of the record that is not used.

    Returns
    -------
    SlowObserver
        Status, and the tuned pair of observers.

    Raises
    ------
    DataError
        If the shapes differ, there are fewer than three samples, a number is not finite, time does not increase, or a
        sampling interval deviates from the median by more than 2 %.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import sinusoid
    >>> model = npl.models.LumpedOnTissue(
    ...     mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09, stiffness=0.1, damping=0.02
    ... )
    >>> motion = sinusoid(offset_mm=60.0, amplitude_mm=25.0, frequency_hz=0.1, cycles=2.0, rate_hz=50.0)
    >>> force = npl.models.simulate(model, motion).output
    >>> str(npl.models.tune_slow_observer(motion.time_s, motion.depth_mm, force).status)
    'compensated'
    """
    from scipy.optimize import bisect

    time, depth, force = (np.asarray(array, float) for array in (time_s, depth_mm, force_n))
    interval = _even_interval(time, depth, force)
    fast = HighGainObserver.critically_damped(fast_alpha1, interval)
    filtered = fast.normalised.apply(force)
    crossing, share, rises = _crossings(filtered, int(np.searchsorted(time, time[0] + skip_s)))
    alphas = np.geomspace(_SLOWEST, min(_FASTEST, 0.9975 * fast_alpha1), _TRIED)
    upward = int(np.count_nonzero(rises))
    downward = rises.size - upward
    if not upward or not downward:
        return SlowObserver(TuningStatus.TOO_FEW_CROSSINGS, None, alphas, np.zeros(0), upward, downward)

    def at_zero(alpha1: float) -> tuple[Array, Array]:
        velocity = HighGainObserver.critically_damped(alpha1, interval).transfer.apply(depth)
        crossed = velocity[crossing] + share * (velocity[crossing + 1] - velocity[crossing])
        return crossed[rises], crossed[np.logical_not(rises)]

    def gap(alpha1: float) -> float:
        up, down = at_zero(alpha1)
        return float(np.median(up) - np.median(down))

    gaps = np.array([gap(alpha) for alpha in alphas.tolist()])
    changes = np.flatnonzero((gaps[:-1] <= 0) & (gaps[1:] > 0))
    if not changes.size:
        return SlowObserver(TuningStatus.NO_COMPENSATION, None, alphas, gaps, upward, downward)
    last = int(changes[-1])
    alpha1 = float(bisect(gap, alphas[last], alphas[last + 1], xtol=_PRECISION))
    projection = Projection(fast, HighGainObserver.critically_damped(alpha1, interval))
    sides = [
        np.var(crossings, ddof=1) / crossings.size if crossings.size > 1 else np.inf for crossings in at_zero(alpha1)
    ]
    gap_sd = float(np.sqrt(sum(sides)))
    return SlowObserver(TuningStatus.COMPENSATED, projection, alphas, gaps, upward, downward, gap_sd)


def _even_interval(time: Array, depth: Array, force: Array) -> float:
    mistakes = [
        Mistake(name, f"shape {values.shape}", f"must be as long as time_s, {time.shape}")
        for name, values in (("depth_mm", depth), ("force_n", force))
        if values.shape != time.shape
    ]
    if not mistakes and (time.ndim != 1 or time.size < 3):
        mistakes = [Mistake("time_s", f"{time.size} samples", "must be at least three")]
    mistakes += [
        Mistake(name, "", "must be finite numbers")
        for name, values in (("time_s", time), ("depth_mm", depth), ("force_n", force))
        if not np.isfinite(values).all()
    ]
    if mistakes:
        raise DataError(mistakes)
    steps = np.diff(time)
    interval = float(np.median(steps))
    if not interval > 0 or np.abs(steps - interval).max() > _UNEVEN * interval:
        first = int(np.argmax(np.abs(steps - interval))) + 1
        rule = "must be evenly spaced in time, as the filters require: resample the record first"
        raise DataError(Mistake(f"time_s[{first}]", f"{time[first]:g}", rule))
    return interval


def _crossings(force: Array, begin: int) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
    """Return index, fraction and direction of each zero crossing of the force from sample `begin` on, shape (n,) each.

    The index is that of the sample before the crossing. The fraction is the position of the crossing within the step.
    The direction is True if the force rises.
    """
    below = force < 0
    before = np.flatnonzero(below[:-1] != below[1:])
    before = before[before >= begin]
    return before, force[before] / (force[before] - force[before + 1]), below[before]
