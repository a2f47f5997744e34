"""The noise of a sensor as an autoregression, and how it is taken out.

    y[k] = sum_j weights[j] y[k - 1 - j] + sd e[k],        e white with variance 1

The order is Schwarz' choice. Filters and rounding of a sensor are no autoregressions, but one of some order is near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.signals import Array

__all__ = ["Noise", "fit_noise"]

_HIGHEST_ORDER = 12


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
        whole = np.concatenate([[1.0], -self.weights]) / self.sd
        if taps is not None:
            whole = np.convolve(whole, taps)
        n, p = len(values), self.order
        new = whole[0] * values[p:]
        for lag in range(1, len(whole)):
            begin = p - lag
            if begin >= 0:
                new += whole[lag] * values[begin : n - lag]
            else:
                new[-begin:] += whole[lag] * values[: n - lag]
                new[:-begin] += whole[lag] * values[0]
        return np.asarray(new)


def fit_noise(rows: Sequence[Array]) -> Noise:
    """Return the autoregression of rows of noise, shape (samples,) each, about the mean of each."""
    centred = [row - row.mean() for row in rows]
    n = sum(row.size for row in centred)
    most = min(_HIGHEST_ORDER, min(row.size for row in centred) // 10)
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
        criterion = n * np.log(max(variance, 1e-300)) + order * np.log(n)
        if criterion < least:
            best, least = Noise(weights, float(np.sqrt(variance)), rms), criterion
    return best
