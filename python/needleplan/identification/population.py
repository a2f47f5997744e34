r"""Insertions as a population: what the next insertion of a series will measure, and the first of a new series.

The values x_1 .. x_n of one quantity in n insertions of a series, in their order, follow a local level with a prior
that favours a steady series; equations (1) to (8) of docs/explanation/population.md::

    x_i = m + sum_(j<=i) w_j + e_i,    e_i ~ N(0, s^2),    w_j ~ N(0, q^2 s^2),    w_1 = 0                 (1)
    s^2 ~ scaled inverse chi^2 (a, s0^2),    P(q = 0) = 3/4,    the rest equal for q = 1/2, 1, 2, 4        (2)

Given q, the next value has a Student distribution around a weighted mean of the x_i. The distributions are mixed by the
probability of their q. Several quantities, such as the planes y and z of a path, are independent of each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.identification._correlated_noise import Marginal
from needleplan.signals import Array

__all__ = ["InsertionForecast", "deviation_mm", "new_series", "next_insertion", "setup_mm", "typical_scatter"]

# Probability of a region.
_LEVEL = 0.95
# Scatter of the direction of insertions through one guide: 0.1 mm of play in a guide of 20 mm (rad).
_PLAY_RAD = 0.005
# Scatter of the direction between series, for which needle, guide and tissue were set up again (rad).
_SETUP_RAD = 0.015
# Scatter of the measured position of a tip (mm): an electromagnetic tracker.
_TRACKER_MM = 0.1
# Number of insertions that the assumed scatter s0 counts for, a of equation (2).
_ASSUMED_COUNT = 4
# Values of q, the change of the level from insertion to insertion relative to the scatter s, and their probabilities.
_DRIFTS = (0.0, 0.5, 1.0, 2.0, 4.0)
_DRIFT_PRIOR = (0.75, 0.0625, 0.0625, 0.0625, 0.0625)
# Number of checked insertions from which their errors, and not the distribution, set the size of the region: the
# smallest number whose largest error is exceeded with a probability of at most 5 %.
_CONFORMAL = 19


def deviation_mm(length_mm: float) -> float:
    """Return s0 (mm), the assumed scatter between insertions of a series after an unmeasured length (mm)."""
    return math.hypot(_PLAY_RAD * length_mm, _TRACKER_MM)


def typical_scatter(series: Sequence[Array], scatter: float) -> Array:
    """Return s0 of each quantity, shape (p,), learned from other series, shape (n, p) each: equation (7).

    `scatter` is the assumed s0, which counts as much as `_ASSUMED_COUNT` insertions.
    """
    squares = sum(np.sum((one_series - one_series.mean(axis=0)) ** 2, axis=0) for one_series in series)
    count = _ASSUMED_COUNT + sum(len(one_series) - 1 for one_series in series)
    return np.asarray(np.sqrt((_ASSUMED_COUNT * scatter**2 + squares) / count))


def setup_mm(length_mm: float) -> float:
    """Return the assumed scatter (mm) between series, after a length (mm)."""
    return math.hypot(_SETUP_RAD * length_mm, _TRACKER_MM)


@dataclass(frozen=True)
class InsertionForecast(ShortRepr):
    """Forecast of p quantities in the next insertion.

    Parameters
    ----------
    values : Array
        Expected values, shape (p,).
    low, high : Array
        Ends of a region that holds all p values together with the probability 95 %, shape (p,).
    drift : float
        Probability that the level changes from insertion to insertion, q > 0: the largest of the p quantities.
    checked : int
        Number of earlier insertions whose errors set the size of the region; 0: the distribution sets it.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.identification import next_insertion
    >>> steady = next_insertion(np.array([[8.1], [7.8], [8.3], [7.9]]), 0.5)
    >>> jumped = next_insertion(np.array([[8.1], [7.8], [8.3], [4.1], [3.9]]), 0.5)
    >>> f"{steady.values[0]:.1f} {jumped.values[0]:.1f}", steady.drift < 0.3 < 0.9 < jumped.drift
    ('8.0 4.2', True)
    """

    values: Array
    low: Array
    high: Array
    drift: float
    checked: int = 0

    @property
    def regions(self) -> list[tuple[float, float]]:
        """Ends of the region of each quantity."""
        return list(zip(self.low.tolist(), self.high.tolist(), strict=True))

    def moved(self, by: Array) -> InsertionForecast:
        """Return the forecast with its values and its region moved by an array of shape (p,)."""
        return replace(self, values=self.values + by, low=self.low + by, high=self.high + by)


@dataclass(frozen=True)
class _Law:
    """Equation (3) for n insertions, one q and one prior of the level: what does not depend on the values.

    `weights` give the expected next value, shape (n,), `factor` its variance by s^2, `form` the quadratic form of the
    values in the posterior of s^2, shape (n, n), and `log` the logarithm of the normalisation of the likelihood.
    """

    weights: Array
    factor: float
    form: Array
    log: float


@cache
def _law(count: int, drift: float, level_sd: float) -> _Law:
    """Return the law; `level_sd` is the prior standard deviation of m in units of s, or infinite."""
    step = np.arange(count, dtype=float)
    inverse = np.linalg.inv(np.eye(count) + drift**2 * np.minimum.outer(step, step))
    shared = drift**2 * step
    sums = inverse.sum(axis=1)
    precision = float(sums.sum()) + level_sd**-2.0
    rest = 1.0 - float(sums @ shared)
    return _Law(
        inverse @ shared + rest * sums / precision,
        1.0 + drift**2 * count - float(shared @ inverse @ shared) + rest**2 / precision,
        inverse - np.outer(sums, sums) / precision,
        0.5 * float(np.linalg.slogdet(inverse)[1]) - 0.5 * math.log(precision),
    )


def next_insertion(
    values: Array, scatter: Array | float, *, level_sd: float = math.inf, ordered: bool = True
) -> InsertionForecast:
    """Forecast the measured values of the next insertion of a series, with a region of 95 % probability.

    A quantity, such as the lateral position of the tip, has the mean level m in the series and the standard deviation s
    between insertions; equations (1) to (8) of docs/explanation/population.md.

    Parameters
    ----------
    values : Array
        Measured values of p quantities in n insertions, shape (n, p), in any unit. n may be 0 if `level_sd` is finite.
    scatter : Array or float
        Assumed standard deviation s0 between insertions, of each quantity, shape (p,), in the unit of the values.
    level_sd : float
        Prior standard deviation of the level m around 0, relative to s. Infinite: the level is unknown.
    ordered : bool
        Whether the rows are in the order of their times. If not, the level is constant: no drift, q = 0.

    Returns
    -------
    InsertionForecast
        The forecast. From 20 insertions on, the errors of the earlier forecasts set the size of the region: equation
        (6).

    Raises
    ------
    DataError
        There is no insertion, a value is not finite, or a scatter is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.identification import next_insertion
    >>> tip = next_insertion(np.array([[8.5, 2.3], [8.0, 2.3], [8.1, 1.4]]), 0.5)
    >>> tip.values.round(1).tolist(), [round(high - low, 1) for low, high in tip.regions]
    ([8.2, 1.9], [3.3, 3.9])
    """
    x = np.asarray(values, float)
    if x.ndim != 2 or len(x) < (level_sd == math.inf) or not np.isfinite(x).all():
        raise DataError(Mistake("values", "", "must be finite numbers, a row for each of at least one insertion"))
    s0 = np.broadcast_to(np.asarray(scatter, float), x.shape[1:])
    if not (np.isfinite(s0) & (s0 > 0)).all():
        raise DataError(Mistake("scatter", f"{scatter}", "must be above 0"))
    planes = [_Plane(*column, level_sd, ordered) for column in zip(x.T, s0, strict=True)]
    if len(planes) > 1:  # equation (8)
        ratios = np.array([plane.scatter for plane in planes]) / s0
        shared = (np.sum(ratios**2) - ratios**2) / (len(planes) - 1)
        planes = [_Plane(*column, level_sd, ordered) for column in zip(x.T, s0 * np.sqrt(shared), strict=True)]
    drift = max(1.0 - float(plane.chances[0]) for plane in planes)
    if len(x) <= _CONFORMAL:
        ends = np.array([plane.interval(_LEVEL ** (1 / len(planes))) for plane in planes])
        return InsertionForecast(
            np.array([plane.expected(len(x))[0] for plane in planes]), ends[:, 0], ends[:, 1], drift
        )
    # Expected values and standard deviations of the insertions after the first, shape (n, p).
    means, sds = np.array([[plane.expected(number) for number in range(1, len(x) + 1)] for plane in planes]).T
    scores = np.sort(np.max(np.abs(x[1:] - means[:-1]) / sds[:-1], axis=1))
    # Equation (6): the smallest score that at least 95 % of the scores, and the next one, do not exceed.
    reach = scores[math.ceil(_LEVEL * (scores.size + 1)) - 1] * sds[-1]
    return InsertionForecast(means[-1], means[-1] - reach, means[-1] + reach, drift, scores.size)


class _Plane:
    """Posterior of one quantity: the probability of every q, `chances`, and the estimates of s^2, `variances`."""

    def __init__(self, x: Array, s0: float, level_sd: float, ordered: bool) -> None:
        self.x, self.level_sd = x, level_sd
        self.drifts = _DRIFTS if ordered else _DRIFTS[:1]
        laws = [_law(x.size, drift, level_sd) for drift in self.drifts]
        self.dof = _ASSUMED_COUNT + x.size - (level_sd == math.inf)
        squares = _ASSUMED_COUNT * s0**2 + np.array([x @ law.form @ x for law in laws])
        logs = np.array([law.log for law in laws]) - self.dof / 2 * np.log(squares)
        chances = np.exp(logs - logs.max()) * _DRIFT_PRIOR[: len(laws)]
        self.chances, self.variances = chances / chances.sum(), squares / self.dof

    @property
    def scatter(self) -> float:
        """Estimate of s, over all q."""
        return math.sqrt(float(self.chances @ self.variances))

    def _parts(self, count: int) -> tuple[Array, Array]:
        """Return expected values and variances of the insertion after the first `count`, for every q."""
        laws = [_law(count, drift, self.level_sd) for drift in self.drifts]
        centres = np.array([law.weights @ self.x[:count] for law in laws])
        return centres, self.variances * np.array([law.factor for law in laws])

    def expected(self, count: int) -> tuple[float, float]:
        """Return expected value and standard deviation of the insertion after the first `count`, over all q."""
        centres, variances = self._parts(count)
        mean = float(self.chances @ centres)
        return mean, math.sqrt(float(self.chances @ (variances + (centres - mean) ** 2)))

    def interval(self, level: float) -> tuple[float, float]:
        """Return the ends of the central interval of the next insertion, equation (5)."""
        centres, variances = self._parts(self.x.size)
        mixture = Marginal(self.chances, centres[:, None], variances[:, None, None], self.dof, 0.0, 1.0)
        return mixture.interval(np.ones(1), level)


def new_series(series: Sequence[Array], within: InsertionForecast, scatter: Array | float) -> InsertionForecast:
    """Forecast an insertion of a new series: needle, guide or tissue are set up again.

    Parameters
    ----------
    series : sequence of Array
        Values of the known series in their order, shape (n, p) each; the last one is the series of `within`.
    within : InsertionForecast
        Forecast of the next insertion of the last series, whose region holds the scatter in a series.
    scatter : Array or float
        Assumed scatter between series, shape (p,).

    Returns
    -------
    InsertionForecast
        Forecast from the means of the series, which follow the law of insertions without a drift. The half width of the
        region is sqrt(b^2 + w^2), with the half widths b of the forecast between series and w of `within`.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.identification import new_series, next_insertion
    >>> tips = np.array([[8.5, 2.3], [8.0, 2.3], [8.1, 1.4]])
    >>> tip = next_insertion(tips, 0.5)
    >>> other = new_series([tips], tip, 1.5)
    >>> bool((other.high - other.low > 3 * (tip.high - tip.low)).all())
    True
    """
    between = next_insertion(np.array([np.mean(one_series, axis=0) for one_series in series]), scatter, ordered=False)
    low = between.values - np.hypot(between.values - between.low, within.values - within.low)
    high = between.values + np.hypot(between.high - between.values, within.high - within.values)
    return InsertionForecast(between.values, low, high, between.drift, between.checked)
