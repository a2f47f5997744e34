"""Heading noise of the planner from replicate insertions.

In the planner every insertion step of length delta = 2 pi R / N is followed by an independent disturbance of the
heading by 0, +-1, +-2 ... steps of alpha = 2 pi / N. Its variance per length is s^2 / delta. Replicates that are not
turned drift apart with that variance per length; it is estimated from their heading increments between depths, which
are independent for a random walk, so that differences of the entry do not count, minus what the tracker adds. Among
all distributions on the heading steps with that variance, the discrete Gaussian p_k ~ exp(-c k^2), of largest entropy,
is taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array, Record

__all__ = ["NoiseStatus", "TipNoise", "headings_at", "probabilities_of", "tip_noise"]

_TERMS = 8
_ENOUGH = 10
_DECIMALS = 6


class NoiseStatus(StrEnum):
    """What the replicates say."""

    IDENTIFIED = "identified"
    FEW_REPLICATES = "few_replicates"
    """An estimate, with an interval that spans more than a factor of about two in the standard deviation."""

    NOT_SEPARABLE = "not_separable"
    """The scatter is no larger than what the tracker's noise makes of no scatter at all."""

    TOO_WIDE = "too_wide"
    """More than the planner's eight probabilities hold: take fewer headings, which makes steps longer and coarser."""


@dataclass(frozen=True)
class TipNoise:
    """Noise of the heading per insertion step, with 95 % interval, and the probabilities of `[motion] tip_noise`.

    `probabilities` are P(0), P(+-1), ...; `low` and `high` those at the ends of the interval. `says` is a sentence.
    """

    status: NoiseStatus
    probabilities: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    sd_rad: float
    low_rad: float
    high_rad: float
    replicates: int
    degrees: int
    says: str

    @property
    def ok(self) -> bool:
        """Whether there are probabilities that rest on the data."""
        return self.status in (NoiseStatus.IDENTIFIED, NoiseStatus.FEW_REPLICATES)


def tip_noise(
    headings_rad: Array, depths_mm: Array, *, headings: int, radius_mm: float, measurement_sd_rad: float = 0.0
) -> TipNoise:
    """Return the tip noise from the headings of replicates at common depths.

    `headings_rad` (replicates, depths), `depths_mm` (depths,), increasing: two or more; headings must be independent
    measurements, each with the standard deviation `measurement_sd_rad`. `headings` (N) and `radius_mm` (R) are those of
    the scenario. Raises DataError for fewer than two replicates, or numbers that make no sense.
    """
    from scipy import stats

    values, depths = np.asarray(headings_rad, float), np.asarray(depths_mm, float)
    _require(values, depths, headings, radius_mm, measurement_sd_rad)
    replicates = len(values)
    step_mm, step_rad = 2 * math.pi * radius_mm / headings, 2 * math.pi / headings
    moved = np.diff(values - values.mean(axis=0), axis=1)
    steps = np.diff(depths) / step_mm
    degrees = (replicates - 1) * steps.size
    noise = 2 * measurement_sd_rad**2
    # Every increment has the variance steps s^2 + 2 m^2; weigh so that a long interval does not count for more.
    total = float(np.sum(moved**2 / steps)) / degrees
    added = float(np.mean(noise / steps))
    ends = [total * degrees / float(stats.chi2.ppf(share, degrees)) - added for share in (0.975, 0.025)]
    variance, low, high = (max(each, 0.0) for each in (total - added, *ends))
    try:
        found = [probabilities_of(math.sqrt(each), step_rad) for each in (variance, low, high)]
    except DataError:
        status, found = NoiseStatus.TOO_WIDE, [(1.0,)] * 3
    else:
        status = (
            NoiseStatus.NOT_SEPARABLE if low == 0 and noise > 0
            else NoiseStatus.IDENTIFIED if degrees >= _ENOUGH and replicates > 2
            else NoiseStatus.FEW_REPLICATES
        )  # fmt: skip
    sizes = [math.sqrt(each) for each in (variance, low, high)]
    says = _says(status, sizes, step_rad, replicates, degrees)
    middle, least, most = found
    return TipNoise(status, middle, least, most, sizes[0], sizes[1], sizes[2], replicates, degrees, says)


