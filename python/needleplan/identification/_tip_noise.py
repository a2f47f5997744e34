"""Tip noise of a plan from replicate insertions.

In a plan, every insertion step of length delta is followed by an independent disturbance of the heading by 0, +-1, +-2
... noise steps of alpha, with variance s^2. The headings of replicates without rotation diverge with the variance
s^2 / delta per length. Step length and noise step are `[motion] step_mm` and `tip_noise_step_deg` of the scenario;
without them, delta = 2 pi R / N and alpha = 2 pi / N for N headings and the radius R. The estimate uses heading
increments between depths: they are independent for a random walk, and differences of the entry cancel. The variance of
the tracker is subtracted. Of all distributions over noise steps with the estimated variance, the distribution of
largest entropy is used: the discrete Gaussian p_k ~ exp(-c k^2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals import Array, Record

__all__ = ["NoiseStatus", "TipNoise", "headings_at", "probabilities_of", "tip_noise"]

# Largest number of probabilities that a scenario can hold: P(0) to P(+-7).
_TERMS = 8

# Number of degrees of freedom from which the noise counts as identified, if there are at least 3 replicates.
_ENOUGH = 10

# Decimals to which the probabilities are rounded.
_DECIMALS = 6


class NoiseStatus(StrEnum):
    """Outcome of an identification of the tip noise."""

    IDENTIFIED = "identified"
    """At least 3 replicates and 10 degrees of freedom."""

    FEW_REPLICATES = "few_replicates"
    """Identified from fewer replicates or degrees of freedom, with a wide interval."""

    NOT_SEPARABLE = "not_separable"
    """The interval contains zero: the noise of the tracker alone can explain the scatter."""

    TOO_WIDE = "too_wide"
    """Eight probabilities cannot represent the scatter or a limit of its interval: use fewer headings."""


@dataclass(frozen=True)
class TipNoise(ShortRepr):
    """Noise of the heading per insertion step: standard deviation with 95 % interval, and `[motion] tip_noise`.

    `probabilities` are P(0), P(+-1) ... for the estimated standard deviation `sd_rad`; `low` and `high` are the
    probabilities for `low_rad` and `high_rad`. If the status is TOO_WIDE, all three are (1.0,). `degrees` is the number
    of degrees of freedom, and `says` is a sentence for the user.
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
        """Whether the data determine the probabilities."""
        return self.status in (NoiseStatus.IDENTIFIED, NoiseStatus.FEW_REPLICATES)


def tip_noise(
    headings_rad: Array,
    depths_mm: Array,
    *,
    headings: int,
    radius_mm: float,
    measurement_sd_rad: float = 0.0,
    step_mm: float | None = None,
    noise_step_rad: float | None = None,
) -> TipNoise:
    """Estimate the tip noise from the headings of replicates at common depths.

    Parameters
    ----------
    headings_rad
        Independent measurements of the heading, shape (replicates, depths); at least two replicates.
    depths_mm
        Increasing depths, shape (depths,); at least two.
    headings
        Number N of headings of the scenario.
    radius_mm
        Radius R of the needle path in the scenario.
    measurement_sd_rad
        Standard deviation of the measurement error of a heading.
    step_mm
        Length of an insertion step of the scenario (mm); default 2 pi R / N.
    noise_step_rad
        Heading difference between neighbouring values of the tip noise (rad); default 2 pi / N.

    Returns
    -------
    TipNoise

    Raises
    ------
    DataError
        There are too few replicates or depths, the shapes differ, or a number is outside its range.
    """
    from scipy import stats

    values, depths = np.asarray(headings_rad, float), np.asarray(depths_mm, float)
    _require(values, depths, headings, radius_mm, measurement_sd_rad)
    length_mm = 2 * math.pi * radius_mm / headings if step_mm is None else step_mm
    step_rad = 2 * math.pi / headings if noise_step_rad is None else noise_step_rad
    for key, given in (("step_mm", length_mm), ("noise_step_rad", step_rad)):
        if not 0 < given < math.inf:
            raise DataError(Mistake(key, f"{given:g}", "must be above 0 and finite"))
    replicates = len(values)
    moved = np.diff(values - values.mean(axis=0), axis=1)
    steps = np.diff(depths) / length_mm
    degrees = (replicates - 1) * steps.size
    noise = 2 * measurement_sd_rad**2
    # Every increment has the variance steps s^2 + 2 m^2; the weight 1/steps gives all increments equal influence.
    total = float(np.sum(moved**2 / steps)) / degrees
    added = float(np.mean(noise / steps))
    ends = [total * degrees / float(stats.chi2.ppf(share, degrees)) - added for share in (0.975, 0.025)]
    variance, low, high = (max(square, 0.0) for square in (total - added, *ends))
    try:
        discrete = [probabilities_of(math.sqrt(square), step_rad) for square in (variance, low, high)]
    except DataError:
        status, discrete = NoiseStatus.TOO_WIDE, [(1.0,)] * 3
    else:
        status = (
            NoiseStatus.NOT_SEPARABLE if low == 0 and noise > 0
            else NoiseStatus.IDENTIFIED if degrees >= _ENOUGH and replicates > 2
            else NoiseStatus.FEW_REPLICATES
        )  # fmt: skip
    sizes = [math.sqrt(square) for square in (variance, low, high)]
    says = _says(status, sizes, step_rad, replicates, degrees)
    middle, least, most = discrete
    return TipNoise(status, middle, least, most, sizes[0], sizes[1], sizes[2], replicates, degrees, says)


