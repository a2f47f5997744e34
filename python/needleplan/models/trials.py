"""Numbers of several trials combined: mean, interval of the mean, range of the next trial, agreement of the trials.

Trial i of n measures theta with the scatter u_i between trials and its own error e_i (random effects)::

    x_i = theta + u_i + e_i,    u_i ~ N(0, tau^2),    e_i ~ N(0, s_i^2)                                 (1)

tau is unknown; the s_i are known or unknown. A regression has theta_i = (D b)_i with a design D of shape (n, k); the
mean is the design of one column of ones. With the diagonal matrix W of weights w_i and the residuals r = x - D b::

    w_i = 1 / (s_i^2 + mean(s^2)),    or w_i = 1 if the s_i are unknown                                  (2)
    b = (D'WD)^-1 D'W x,    P = W - WD (D'WD)^-1 D'W                                                     (3)
    cov(b) = q (D'WD)^-1,    q = r'Wr / (n - k)                                                          (4)
    interval of c'b:  c'b +- t sqrt(c' cov(b) c),    t of Student with n - k degrees of freedom          (5)

The weights (2) are the best ones if tau^2 is the mean of the s_i^2. They do not depend on the x_i. The variance (4) is
that of Hartung and Knapp (Statistics in Medicine 20 (2001) 1771). The scatter of the trials alone determines it, so a
common factor of all s_i, such as a wrong noise level, does not change the interval. The mean has a lower limit for
trials that agree by luck: its half width is at least the standard deviation for tau = 0, (sum 1/s_i^2)^(-1/2).

**Coverage.** For equal errors, (5) is Student's interval: it holds theta in 95 % of all cases for every tau. For
unequal unknown errors it holds theta in at least 95 % (Bakirov and Szekely, Journal of Mathematical Sciences 139 (2006)
6497; Ibragimov and Mueller, Journal of Business and Economic Statistics 28 (2010) 453). For known errors the coverage
depends on tau. `benches/results/trials.md` has it for two to five trials: 94 to 98 % with s_i up to 1 : 3, and 92 to
100 % with s_i up to 1 : 100.

**Two trials.** t is 12.7, and 4.3 with three trials. The half width with two equal trials is 6.4 times their
difference. The s_i cannot make this interval shorter: tau is unknown, and one difference hardly determines it. A third
trial makes the interval about three times shorter.

**Other intervals** leave the range of 92 to 98 % in the same simulation, with s_i up to 1 : 3. Weights 1 / (s_i^2 +
tau^2) with an estimated tau: 90 %. The same with q >= 1: 99.7 to 100 % with two trials. Interval (5), never narrower
than that for tau = 0: 99 % with two trials and tau = 0. Two standard deviations of the mean, or Birge's ratio: 52 to
92 % with tau >= s.

**The next trial** of a typical error has the variance S^2 around theta. S^2 and tau^2 follow by moments from (3)
(DerSimonian and Kacker, Contemporary Clinical Trials 28 (2007) 105)::

    S^2 = r'Wr / trace(P),    tau^2 = max(0, (r'Wr - trace(P diag(s^2))) / trace(P))                     (6)
    range of the next trial:  mean +- t sqrt(sd^2 + S^2)                                                 (7)

**Agreement** of trials with known s_i, tau = 0, is tested by Cochran's Q::

    Q = sum((x_i - m)^2 / s_i^2) ~ chi^2(n - 1),    m the mean with the weights 1 / s_i^2                (8)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, ndtri, stdtr, stdtrit

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.models._estimates import Estimate
from needleplan.models._parameter import Parameter
from needleplan.signals import Array

__all__ = ["TrialAgreement", "TrialMean", "TrialRegression", "agreement_of", "combine", "mean_estimate", "regress"]

# Probability of the intervals of parameters.
_LEVEL = 0.95
# Level of significance of Cochran's test of agreement.
_REJECTED = 0.05
# Standard deviation of a fit coordinate from which a trial does not determine the parameter, as in `fit`.
_UNDETERMINED = 1.0
# Smallest error of a trial, relative to the largest value, in the test of agreement: for data without noise.
_EXACT = 1e-9
# Largest coordinate whose exponential is a finite float.
_LARGEST_COORDINATE = 700.0


def _quantile(degrees: int, level: float) -> float:
    """Return the two-sided quantile of Student's distribution; without a degree of freedom, of the normal one."""
    return float(stdtrit(degrees, (1 + level) / 2) if degrees else ndtri((1 + level) / 2))


