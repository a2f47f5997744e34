"""Statistical tests of the residuals of a fit.

Residuals of filtered sensors are correlated, and tests for independent samples would reject every model. An
autoregression is therefore fitted to each record first (order by Akaike's criterion). Mean, trends and normality are
tested on the innovations of the autoregression, with the regressors filtered in the same way (Cochrane and Orcutt). The
whiteness test uses the unfiltered residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake
from needleplan.models._estimates import Fit
from needleplan.signals import UNITS, Array, Motion, Record

__all__ = ["Finding", "findings_of", "ljung_box", "residual_findings"]

_NAMES = (
    "whiteness",
    "zero mean",
    "trend with depth",
    "trend with velocity",
    "dependence on direction",
    "normality",
)

# p-value below which the text of a finding reports a deviation.
_SIGNIFICANT = 0.05
# Highest order of the autoregression, in samples.
_HIGHEST_ORDER = 20
# Number of samples below which nothing is tested.
_FEWEST = 20


@dataclass(frozen=True)
class Finding(CallRepr):
    """Result of one residual test.

    Parameters
    ----------
    name : str
        Name of the test, such as "trend with depth".
    statistic : float
        Test statistic; NaN if the test was not possible.
    p_value : float or None
        p-value; None if the test was not possible, 1 if its regression was singular (the statistic is then NaN).
    says : str
        The result in words.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import findings_of
    >>> from needleplan.signals import insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=20.0)
    >>> residuals = np.random.default_rng(0).normal(0.5, 0.1, len(motion))
    >>> findings_of([residuals], [motion], "mm")[1].says
    'the mean of the residuals is 0.5 mm: the model is off by that'
    """

    name: str
    statistic: float
    p_value: float | None
    says: str


def residual_findings(found: Fit, records: Sequence[Record]) -> tuple[Finding, ...]:
    """Test the residuals of a fit.

    Parameters
    ----------
    found : Fit
        The fit.
    records : sequence of Record
        The records of the fit, in the same order.

    Returns
    -------
    tuple of Finding
        Whiteness, zero mean, trends with depth and velocity, dependence on direction, and normality. If the data do not
        allow a test (too few samples, no change of direction), the p-value is None and the text gives the reason.

    Raises
    ------
    DataError
        If the number or the lengths of `records` are not those of the residuals of the fit.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=50.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, len(motion))
    >>> measured = npl.models.simulate(npl.models.Bicycle(0.01), motion).output + noise
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "y_mm": measured})
    >>> found = npl.models.fit(npl.models.Bicycle(0.005), record)
    >>> whiteness = npl.models.residual_findings(found, [record])[0]
    >>> whiteness.name, whiteness.p_value > 0.05
    ('whiteness', True)
    """
    if len(records) != len(found.residuals) or any(
        len(record) != left.size for record, left in zip(records, found.residuals, strict=True)
    ):
        raise DataError(Mistake("records", f"{len(records)}", "must be the records of the fit, in the same order"))
    unit = UNITS.get(found.model.channel, "")
    return findings_of(found.residuals, [record.motion() for record in records], unit)


def findings_of(residuals: Sequence[Array], motions: Sequence[Motion], unit: str) -> tuple[Finding, ...]:
    """Test given residuals.

    Parameters
    ----------
    residuals : sequence of Array
        Residuals of each record, shape (samples,); NaN for masked samples.
    motions : sequence of Motion
        Motion of each record.
    unit : str
        Unit of the residuals, for the texts.

    Returns
    -------
    tuple of Finding
        The results of the same tests as in `residual_findings`.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import findings_of
    >>> from needleplan.signals import insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=50.0)
    >>> mean = findings_of([np.random.default_rng(0).normal(0.5, 0.1, len(motion))], [motion], "mm")[1]
    >>> mean.p_value < 0.01
    True
    """
    good = [np.isfinite(values) for values in residuals]
    left = [values[mask] for values, mask in zip(residuals, good, strict=True)]
    motions = [motion[mask] for motion, mask in zip(motions, good, strict=True) if mask.any()]
    left = [values for values in left if values.size]
    if sum(map(len, left)) < _FEWEST:
        says = f"not tested: fewer than {_FEWEST} samples"
        return tuple(Finding(name, float("nan"), None, says) for name in _NAMES)
    filters = [_autoregression(residual) for residual in left]
    ones = [np.ones(residual.size) for residual in left]
    return (
        _whiteness(left),
        _mean(left, ones, filters, unit),
        _trend("trend with depth", "depth", left, [m.depth_mm for m in motions], filters, f"{unit}/mm"),
        _trend("trend with velocity", "velocity", left, [m.velocity_mm_s for m in motions], filters, f"{unit} s/mm"),
        _trend("dependence on direction", "direction", left, [m.direction for m in motions], filters, unit),
        _normality(left, filters),
    )


def ljung_box(residuals: Sequence[Array], lags: int | None = None) -> tuple[float, float, int]:
    """Test residuals for autocorrelation (Ljung and Box, Biometrika 65 (1978) 297).

    The statistics and the degrees of freedom of several records are summed. There is no correction for the number of
    fitted parameters, which is small beside the number of samples.

    Parameters
    ----------
    residuals : sequence of Array
        Residuals of each record, shape (samples,).
    lags : int, optional
        Number of lags, at least 1. The default is 20, but at most a fifth of the shortest record.

    Returns
    -------
    tuple of (float, float, int)
        Statistic, p-value and number of lags.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import ljung_box
    >>> statistic, p_value, lags = ljung_box([np.random.default_rng(0).normal(size=200)])
    >>> p_value > 0.05, lags
    (True, 20)
    """
    from scipy.special import chdtrc  # scipy.stats would take as long to import as a diagnosis runs

    most = min(20, min(map(len, residuals)) // 5) if lags is None else lags
    most = max(most, 1)
    total = 0.0
    for values in residuals:
        n = values.size
        centred = values - values.mean()
        power = float(centred @ centred)
        if power > 0:
            ratios = [float(centred[lag:] @ centred[:-lag]) / power for lag in range(1, most + 1)]
            total += n * (n + 2) * sum(ratio**2 / (n - lag) for lag, ratio in enumerate(ratios, start=1))
    return total, float(chdtrc(most * len(residuals), total)), most


def _whiteness(left: Sequence[Array]) -> Finding:
    statistic, p_value, lags = ljung_box(left)
    first = np.mean([np.corrcoef(residual[1:], residual[:-1])[0, 1] if np.ptp(residual) else 0.0 for residual in left])
    says = (
        f"neighbouring residuals are correlated ({first:.2f} from one to the next): there is structure left, or "
        "the sensor is filtered"
        if p_value < _SIGNIFICANT
        else f"no correlation over {lags} samples was found"
    )
    return Finding("whiteness", statistic, p_value, says)


def _mean(left: Sequence[Array], ones: Sequence[Array], filters: Sequence[Array], unit: str) -> Finding:
    size, statistic, p_value = _slope(left, [], ones, filters)
    says = (
        f"the mean of the residuals is {size:.3g} {unit}: the model is off by that"
        if p_value < _SIGNIFICANT
        else f"the mean, {size:.2g} {unit}, may be zero"
    )
    return Finding("zero mean", statistic, p_value, says)


def _trend(
    name: str, variable: str, left: Sequence[Array], values: Sequence[Array], filters: Sequence[Array], unit: str
) -> Finding:
    if not any(np.ptp(record_values) > 0 for record_values in values):
        return Finding(name, float("nan"), None, f"not tested: the {variable} does not change")
    ones = [np.ones(residual.size) for residual in left]
    size, statistic, p_value = _slope(left, ones, values, filters)
    says = (
        f"the residuals depend on the {variable}, by {size:.3g} {unit}: the model lacks an effect of it"
        if p_value < _SIGNIFICANT
        else f"no dependence on the {variable} was found"
    )
    return Finding(name, statistic, p_value, says)


def _normality(left: Sequence[Array], filters: Sequence[Array]) -> Finding:
    from scipy import stats

    innovations = []
    for values, weights in zip(left, filters, strict=True):
        innovation = _filtered(values, weights)
        spread = float(innovation.std())
        if spread > 0:
            innovations.append((innovation - innovation.mean()) / spread)
    if not innovations:
        return Finding("normality", float("nan"), None, "not tested: the residuals do not vary")
    pooled = np.concatenate(innovations)
    statistic, p_value = map(float, stats.normaltest(pooled))
    tails = float(stats.kurtosis(pooled))
    says = (
        f"the noise is not Gaussian (excess kurtosis {tails:.2g}): "
        + (
            "outliers, or steps of the sensor"
            if tails > 0
            else "its range is bounded, as for a sensor with coarse resolution"
        )
        if p_value < _SIGNIFICANT
        else "the noise may be Gaussian"
    )
    return Finding("normality", statistic, p_value, says)


def _autoregression(values: Array) -> Array:
    """Fit an autoregression (Yule and Walker), of the order that Akaike's criterion chooses.

    Return the coefficients, shape (order,), for the lags 1, 2, ...
    """
    from scipy.linalg import solve_toeplitz

    n = values.size
    centred = values - values.mean()
    highest = min(_HIGHEST_ORDER, n // 10)
    covariance = np.array([float(centred[lag:] @ centred[: n - lag]) / n for lag in range(highest + 1)])
    best, least = np.zeros(0), n * np.log(max(covariance[0], 1e-300))
    if covariance[0] <= 0:
        return best
    for order in range(1, highest + 1):
        weights = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
        left = covariance[0] - float(weights @ covariance[1 : order + 1])
        criterion = n * np.log(max(left, 1e-300)) + 2 * order
        if criterion < least:
            best, least = weights, criterion
    return best


def _filtered(values: Array, weights: Array) -> Array:
    """Return the innovations for the coefficients `weights`, without the first `weights.size` samples."""
    order = weights.size
    if not order:
        return values
    past = np.column_stack([values[order - lag - 1 : values.size - lag - 1] for lag in range(order)])
    return np.asarray(values[order:] - past @ weights)


def _slope(
    left: Sequence[Array], others: Sequence[Array], values: Sequence[Array], filters: Sequence[Array]
) -> tuple[float, float, float]:
    """Regress the residuals on `values` and `others`, all of them filtered; return slope, t and p for `values`.

    If the regression is singular, slope and t are NaN and p is 1.
    """
    from scipy import stats

    bring: Callable[[Sequence[Array]], Array] = lambda rows: np.concatenate(  # noqa: E731
        [_filtered(row, weights) for row, weights in zip(rows, filters, strict=True)]
    )
    target, regressor = bring(left), bring(values)
    columns = [regressor, bring(others)] if len(others) else [regressor]
    matrix = np.column_stack(columns)
    solution, _, rank, _ = np.linalg.lstsq(matrix, target, rcond=None)
    rest = target - matrix @ solution
    dof = target.size - matrix.shape[1]
    if rank < matrix.shape[1] or dof < 1:
        return float("nan"), float("nan"), 1.0
    variance = float(rest @ rest) / dof * np.linalg.inv(matrix.T @ matrix)[0, 0]
    statistic = float(solution[0] / np.sqrt(variance)) if variance > 0 else 0.0
    return float(solution[0]), statistic, float(2 * stats.t.sf(abs(statistic), dof))