def probabilities_of(sd_rad: float, step_rad: float) -> tuple[float, ...]:
    """Return P(0), P(+-1), ... of the discrete Gaussian with a standard deviation, as the scenario wants them.

    At most eight; rounded, in sum one when doubled. Raises DataError where eight do not hold it.
    """
    from scipy.optimize import brentq

    target = (sd_rad / step_rad) ** 2
    if target < 1e-9:
        return (1.0,)
    k = np.arange(200.0)

    def weights(c: float) -> Array:
        each = np.exp(-c * k**2)
        return np.asarray(each / (each[0] + 2 * each[1:].sum()))

    def excess(log_c: float) -> float:
        return float(2 * (weights(math.exp(log_c)) @ k**2)) / target - 1

    if excess(math.log(1e-3)) < 0:
        raise DataError(Mistake("sd_rad", f"{sd_rad:.3g}", f"must be a few steps of {step_rad:.3g} rad at most"))
    found = weights(math.exp(brentq(excess, math.log(1e-3), math.log(60.0), xtol=1e-12)))
    kept = int(np.flatnonzero(found > 0.5 * 10**-_DECIMALS)[-1]) + 1
    if kept > _TERMS and 2 * found[_TERMS:].sum() > 1e-3:
        raise DataError(
            Mistake("sd_rad", f"{sd_rad:.3g}", f"needs more than {_TERMS} probabilities; take fewer headings")
        )
    rounded = [round(float(each), _DECIMALS) for each in found[: min(kept, _TERMS)]]
    return (round(1 - 2 * math.fsum(rounded[1:]), _DECIMALS), *rounded[1:])


def headings_at(records: Sequence[Record], depths_mm: Array, window_mm: float) -> tuple[Array, float]:
    """Return headings (trials, depths) of tracked tips in the xy plane, and their standard deviation.

    A straight line through the points within half of `window_mm` of a depth gives the heading there; windows must
    not overlap. Columns: x_mm (or depth_mm) and y_mm. The deviation is that of the lines, from their residuals, and
    too small where the errors of the tracker are correlated. Raises DataError where a window has fewer than 4 points.
    """
    from scipy import stats

    depths = np.asarray(depths_mm, float)
    if depths.size > 1 and np.diff(depths).min() < window_mm:
        rule = f"must be at least window_mm, {window_mm:g} mm, apart"
        raise DataError(Mistake("depths_mm", f"{np.diff(depths).min():g} mm", rule))
    found = np.empty((len(records), depths.size))
    variances = []
    for row, record in enumerate(records):
        x, y = record["x_mm" if "x_mm" in record.columns else "depth_mm"], record["y_mm"]
        for column, depth in enumerate(depths):
            here = (np.abs(x - depth) <= window_mm / 2) & np.isfinite(y)
            if here.sum() < 4 or not np.ptp(x[here]):
                rule = f"has {int(here.sum())} points within {window_mm / 2:g} mm; a heading needs at least 4"
                raise DataError(Mistake("depths_mm", f"{depth:g}", rule), record.trial)
            line = stats.linregress(x[here], y[here])
            found[row, column] = math.atan(line.slope)
            variances.append(float(line.stderr) ** 2)
    return found, math.sqrt(float(np.mean(variances)))


def _require(values: Array, depths: Array, headings: int, radius_mm: float, measurement_sd_rad: float) -> None:
    mistakes = []
    if values.ndim != 2 or values.shape[1:] != depths.shape or depths.size < 2:
        rule = f"must have the shape (replicates, depths), with two or more depths {depths.shape}"
        raise DataError(Mistake("headings_rad", f"shape {values.shape}", rule))
    if len(values) < 2:
        mistakes.append(
            Mistake("headings_rad", f"{len(values)} replicates", "too few: scatter needs two, and ten to be known")
        )
    if not (np.isfinite(values).all() and np.isfinite(depths).all() and (np.diff(depths) > 0).all()):
        mistakes.append(Mistake("headings_rad, depths_mm", "", "must be finite, and the depths increase"))
    if headings < 4 or not 0 < radius_mm < math.inf or not 0 <= measurement_sd_rad < math.inf:
        rule = "must be at least 4 headings, a radius above 0 and a deviation of at least 0"
        mistakes.append(
            Mistake("headings, radius_mm, measurement_sd_rad", f"{headings}, {radius_mm}, {measurement_sd_rad}", rule)
        )
    if mistakes:
        raise DataError(mistakes)


def _says(status: NoiseStatus, sizes: Sequence[float], step_rad: float, replicates: int, degrees: int) -> str:
    sd, low, high = (math.degrees(each) for each in sizes)
    size = f"the heading scatters by {sd:.3g} degrees a step (95 %: {low:.3g} to {high:.3g})"
    if status is NoiseStatus.TOO_WIDE:
        return (
            f"{size}: more than eight probabilities of {math.degrees(step_rad):.3g} degrees hold; take fewer headings"
        )
    if status is NoiseStatus.NOT_SEPARABLE:
        return f"{size}, which the tracker's noise alone may explain"
    if status is NoiseStatus.FEW_REPLICATES:
        return f"{size}; {replicates} replicates ({degrees} increments) are few: 3 with {_ENOUGH} are needed"
    return f"{size}, from {replicates} replicates"
