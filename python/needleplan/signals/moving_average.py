"""The moving average of the force sensor: five samples at 200 Hz (thesis, appendix A)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals.array import Array, ComplexArray

__all__ = ["AverageStream", "MovingAverage"]


@dataclass(frozen=True)
class MovingAverage:
    """The mean of the last `samples` samples, at the start of those that there are. Raises ModelError.

    It delays by (samples - 1)/2 intervals at every frequency, and damps: compare a model with the measured force only
    after the same average (`fit(..., smooth=MovingAverage(5).apply)`).
    """

    samples: int = 5

    def __post_init__(self) -> None:
        if isinstance(self.samples, bool) or not isinstance(self.samples, int) or self.samples < 1:
            raise ModelError(Mistake("samples", str(self.samples), "must be a whole number from 1"), "moving average")

    def delay_s(self, interval_s: float) -> float:
        """Return the delay at samples `interval_s` apart."""
        return (self.samples - 1) / 2 * interval_s

    def response(self, frequency_hz: Array | float, interval_s: float) -> ComplexArray:
        """Return the complex gain, shape as the frequencies."""
        turn = -2j * np.pi * np.asarray(frequency_hz, float)[..., None] * interval_s
        return np.asarray(np.exp(turn * np.arange(self.samples)).mean(axis=-1))

    def apply(self, values: Array) -> Array:
        """Average a record, shape (samples,); what `stream` gives to 1e-12. Raises DataError for another shape.

        A NaN leaves the averages NaN that it is part of, and no others.
        """
        values = np.asarray(values, float)
        if values.ndim != 1:
            raise DataError(Mistake("values", f"shape {values.shape}", "must be a row of numbers"))
        padded = np.concatenate([np.zeros(self.samples - 1), values])
        windows = np.lib.stride_tricks.sliding_window_view(padded, self.samples)
        return np.asarray(windows.sum(axis=1) / np.minimum(np.arange(values.size) + 1, self.samples))

    def centred(self, values: Array) -> Array:
        """Average a record without delay, shape (samples,): over as many samples before each as after it.

        What `apply` gives with its delay taken out; at the ends the mean of those that there are. Raises DataError, and
        ModelError where the number of samples is even.
        """
        if self.samples % 2 == 0:
            raise ModelError(Mistake("samples", str(self.samples), "must be odd to have a middle"), "moving average")
        half = self.samples // 2
        delayed = self.apply(np.concatenate([np.asarray(values, float), np.zeros(half)]))
        averages = delayed[half:]
        count = len(averages)
        for place in {*range(min(half, count)), *range(max(count - half, 0), count)}:
            averages[place] = np.mean(values[max(place - half, 0) : place + half + 1])
        return np.asarray(averages)

    def stream(self) -> AverageStream:
        """Return the average for samples that come one at a time."""
        return AverageStream(self.samples)


class AverageStream:
    """A moving average at work."""

    def __init__(self, samples: int) -> None:
        self._last: deque[float] = deque(maxlen=samples)

    def push(self, value: float) -> float:
        """Take a sample and return the mean."""
        self._last.append(value)
        return sum(self._last) / len(self._last)
