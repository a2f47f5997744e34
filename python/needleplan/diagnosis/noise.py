"""The noise of a sensor as an autoregression, and how it is taken out.

    y[k] = sum_j weights[j] y[k - 1 - j] + sd e[k],        e white with variance 1

The order is Schwarz' choice. Filters and rounding of a sensor are no autoregressions, but one of some order is near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import as_strided

from needleplan.signals import Array

__all__ = ["AxesNoise", "Noise", "fit_axes", "fit_noise", "together"]

_HIGHEST_ORDER = 12
_HIGHEST_OF_AXES = 24
_PART = 16
"""Samples that are filtered at once: more is more zeros in the band, less is smaller products."""


@dataclass(frozen=True)
class Noise:
    """Weights of the past, shape (order,), the standard deviation of what is new, and of all (the channel's unit)."""

    weights: Array
    sd: float
    rms: float

    @property
    def order(self) -> int:
        """How many samples of the past count."""
        return int(self.weights.size)

    def whiten(self, values: Array, taps: Array | None = None) -> Array:
        """Return what is new in each sample in units of its standard deviation, shape (n - order, ...).

        `taps` weigh present and past of the values before that, as a sensor does that is late. Before the first sample
        the values are taken as those of the first.
        """
        found = np.empty((max(len(values) - self.order, 0), *values.shape[1:]))
        self.whiten_into(found, values, taps)
        return found

    def whiten_into(self, found: Array, values: Array, taps: Array | None = None) -> None:
        """Write it, as `whiten` returns it, into rows that are there."""
        whole = np.concatenate([[1.0], -self.weights]) / self.sd
        if taps is not None:
            whole = np.convolve(whole, taps)
        early = min(len(whole) - 1 - self.order, len(found))  # for which values before the first count
        if early:
            before = np.broadcast_to(values[:1], (len(whole) - 1 - self.order, *values.shape[1:]))
            _filter(found[:early], whole, np.concatenate([before, values[: early + self.order]]))
        if early < len(found):
            _filter(found[early:], whole, np.asarray(values, float))


@dataclass(frozen=True)
class AxesNoise(Noise):
    """Of several axes, each by itself: values follow one another, (axes * samples, ...). Weights: of the longest.

    All are whitened with the highest order of them, so that they stay of one length.
    """

    axes: tuple[Noise, ...]

    def whiten(self, values: Array, taps: Array | None = None) -> Array:
        """Return what is new on each axis, one after the other, shape (axes * (samples - order), ...)."""
        each = max(len(values) // len(self.axes) - self.order, 0)
        found = np.empty((each * len(self.axes), *values.shape[1:]))
        self.whiten_into(found, values, taps)
        return found

    def whiten_into(self, found: Array, values: Array, taps: Array | None = None) -> None:
        """Write it, as `whiten` returns it, into rows that are there."""
        count = len(self.axes)
        for axis, rows, part in zip(self.axes, np.split(found, count), np.split(values, count), strict=True):
            if axis.order == self.order:
                axis.whiten_into(rows, part, taps)
            else:
                rows[...] = axis.whiten(part, taps)[self.order - axis.order :]


def _filter(found: Array, weights: Array, values: Array) -> None:
    """Write sum_j weights[j] values[k - j] for every k that has all of them, shape (n - order, ...), into `found`.

    Many rows are taken in parts, each the product of one band matrix with what the part needs: several times as many
    sums as there are, at a speed that is many times that of one pass over all values for each weight.
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
    part = max(_PART, order)
    at = np.arange(part)
    band = np.zeros((part, part + order))
    for lag, weight in enumerate(row):
        band[at, at + order - lag] = weight
    return band


def together(axes: Sequence[Noise]) -> Noise:
    """Return the noise of several axes; that of the only one where there is one."""
    if len(axes) == 1:
        return axes[0]
    longest = max(axes, key=lambda each: each.order)
    mean = [float(np.sqrt(np.mean([getattr(each, name) ** 2 for each in axes]))) for name in ("sd", "rms")]
    return AxesNoise(longest.weights, mean[0], mean[1], tuple(axes))


def fit_axes(rows: Sequence[Sequence[Array]]) -> Noise:
    """Return the noise of several axes, for each its rows: of one colour, each of its own strength.

    What is smooth lives on the slowest part of the noise, which a short autoregression makes too small: so the order is
    Akaike's choice, and all axes choose it together.
    """
    if len(rows) == 1:
        return fit_noise(rows[0])
    rms = [float(np.sqrt(np.mean(np.concatenate([row - row.mean() for row in axis]) ** 2))) for axis in rows]
    shared = [row / size for axis, size in zip(rows, rms, strict=True) for row in axis]
    whole = fit_noise(shared, highest=_HIGHEST_OF_AXES, charge=2.0)
    return together([Noise(whole.weights, whole.sd * size, size) for size in rms])


def fit_noise(rows: Sequence[Array], *, highest: int = _HIGHEST_ORDER, charge: float | None = None) -> Noise:
    """Return the autoregression of rows of noise, shape (samples,) each, about the mean of each.

    `charge` is what a weight costs in twice the log likelihood: by default log(n), Schwarz' criterion.
    """
    centred = [row - row.mean() for row in rows]
    n = sum(row.size for row in centred)
    most = min(highest, min(row.size for row in centred) // 10)
    rms = float(np.sqrt(sum(row @ row for row in centred) / max(n - len(centred), 1)))
    best, least = Noise(np.zeros(0), rms, rms), n * np.log(max(rms, 1e-300) ** 2)
    target = np.concatenate([row[most:] for row in centred])
    past = np.vstack([
        np.column_stack([row[most - lag : row.size - lag] for lag in range(1, most + 1)]) for row in centred
    ]) if most else np.zeros((n, 0))  # fmt: skip
    for order in range(1, most + 1):
        weights = np.linalg.lstsq(past[:, :order], target, rcond=None)[0]
        left = target - past[:, :order] @ weights
        variance = float(left @ left) / max(target.size - order, 1)
        criterion = n * np.log(max(variance, 1e-300)) + order * (np.log(n) if charge is None else charge)
        if criterion < least:
            best, least = Noise(weights, float(np.sqrt(variance)), rms), criterion
    return best