@dataclass(frozen=True)
class TrialMean(ShortRepr):
    """Mean over trials, or a linear combination of the coefficients of a regression over trials.

    Parameters
    ----------
    value, sd : float
        The mean and its standard deviation; `sd` is infinite for one trial without a standard deviation.
    degrees : int
        Degrees of freedom of `sd`; 0 for one trial, whose interval is normal and lacks the scatter between trials.
    scatter_sd : float or None
        Standard deviation of one trial around theta, S of equation (6): scatter between trials and error of the trial.
        None for one trial.
    between_sd : float or None
        Scatter between trials alone, tau of equation (6); None for one trial or unknown errors of the trials.

    Examples
    --------
    >>> from needleplan.models.trials import combine
    >>> low, high = combine([9.8, 10.1, 10.4]).interval()
    >>> print(f"{low:.2f} to {high:.2f}")
    9.35 to 10.85
    """

    value: float
    sd: float
    degrees: int
    scatter_sd: float | None
    between_sd: float | None

    def interval(self, level: float = _LEVEL) -> tuple[float, float]:
        """Return the ends of the interval (5) of the mean, which holds theta with the probability `level`."""
        reach = _quantile(self.degrees, level) * self.sd
        return self.value - reach, self.value + reach

    def next_trial(self, level: float = _LEVEL) -> tuple[float, float] | None:
        """Return the ends of the range (7), which holds the next trial with the probability `level`.

        None for one trial, which does not determine the scatter.
        """
        if self.scatter_sd is None:
            return None
        reach = _quantile(self.degrees, level) * math.hypot(self.sd, self.scatter_sd)
        return self.value - reach, self.value + reach

    def zero_test(self) -> tuple[float, float]:
        """Test whether theta is 0: return Student's t and the two-sided p-value."""
        return self._test(self.value, self.sd)

    def further_trial(self, value: float, within_sd: float) -> tuple[float, float]:
        """Test whether a further trial belongs to the same trials.

        Parameters
        ----------
        value, within_sd : float
            Value of the further trial, and the standard deviation of its error.

        Returns
        -------
        tuple of float
            Student's t of the difference, and the two-sided p-value. The standard deviation of the further trial is S
            of equation (6), or `within_sd` if S is smaller or unknown, which makes the test conservative.
        """
        return self._test(value - self.value, math.hypot(self.sd, max(self.scatter_sd or 0.0, within_sd)))

    def _test(self, difference: float, sd: float) -> tuple[float, float]:
        score = difference / sd if sd else math.copysign(math.inf, difference) if difference else 0.0
        return score, 2 * float(stdtr(self.degrees or math.inf, -abs(score)))

    def estimate(self, unit: str, *, identified: bool | None = None) -> Estimate:
        """Return the mean as an estimate with its 95 % interval.

        Parameters
        ----------
        unit : str
            Unit of the values.
        identified : bool, optional
            Whether the trials determine the parameter. Default: whether the interval excludes 0.

        Returns
        -------
        Estimate
            `between_sd` is the scatter S of the trials.
        """
        low, high = self.interval()
        known = not low <= 0 <= high if identified is None else identified
        return Estimate(self.value, self.sd, low, high, unit, known, self.scatter_sd)