def probabilities_of(sd_rad: float, step_rad: float) -> tuple[float, ...]:
    """Return P(0), P(+-1) ... of the discrete Gaussian with standard deviation `sd_rad`, for `[motion] tip_noise`.

    `step_rad` is a heading step. There are at most eight probabilities, rounded to six decimals, and P(0) + 2 (P(+-1) +
    ...) = 1. Raises DataError if eight probabilities cannot represent the standard deviation.
    """
    from scipy.optimize import brentq

    target = (sd_rad / step_rad) ** 2
    if target < 1e-9:
        return (1.0,)
    k = np.arange(200.0)

    def weights(c: float) -> Array:
        terms = np.exp(-c * k**2)
        return np.asarray(terms / (terms[0] + 2 * terms[1:].sum()))

    def excess(log_c: float) -> float:
        return float(2 * (weights(math.exp(log_c)) @ k**2)) / target - 1

    if excess(math.log(1e-3)) < 0:
        raise DataError(Mistake("sd_rad", f"{sd_rad:.3g}", f"must be a few steps of {step_rad:.3g} rad at most"))
    terms = weights(math.exp(brentq(excess, math.log(1e-3), math.log(60.0), xtol=1e-12)))
    kept = int(np.flatnonzero(terms > 0.5 * 10**-_DECIMALS)[-1]) + 1
    if kept > _TERMS and 2 * terms[_TERMS:].sum() > 1e-3:
        raise DataError(
            Mistake("sd_rad", f"{sd_rad:.3g}", f"needs more than {_TERMS} probabilities; take larger steps")
        )
    rounded = [round(float(weight), _DECIMALS) for weight in terms[: min(kept, _TERMS)]]
    return (round(1 - 2 * math.fsum(rounded[1:]), _DECIMALS), *rounded[1:])


def headings_at(records: Sequence[Record], depths_mm: Array, window_mm: float) -> tuple[Array, float]:
    """Return headings of tracked tips in the xy plane at given depths.

    The heading at a depth is the direction of a straight line fitted to the points in a window around the depth.

    Parameters
    ----------
    records : sequence of Record
        Records with y_mm and x_mm (or depth_mm), one for each trial.
    depths_mm : numpy.ndarray
        Depths (mm), at least `window_mm` apart.
    window_mm : float
        Width of the window (mm).

    Returns
    -------
    tuple of numpy.ndarray and float
        Headings (rad), shape (trials, depths), and their standard error (rad), one number from the residuals of all
        lines. It is too small if the errors of the tracker are correlated.

    Raises
    ------
    DataError
        Windows overlap, a window has fewer than 4 points or no extent in x, or a column is missing.
    """
    from scipy import stats

    depths = np.asarray(depths_mm, float)
    if depths.size > 1 and np.diff(depths).min() < window_mm:
        rule = f"must be at least window_mm, {window_mm:g} mm, apart"
        raise DataError(Mistake("depths_mm", f"{np.diff(depths).min():g} mm", rule))
    headings = np.empty((len(records), depths.size))
    variances = []
    for row, record in enumerate(records):
        x, y = record["x_mm" if "x_mm" in record.columns else "depth_mm"], record["y_mm"]
        for column, depth in enumerate(depths):
            here = (np.abs(x - depth) <= window_mm / 2) & np.isfinite(y)
            if here.sum() < 4 or not np.ptp(x[here]):
                rule = f"has {int(here.sum())} points within {window_mm / 2:g} mm; a heading needs at least 4"
                raise DataError(Mistake("depths_mm", f"{depth:g}", rule), record.trial)
            line = stats.linregress(x[here], y[here])
            headings[row, column] = math.atan(line.slope)
            variances.append(float(line.stderr) ** 2)
    return headings, math.sqrt(float(np.mean(variances)))


def _require(values: Array, depths: Array, headings: int, radius_mm: float, measurement_sd_rad: float) -> None:
    mistakes = []
    if values.ndim != 2 or values.shape[1:] != depths.shape or depths.size < 2:
        rule = f"must have the shape (replicates, depths), with two or more depths {depths.shape}"
        raise DataError(Mistake("headings_rad", f"shape {values.shape}", rule))
    if len(values) < 2:
        mistakes.append(
            Mistake("headings_rad", f"{len(values)} replicates", "too few: at least 2 are needed, better 10")
        )
    if not (np.isfinite(values).all() and np.isfinite(depths).all() and (np.diff(depths) > 0).all()):
        mistakes.append(Mistake("headings_rad, depths_mm", "", "must be finite, and the depths increase"))
    if headings < 4 or not 0 < radius_mm < math.inf or not 0 <= measurement_sd_rad < math.inf:
        rule = "must be at least 4 headings, a radius above 0 and a standard deviation of at least 0"
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
            f"{size}, too much for eight probabilities in steps of {math.degrees(step_rad):.3g} degrees: "
            "take fewer headings, or a larger motion.tip_noise_step_deg"
        )
    if status is NoiseStatus.NOT_SEPARABLE:
        return f"{size}, which the noise of the tracker alone can explain"
    if status is NoiseStatus.FEW_REPLICATES:
        return f"{size}; {replicates} replicates with {degrees} increments are few: use at least 3 with {_ENOUGH}"
    return f"{size}, from {replicates} replicates"
