"""Confidence intervals that do not rest on the linearisation of a fit.

`profile_intervals` holds one parameter at a series of values and refits the others. The interval contains the values
for which the sum of squares has not increased too much. With correlated noise the sum of squares grows too fast. Its
increase is therefore divided by the ratio of the reported variance to the variance for white noise, if the ratio is
above 1 (Chandler and Bate, Biometrika 94 (2007) 167).

`bootstrap_intervals` adds resampled blocks of residuals to the fitted output and refits (Kuensch, Annals of Statistics
17 (1989) 1217). Both functions work in the coordinates of the fit, so that an interval never leaves the parameter's
range.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict, Unpack

import numpy as np

from needleplan.errors import DataError, Mistake, ModelError
from needleplan.models._base import Model
from needleplan.models._estimates import Estimate, Fit
from needleplan.models._fit import fit
from needleplan.models._simulate import simulate
from needleplan.signals import Array, Record

__all__ = ["FitOptions", "Intervals", "bootstrap_intervals", "profile_intervals"]

# The search for the end of an interval stops at the distance _FURTHEST * 2^20 from the estimate, in the coordinates of
# the fit.
_FURTHEST = 12


class FitOptions(TypedDict, total=False):
    """Options of the original fit; every refit uses the same options."""

    bounds: Mapping[str, tuple[float, float]] | None
    smooth: Callable[[Array], Array] | None
    mask: Callable[[Record], Array] | None
    max_evaluations: int


@dataclass(frozen=True)
class Intervals:
    """Estimates with recomputed intervals.

    Parameters
    ----------
    estimates : dict of str to Estimate
        Estimates by parameter name. A parameter is identified if its interval is narrower than 4 in the coordinate of
        the fit and does not reach a bound of the declared range.
    refits : int
        Number of refits.
    failed : int
        Number of refits that did not converge. The bootstrap leaves them out; the profile uses their sums of squares.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=20.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, len(motion))
    >>> measured = npl.models.simulate(npl.models.Bicycle(0.01), motion).output + noise
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "y_mm": measured})
    >>> found = npl.models.fit(npl.models.Bicycle(0.005), record, free=["curvature_per_mm"])
    >>> npl.models.profile_intervals(found, record).failed
    0
    """

    estimates: dict[str, Estimate]
    refits: int
    failed: int


def profile_intervals(
    found: Fit,
    data: Record | Sequence[Record],
    names: Sequence[str] | None = None,
    *,
    level: float = 0.95,
    **options: Unpack[FitOptions],
) -> Intervals:
    """Compute profile-likelihood intervals of fitted parameters.

    Parameters
    ----------
    found : Fit
        The fit.
    data : Record or sequence of Record
        The records of the fit.
    names : sequence of str, optional
        Parameters of interest. The default is all free parameters.
    level : float
        Confidence level.
    **options : FitOptions
        `bounds`, `smooth`, `mask` and `max_evaluations` of the fit.

    Returns
    -------
    Intervals
        The intervals.

    Raises
    ------
    ModelError
        If `names` contains a parameter that was not fitted.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=20.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, len(motion))
    >>> measured = npl.models.simulate(npl.models.Bicycle(0.01), motion).output + noise
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "y_mm": measured})
    >>> found = npl.models.fit(npl.models.Bicycle(0.005), record, free=["curvature_per_mm"])
    >>> interval = npl.models.profile_intervals(found, record).estimates["curvature_per_mm"]
    >>> interval.low < 0.01 < interval.high
    True
    """
    wanted = _names(found, names)
    records = (data,) if isinstance(data, Record) else tuple(data)
    profile = _Profile(found, records, options)
    estimates = {name: profile.interval(name, level) for name in wanted}
    return Intervals(estimates, profile.refits, profile.failed)


def bootstrap_intervals(
    found: Fit,
    data: Record | Sequence[Record],
    *,
    runs: int = 200,
    block: int | None = None,
    level: float = 0.95,
    seed: int = 0,
    **options: Unpack[FitOptions],
) -> Intervals:
    """Compute block-bootstrap intervals of all fitted parameters.

    Parameters
    ----------
    found : Fit
        The fit.
    data : Record or sequence of Record
        The records of the fit.
    runs : int
        Number of refits, at least 20.
    block : int, optional
        Length of a block in samples. The default is 3 n^(1/3) of each record, as for the covariance of the fit.
    level : float
        Confidence level.
    seed : int
        Seed of the resampling.
    **options : FitOptions
        `bounds`, `smooth`, `mask` and `max_evaluations` of the fit.

    Returns
    -------
    Intervals
        Percentile intervals.

    Raises
    ------
    DataError
        If `runs` is below 20, `block` is below 1 or longer than a record, or more than half of the refits fail.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=20.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, len(motion))
    >>> measured = npl.models.simulate(npl.models.Bicycle(0.01), motion).output + noise
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "y_mm": measured})
    >>> found = npl.models.fit(npl.models.Bicycle(0.005), record, free=["curvature_per_mm"])
    >>> npl.models.bootstrap_intervals(found, record, runs=20).refits
    20
    """
    records = (data,) if isinstance(data, Record) else tuple(data)
    shortest = min(int(np.isfinite(left).sum()) for left in found.residuals)
    if runs < 20 or (block is not None and not 1 <= block <= shortest):
        rule = f"must be at least 20 runs, and blocks of 1 to {shortest} samples"
        raise DataError(Mistake("runs, block", f"{runs}, {block}", rule))
    generator = np.random.default_rng(seed)
    channel = found.model.channel
    drawn: list[list[float]] = []
    failed = 0
    scale = math.sqrt(found.samples / max(found.samples - len(found.free), 1))  # corrects for the fitted parameters
    for _ in range(runs):
        again = [
            record.with_column(channel, record[channel] - left + scale * _resampled(left, block, generator))
            for record, left in zip(records, found.residuals, strict=True)
        ]
        refit = fit(found.model, again, free=found.free, **options)
        if refit.ok:
            drawn.append([getattr(refit.model, name) for name in found.free])
        else:
            failed += 1
    if len(drawn) < runs / 2:
        raise DataError(Mistake("runs", f"{failed} of {runs}", "refits did not converge: there is no interval to give"))
    low, high = np.quantile(np.array(drawn), [(1 - level) / 2, (1 + level) / 2], axis=0)
    sd = np.array(drawn).std(axis=0, ddof=1)
    estimates = {
        name: _with_ends(found, name, float(low[index]), float(high[index]), float(sd[index]))
        for index, name in enumerate(found.free)
    }
    return Intervals(estimates, runs, failed)


def _resampled(left: Array, block: int | None, generator: np.random.Generator) -> Array:
    """Return the centred residuals, resampled in blocks, shape (samples,); NaN at masked samples."""
    good = np.flatnonzero(np.isfinite(left))
    values = left[good] - left[good].mean()
    n = values.size
    length = min(round(3 * n ** (1 / 3)) if block is None else block, n)
    starts = generator.integers(0, n, -(-n // length))
    index = (starts[:, None] + np.arange(length)).ravel()[:n] % n  # circular: all samples are equally likely
    resampled = np.full(left.size, np.nan)
    resampled[good] = values[index]
    return resampled


def _names(found: Fit, names: Sequence[str] | None) -> tuple[str, ...]:
    if names is None:
        return found.free
    unknown = [
        Mistake(name, "", f"must be one of {', '.join(found.free)}, which were fitted")
        for name in names
        if name not in found.free
    ]
    if unknown:
        raise ModelError(unknown, found.model.name)
    return tuple(names)


def _with_ends(found: Fit, name: str, low: float, high: float, sd: float) -> Estimate:
    before = found.estimates[name]
    what = found.model.parameters()[name]
    ends = [what.coordinate(max(min(each, what.upper), what.lower)) for each in (low, high)]
    known = ends[1] - ends[0] < 4.0 and low > what.lower and high < what.upper
    return Estimate(before.value, sd, low, high, before.unit, known)


class _Profile:
    def __init__(self, found: Fit, records: tuple[Record, ...], options: FitOptions) -> None:
        self.found, self.records, self.options = found, records, options
        self.refits = self.failed = 0
        self.least = found.samples * found.rmse**2

    def interval(self, name: str, level: float) -> Estimate:
        from scipy import stats

        found, index = self.found, self.found.free.index(name)
        what = found.model.parameters()[name]
        centre = what.coordinate(getattr(found.model, name))
        dof = max(found.samples - len(found.free), 1)
        sd = math.sqrt(found.covariance[index, index])
        white = self._white_sd(name, centre, dof)
        inflation = max(sd / white, 1.0) if np.isfinite(sd) and white > 0 else 1.0
        allowed = float(stats.t.ppf((1 + level) / 2, dof)) ** 2 * inflation**2
        low, high = (what.coordinate(each) for each in self._range(name))
        step = sd if np.isfinite(sd) and sd > 0 else (high - low) / 100

        def excess(coordinate: float) -> float:
            return dof * (self._sum(name, what.value(coordinate)) / max(self.least, 1e-300) - 1) - allowed

        ends = [self._end(excess, centre, sign * step, low if sign < 0 else high) for sign in (-1, 1)]
        values = [what.value(each) for each in ends]
        return _with_ends(found, name, values[0], values[1], found.estimates[name].sd)

    def _end(self, excess: Callable[[float], float], centre: float, step: float, limit: float) -> float:
        """Return the coordinate at which the sum of squares exceeds the allowed one, or `limit` if there is none.

        `limit` is the bound of the range on this side; the sign of `step` gives the side.
        """
        from scipy.optimize import brentq

        before, reach = centre, abs(step)
        while reach < _FURTHEST * 2**20:
            here = centre + math.copysign(reach, step)
            here = max(here, limit) if step < 0 else min(here, limit)
            if excess(here) > 0:
                return float(brentq(excess, min(before, here), max(before, here), xtol=1e-3 * abs(step), rtol=1e-9))
            if here == limit:
                return limit
            before, reach = here, 2 * reach
        return limit

    def _white_sd(self, name: str, centre: float, dof: int) -> float:
        """Return the coordinate's standard deviation for white noise, from the profile's curvature; 0 if unknown."""
        what = self.found.model.parameters()[name]
        index = self.found.free.index(name)
        step = math.sqrt(self.found.covariance[index, index])
        if not np.isfinite(step) or step == 0:
            return 0.0
        low, high = (what.coordinate(each) for each in self._range(name))
        ends = [each for each in (centre - step, centre + step) if low <= each <= high]
        rises = [self._sum(name, what.value(each)) / max(self.least, 1e-300) - 1 for each in ends]
        rise = float(np.mean(rises)) if rises else 0.0
        return step / math.sqrt(dof * rise) if rise > 0 else 0.0

    def _range(self, name: str) -> tuple[float, float]:
        what = self.found.model.parameters()[name]
        return (self.options.get("bounds") or {}).get(name, (what.lower, what.upper))

    def _sum(self, name: str, value: float) -> float:
        """Return the minimal sum of squares with one parameter held at `value`."""
        what = self.found.model.parameters()[name]  # a value at the end of the range may be rounded beyond it
        model = self.found.model.with_values(**{name: min(max(value, what.lower), what.upper)})
        others = [each for each in self.found.free if each != name]
        self.refits += 1
        if not others:
            return self._plain_sum(model)
        refit = fit(model, self.records, free=others, **self.options)
        self.failed += not refit.ok
        return refit.samples * refit.rmse**2

    def _plain_sum(self, model: Model) -> float:
        """Return the sum of squares of a model without fitting."""
        smooth = self.options.get("smooth") or (lambda output: output)
        total = 0.0
        for record, left in zip(self.records, self.found.residuals, strict=True):
            again = record[model.channel] - smooth(simulate(model, record.motion()).output)
            total += float(np.sum(again[np.isfinite(left)] ** 2))
        return total