@dataclass(frozen=True)
class TrialRegression(ShortRepr):
    """Regression over trials: coefficients b of equation (3) with their covariance.

    Parameters
    ----------
    coefficients : Array
        Shape (k,).
    covariance : Array
        Covariance of their errors, shape (k, k), equation (4).
    degrees : int
        Degrees of freedom, n - k.
    scatter_sd : float
        S of equation (6).
    between_sd : float or None
        tau of equation (6); None for unknown errors of the trials.
    """

    coefficients: Array
    covariance: Array
    degrees: int
    scatter_sd: float
    between_sd: float | None

    def combination(self, weights: ArrayLike) -> TrialMean:
        """Return the sum of the coefficients with `weights`, shape (k,)."""
        row = np.asarray(weights, float)
        sd = math.sqrt(max(float(row @ self.covariance @ row), 0.0))
        return TrialMean(float(row @ self.coefficients), sd, self.degrees, self.scatter_sd, self.between_sd)

    @property
    def quantile(self) -> float:
        """Two-sided 95 % quantile of Student's distribution."""
        return _quantile(self.degrees, _LEVEL)


def regress(design: ArrayLike, values: ArrayLike, within_sd: ArrayLike | None = None) -> TrialRegression:
    """Fit the values of trials by a linear law, equations (2) to (4) and (6).

    Parameters
    ----------
    design : array_like
        D, shape (n, k), of rank k < n.
    values : array_like
        x, shape (n,).
    within_sd : array_like, optional
        s, standard deviations of the errors of the trials, shape (n,). None: unknown.

    Returns
    -------
    TrialRegression
        Coefficients with their covariance.

    Raises
    ------
    DataError
        If there are not more trials than coefficients, or a number is not finite.
    """
    matrix, x = np.asarray(design, float), np.asarray(values, float)
    variance = None if within_sd is None else _checked(np.asarray(within_sd, float), len(x)) ** 2
    if not np.isfinite(x).all():
        raise DataError(Mistake("values", "", "must be finite numbers, one for each trial"))
    degrees = len(x) - matrix.shape[1]
    if degrees < 1:
        rule = f"are too few for {matrix.shape[1]} coefficients: at least {matrix.shape[1] + 1} are needed"
        raise DataError(Mistake("trials", f"{len(x)}", rule))
    weight = np.ones(len(x))
    if variance is not None and variance.any():
        weight = 1 / (variance / variance.mean() + 1)
    weighted = matrix * weight[:, None]
    inverse = np.linalg.inv(matrix.T @ weighted)
    coefficients = inverse @ weighted.T @ x
    residual = x - matrix @ coefficients
    squares = float(weight @ residual**2)
    spare = weight - np.einsum("ij,jk,ik->i", weighted, inverse, weighted)
    between = None
    if variance is not None:
        between = math.sqrt(max(squares - float(spare @ variance), 0.0) / float(spare.sum()))
    scatter = math.sqrt(squares / float(spare.sum()))
    return TrialRegression(coefficients, inverse * squares / degrees, degrees, scatter, between)


def combine(values: ArrayLike, within_sd: ArrayLike | None = None) -> TrialMean:
    """Return the mean of the values of trials, with its uncertainty.

    Parameters
    ----------
    values : array_like
        Value of each trial, shape (n,).
    within_sd : array_like, optional
        Standard deviation of the error of each trial, shape (n,). None: unknown.

    Returns
    -------
    TrialMean
        The mean. The standard deviation of a single trial is `within_sd`, or infinite.

    Raises
    ------
    DataError
        If there is no trial, or a number is not finite.

    Examples
    --------
    >>> from needleplan.models.trials import combine
    >>> two, three = combine([9.8, 10.2]), combine([9.8, 10.2, 10.0])
    >>> print(f"{two.interval()[1] - two.value:.1f}, {three.interval()[1] - three.value:.1f}")
    2.5, 0.5
    """
    x = np.atleast_1d(np.asarray(values, float))
    s = None if within_sd is None else _checked(np.atleast_1d(np.asarray(within_sd, float)), len(x))
    if not len(x) or not np.isfinite(x).all():
        raise DataError(Mistake("values", "", "must be finite numbers, at least one"))
    if len(x) == 1:
        return TrialMean(float(x[0]), math.inf if s is None else float(s[0]), 0, None, None)
    mean = regress(np.ones((len(x), 1)), x, s).combination([1.0])
    if s is None or not s.all():
        return mean
    least = float(np.sum(s**-2.0)) ** -0.5
    return replace(mean, sd=max(mean.sd, least / _quantile(mean.degrees, _LEVEL)))


