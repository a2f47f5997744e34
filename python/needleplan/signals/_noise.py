"""Noise of a sensor as an autoregression, which whitens its readings.

    y[k] = sum_j weights[j] y[k - 1 - j] + sd e[k],        e white with variance 1

The order minimises the BIC for the noise records of one axis, and the AIC for those of several axes. An autoregression
of that order also approximates the filter and the quantisation of a sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import as_strided

from needleplan.artifacts import CallRepr
from needleplan.signals._record import Array

__all__ = ["MultiAxisNoise", "SensorNoise", "combine_axes", "fit_axes", "fit_noise", "scatter"]

# Highest order of an autoregression of one axis.
_HIGHEST_ORDER = 12
# Highest order of an autoregression that several axes share.
_HIGHEST_SHARED_ORDER = 24
# Number of samples filtered at once: larger blocks multiply more zeros, smaller blocks need more products.
_FILTER_BLOCK = 16


def scatter(values: Array) -> float:
    """Return the standard deviation of white noise in a signal, estimated from its second differences."""
    return float(np.nanmedian(np.abs(np.diff(values, n=2))) / 0.6745 / np.sqrt(6))


@dataclass(frozen=True)
class SensorNoise(CallRepr):
    """Noise of one axis: weights of past samples, standard deviation of the innovations, and RMS (channel's unit)."""

    weights: Array
    sd: float
    rms: float

    @property
    def order(self) -> int:
        """Order of the autoregression: number of past samples."""
        return int(self.weights.size)

    def whiten(self, values: Array, taps: Array | None = None) -> Array:
        """Return the innovations of a signal in units of their standard deviation.

        Before its first sample the signal is assumed to be constant.

        Parameters
        ----------
        values : numpy.ndarray
            Signal, shape (n, ...), in the unit of the noise.
        taps : numpy.ndarray, optional
            Weights of a filter that is applied first, such as a sensor lag, shape (taps,).

        Returns
        -------
        numpy.ndarray
            Innovations, shape (n - order, ...).
        """
        found = np.empty((max(len(values) - self.order, 0), *values.shape[1:]))
        self.whiten_into(found, values, taps)
        return found

    def whiten_into(self, found: Array, values: Array, taps: Array | None = None) -> None:
        """Write the result of `whiten` into an existing array.

        Parameters
        ----------
        found : numpy.ndarray
            Array for the result, shape (n - order, ...).
        values : numpy.ndarray
            Signal, shape (n, ...), in the unit of the noise.
        taps : numpy.ndarray, optional
            Weights of a filter that is applied first, shape (taps,).
        """
        whole = np.concatenate([[1.0], -self.weights]) / self.sd
        if taps is not None:
            whole = np.convolve(whole, taps)
        early = min(len(whole) - 1 - self.order, len(found))  # rows that need values before the first
        if early:
            before = np.broadcast_to(values[:1], (len(whole) - 1 - self.order, *values.shape[1:]))
            _filter(found[:early], whole, np.concatenate([before, values[: early + self.order]]))
        if early < len(found):
            _filter(found[early:], whole, np.asarray(values, float))


@dataclass(frozen=True)
class MultiAxisNoise(SensorNoise):
    """Noise of several independent axes; values hold one axis after the other, shape (axes * samples, ...).

    As many values are dropped at the start of each axis as the highest order of all axes, so that lengths are equal.
    """

    axes: tuple[SensorNoise, ...]

    def whiten(self, values: Array, taps: Array | None = None) -> Array:
        """Return the innovations, one axis after the other, shape (axes * (samples - order), ...)."""
        each = max(len(values) // len(self.axes) - self.order, 0)
        found = np.empty((each * len(self.axes), *values.shape[1:]))
        self.whiten_into(found, values, taps)
        return found

    def whiten_into(self, found: Array, values: Array, taps: Array | None = None) -> None:
        """Write the result of `whiten` into `found`, shape (axes * (samples - order), ...)."""
        count = len(self.axes)
        for axis, rows, part in zip(self.axes, np.split(found, count), np.split(values, count), strict=True):
            if axis.order == self.order:
                axis.whiten_into(rows, part, taps)
            else:
                rows[...] = axis.whiten(part, taps)[self.order - axis.order :]


def _filter(found: Array, weights: Array, values: Array) -> None:
    """Write sum_j weights[j] values[k - j] for each k with a full history into `found`, shape (n - order, ...).

    Values with several columns are filtered in blocks by a band matrix: more operations than a loop over the weights,
    but much faster.
    """
    if values.ndim == 1:
        found[:] = np.convolve(values, weights, "valid")
        return
    order = len(weights) - 1
    values = np.ascontiguousarray(values, float).reshape(len(values), -1)
    n, m = len(values) - order, values.shape[1]
    found = found.reshape(n, m)
    band = _band(weights.tobytes())
    part = len(band)
    parts, rest = divmod(n, part)
    row, column = values.strides
    windows = as_strided(values, (parts, part + order, m), (part * row, row, column), writeable=False)
    np.matmul(band, windows, out=found[: parts * part].reshape(parts, part, m))
    if rest:
        np.matmul(band[:rest, : rest + order], values[parts * part :], out=found[parts * part :])


@lru_cache(maxsize=16)
def _band(weights: bytes) -> Array:
    row = np.frombuffer(weights)
    order = len(row) - 1
    part = max(_FILTER_BLOCK, order)
    at = np.arange(part)
    band = np.zeros((part, part + order))
    for lag, weight in enumerate(row):
        band[at, at + order - lag] = weight
    return band


def combine_axes(axes: Sequence[SensorNoise]) -> SensorNoise:
    """Return the joint noise of several axes; for one axis, the noise of that axis."""
    if len(axes) == 1:
        return axes[0]
    longest = max(axes, key=lambda each: each.order)
    mean = [float(np.sqrt(np.mean([getattr(axis, name) ** 2 for axis in axes]))) for name in ("sd", "rms")]
    return MultiAxisNoise(longest.weights, mean[0], mean[1], tuple(axes))


def fit_axes(rows: Sequence[Sequence[Array]]) -> SensorNoise:
    """Fit noise with common weights and separate standard deviations to axes; `rows` holds the recordings by axis.

    The order minimises the AIC instead of the BIC: too low an order underestimates slow noise, which smooth functions
    would then fit. A single axis is fitted by `fit_noise`, with the BIC.
    """
    if len(rows) == 1:
        return fit_noise(rows[0])
    rms = [float(np.sqrt(np.mean(np.concatenate([row - row.mean() for row in axis]) ** 2))) for axis in rows]
    shared = [row / size for axis, size in zip(rows, rms, strict=True) for row in axis]
    whole = fit_noise(shared, highest=_HIGHEST_SHARED_ORDER, penalty=2.0)
    return combine_axes([SensorNoise(whole.weights, whole.sd * size, size) for size in rms])


def fit_noise(rows: Sequence[Array], *, highest: int = _HIGHEST_ORDER, penalty: float | None = None) -> SensorNoise:
    """Fit an autoregression to noise recordings minus their means.

    Parameters
    ----------
    rows : sequence of numpy.ndarray
        Recordings, each of shape (samples,), all in one unit.
    highest : int, optional
        Largest order that is tried. The order is also at most a tenth of the shortest recording.
    penalty : float, optional
        Cost of one weight in twice the log-likelihood. Default: log(n), as in the BIC.

    Returns
    -------
    SensorNoise
        The order with the least criterion, its weights, and the standard deviation of its innovations.
    """
    centred = [row - row.mean() for row in rows]
    n = sum(row.size for row in centred)
    most = min(highest, min(row.size for row in centred) // 10)
    rms = float(np.sqrt(sum(row @ row for row in centred) / max(n - len(centred), 1)))
    best, least = SensorNoise(np.zeros(0), rms, rms), n * np.log(max(rms, 1e-300) ** 2)
    target = np.concatenate([row[most:] for row in centred])
    past = np.vstack([
        np.column_stack([row[most - lag : row.size - lag] for lag in range(1, most + 1)]) for row in centred
    ]) if most else np.zeros((n, 0))  # fmt: skip
    for order in range(1, most + 1):
        weights = np.linalg.lstsq(past[:, :order], target, rcond=None)[0]
        left = target - past[:, :order] @ weights
        variance = float(left @ left) / max(target.size - order, 1)
        criterion = n * np.log(max(variance, 1e-300)) + order * (np.log(n) if penalty is None else penalty)
        if criterion < least:
            best, least = SensorNoise(weights, float(np.sqrt(variance)), rms), criterion
    return best