def mean_estimate(parameter: Parameter, values: Sequence[float], within_sd: Sequence[float] | None = None) -> Estimate:
    """Return the mean of a parameter over trials, taken in its fit coordinate, with its 95 % interval.

    Parameters
    ----------
    parameter : Parameter
        Declaration of the parameter.
    values : sequence of float
        Value in each trial, in the unit of the parameter.
    within_sd : sequence of float, optional
        Standard deviation of each value, in the same unit; infinite if the trial does not determine the parameter.

    Returns
    -------
    Estimate
        The mean, with its interval inside the range of the parameter. Trials that do not determine the parameter are
        left out: those whose coordinate has a standard deviation of at least 1. If fewer than two trials are left, the
        result is that of the trial with the smallest standard deviation. One value without a standard deviation has the
        whole range as interval. `identified` is whether the half width in the coordinate is below 1.96, a factor of 7
        if the coordinate is the logarithm: the limit of a single fit.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.models.trials import mean_estimate
    >>> curvature = npl.models.Bicycle(0.01).parameters()["curvature_per_mm"]
    >>> mean = mean_estimate(curvature, [0.009, 0.011, 0.010])
    >>> print(f"{mean.low:.4f} to {mean.high:.4f} {mean.unit}")
    0.0075 to 0.0125 1/mm
    """
    x = np.array([parameter.coordinate(value) for value in values])
    s = None
    if within_sd is not None:
        s = np.array([sd / parameter.slope(value) for sd, value in zip(within_sd, values, strict=True)])
        chosen = np.flatnonzero(s < _UNDETERMINED)
        chosen = chosen if len(chosen) > 1 else np.array([int(np.argmin(s))])
        x, s = x[chosen], s[chosen]
        s = s if np.isfinite(s).all() else None
    mean = combine(x, s)
    value, low, high = (
        float(np.clip(parameter.value(min(end, _LARGEST_COORDINATE)), parameter.lower, parameter.upper))
        for end in (mean.value, *mean.interval())
    )
    slope = parameter.slope(value)
    scatter = None if mean.scatter_sd is None else mean.scatter_sd * slope
    identified = mean.interval()[1] - mean.value < _quantile(0, _LEVEL) * _UNDETERMINED
    return Estimate(value, mean.sd * slope, low, high, parameter.unit, identified, scatter)


@dataclass(frozen=True)
class TrialAgreement:
    """Cochran's test of whether trials measure one value, equation (8)."""

    q: float
    """Weighted sum of squared differences."""

    p_value: float
    """Probability of a sum at least as large if all trials measure one value."""

    @property
    def agree(self) -> bool:
        """Whether one value for all trials is not rejected at the level of 5 %."""
        return self.p_value >= _REJECTED


def agreement_of(values: ArrayLike, within_sd: ArrayLike) -> TrialAgreement:
    """Test whether trials with known errors measure one value, equation (8).

    Parameters
    ----------
    values, within_sd : array_like
        Value of each trial and the standard deviation of its error, shape (n,), n at least 2.

    Returns
    -------
    TrialAgreement
        Statistic and probability.

    Raises
    ------
    DataError
        If there are fewer than two trials, or a number is not finite.
    """
    x = np.asarray(values, float)
    s = _checked(np.asarray(within_sd, float), len(x))
    if len(x) < 2:
        raise DataError("one trial cannot agree with itself: at least two trials are needed")
    weight = 1 / np.maximum(s, _EXACT * max(float(np.max(np.abs(x))), _EXACT)) ** 2
    q = float(weight @ (x - weight @ x / weight.sum()) ** 2)
    return TrialAgreement(q, float(chdtrc(len(x) - 1, q)))


def _checked(within_sd: Array, count: int) -> Array:
    """Return the standard deviations. Raises DataError unless they are `count` finite numbers of at least 0."""
    if within_sd.shape != (count,) or not (np.isfinite(within_sd) & (within_sd >= 0)).all():
        raise DataError(Mistake("within_sd", "", f"must be {count} finite numbers of at least 0"))
    return within_sd
