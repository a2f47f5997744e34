"""Linear filters of sampled signals, the moving average of the force sensor, and velocity without delay.

**Delay of a velocity.** A causal filter delays the velocity. In a fit of a friction model, the delay looks like
compliant tissue: at 0.1 Hz, a delay of 0.1 s is a phase lag of 3.6 degrees, and the identified LuGre parameters sigma0
and sigma1 are more than twice too large. Use `velocity_without_delay` for data that are processed after the experiment.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals._record import Array, ComplexArray
from needleplan.signals._sine import dominant_frequency_hz, sine_at
from needleplan.signals._tracker import TrackerFilter

__all__ = [
    "AverageStream",
    "DiscreteFilter",
    "FilterStream",
    "MovingAverage",
    "VelocityMethod",
    "VelocityRecord",
    "velocity_without_delay",
]


@dataclass(frozen=True)
class DiscreteFilter(CallRepr):
    """The transfer function B(z)/A(z) for samples at intervals of `interval_s`.

    `numerator` and `denominator` are the coefficients of descending powers of z. The constructor raises ModelError
    unless both have the same length and finite coefficients, `denominator[0]` is not 0, and `interval_s` is positive.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    interval_s: float

    def __post_init__(self) -> None:
        mistakes = []
        if not self.numerator or len(self.numerator) != len(self.denominator):
            mistakes.append(Mistake("numerator", str(self.numerator), "must be as long as the denominator"))
        if not np.isfinite([*self.numerator, *self.denominator]).all():
            mistakes.append(
                Mistake("denominator", str(self.denominator), "must be finite numbers, and so must the numerator")
            )
        elif not self.denominator or self.denominator[0] == 0:
            mistakes.append(Mistake("denominator", str(self.denominator), "must not begin with zero: not causal"))
        if not 0 < self.interval_s < np.inf:
            mistakes.append(Mistake("interval_s", f"{self.interval_s:g}", "must be greater than 0 s"))
        if mistakes:
            raise ModelError(mistakes, "filter")

    @property
    def poles(self) -> ComplexArray:
        """Roots of the denominator."""
        return np.asarray(np.roots(self.denominator), complex)

    @property
    def zeros(self) -> ComplexArray:
        """Roots of the numerator."""
        return np.asarray(np.roots(self.numerator), complex)

    @property
    def stable(self) -> bool:
        """Whether all poles are inside the unit circle."""
        return bool((np.abs(self.poles) < 1).all())

    @property
    def minimum_phase(self) -> bool:
        """Whether all poles and zeros are inside the unit circle and the inverse is causal."""
        return self.stable and self.numerator[0] != 0 and bool((np.abs(self.zeros) < 1).all())

    def response(self, frequency_hz: Array | float) -> ComplexArray:
        """Return the complex gain at `frequency_hz`, of the same shape."""
        z = np.exp(2j * np.pi * np.asarray(frequency_hz, float) * self.interval_s)
        return np.asarray(np.polyval(self.numerator, z) / np.polyval(self.denominator, z))

    def inverse(self) -> DiscreteFilter:
        """Return the inverse filter A(z)/B(z). Raises ModelError unless `minimum_phase` is true."""
        if not self.minimum_phase:
            rule = "must lie inside of the unit circle, or the inverse is not causal and stable"
            raise ModelError(Mistake("zeros", np.array2string(self.zeros, precision=4), rule), "filter")
        return DiscreteFilter(self.denominator, self.numerator, self.interval_s)

    def apply(self, values: Array) -> Array:
        """Filter `values`, shape (samples,), and return the result in the same shape.

        The filter starts in its steady state for the first value. Raises DataError if `values` is empty or not a row.
        """
        from scipy.signal import lfilter

        values = np.asarray(values, float)
        if values.ndim != 1 or not values.size:
            raise DataError(Mistake("values", f"shape {values.shape}", "must be a row of numbers"))
        filtered, _ = lfilter(self.numerator, self.denominator, values, zi=self._settled(values[0]))
        return np.asarray(filtered)

    def stream(self) -> FilterStream:
        """Return a running filter that processes one sample at a time."""
        return FilterStream(self)

    def _settled(self, value: float) -> Array:
        """Return the steady state of the filter for a constant `value`, shape (order,)."""
        first = self.denominator[0]
        b, a = np.array(self.numerator) / first, np.array(self.denominator) / first
        out = value * b.sum() / a.sum()
        # Each state is the sum of the later coefficients times input and output.
        return np.cumsum((b * value - a * out)[:0:-1])[::-1]


class FilterStream:
    """A running filter in transposed direct form II with the same output as `DiscreteFilter.apply`."""

    def __init__(self, what: DiscreteFilter) -> None:
        first = what.denominator[0]
        self._b = [each / first for each in what.numerator]
        self._a = [each / first for each in what.denominator]
        self._what = what
        self._memory: list[float] | None = None

    def push(self, value: float) -> float:
        """Process one sample and return the filtered value."""
        if self._memory is None:
            self._memory = [*self._what._settled(value).tolist(), 0.0]
        memory, a, b = self._memory, self._a, self._b
        filtered = memory[0] + b[0] * value
        for index in range(len(a) - 1):
            memory[index] = memory[index + 1] + b[index + 1] * value - a[index + 1] * filtered
        return filtered


@dataclass(frozen=True)
class MovingAverage:
    """A causal moving average: the mean of each sample and up to `samples` - 1 samples before it.

    The force sensor of the thesis averages five samples at 200 Hz (appendix A).

    The average attenuates a signal, and delays it by (samples - 1)/2 intervals at every frequency. Before comparing a
    model with the measured force, apply the same average to the model (`fit(..., smooth=MovingAverage(5).apply)`). The
    constructor raises ModelError unless `samples` is a whole number of at least 1.
    """

    samples: int = 5

    def __post_init__(self) -> None:
        if isinstance(self.samples, bool) or not isinstance(self.samples, int) or self.samples < 1:
            raise ModelError(Mistake("samples", str(self.samples), "must be a whole number from 1"), "moving average")

    def delay_s(self, interval_s: float) -> float:
        """Return the delay (s) for samples at intervals of `interval_s`."""
        return (self.samples - 1) / 2 * interval_s

    def response(self, frequency_hz: Array | float, interval_s: float) -> ComplexArray:
        """Return the complex gain of the average at given frequencies.

        Parameters
        ----------
        frequency_hz : numpy.ndarray or float
            Frequency (Hz), a number or an array.
        interval_s : float
            Interval between samples (s).

        Returns
        -------
        numpy.ndarray
            Gain, complex, of the shape of `frequency_hz`; 1 at frequency 0.
        """
        turn = -2j * np.pi * np.asarray(frequency_hz, float)[..., None] * interval_s
        return np.asarray(np.exp(turn * np.arange(self.samples)).mean(axis=-1))

    def apply(self, values: Array) -> Array:
        """Return the average at every value of a signal; `values` and the result have the shape (n,).

        The averages equal those of `stream` to 1e-12. A NaN affects only the averages that contain it. Raises DataError
        if `values` is not a row.
        """
        values = np.asarray(values, float)
        if values.ndim != 1:
            raise DataError(Mistake("values", f"shape {values.shape}", "must be a row of numbers"))
        padded = np.concatenate([np.zeros(self.samples - 1), values])
        windows = np.lib.stride_tricks.sliding_window_view(padded, self.samples)
        return np.asarray(windows.sum(axis=1) / np.minimum(np.arange(values.size) + 1, self.samples))

    def centred(self, values: Array) -> Array:
        """Return the averages of a signal without delay; `values` and the result have the shape (n,).

        Each average contains its sample and `samples` // 2 neighbours on each side; near the ends, only those that
        exist. Raises ModelError if `samples` is even.
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
        """Return a running average that processes one sample at a time."""
        return AverageStream(self.samples)


class AverageStream:
    """A running moving average."""

    def __init__(self, samples: int) -> None:
        self._last: deque[float] = deque(maxlen=samples)

    def push(self, value: float) -> float:
        """Process one sample and return the mean of the last `samples` samples, or of all if there are fewer."""
        self._last.append(value)
        return sum(self._last) / len(self._last)


# Standard deviation of the position noise above which the sensor counts as a tracker and not as an encoder, mm.
_NOISY_MM = 0.02
# Relative deviation of a sampling interval above which the samples count as uneven.
_UNEVEN = 0.02
# Standard deviation of the third difference of white noise with unit variance.
_THIRD_DIFFERENCE_SD = 20**0.5
# Ratio of the standard deviation to the median absolute deviation, for Gaussian noise.
_MAD_TO_SD = 1.4826


class VelocityMethod(StrEnum):
    """The method by which a velocity was computed."""

    POLYNOMIAL = "polynomial"
    """Derivative of a cubic around each sample (Savitzky and Golay), for encoders at even times."""

    SMOOTHER = "smoother"
    """Kalman smoother for the model of constant acceleration, for trackers or uneven times."""


@dataclass(frozen=True)
class VelocityRecord(ShortRepr):
    """Velocity at every sample, shape (samples,), with the method that computed it.

    `noise_mm` is the estimated standard deviation of the position noise.
    """

    velocity_mm_s: Array
    noise_mm: float
    method: VelocityMethod


def velocity_without_delay(time_s: Array, position_mm: Array, window_s: float = 0.1) -> VelocityRecord:
    """Estimate the velocity of a measured position without delay.

    The method is POLYNOMIAL if the position noise is below 0.02 mm and the sampling intervals are even to 2 %, and
    SMOOTHER otherwise. The process noise of the smoother corresponds to the jerk of the dominant sine in the record,
    correlated over one radian of this sine.

    Parameters
    ----------
    time_s : numpy.ndarray
        Increasing times (s), shape (samples,), at least 15.
    position_mm : numpy.ndarray
        Measured positions (mm), shape (samples,).
    window_s : float, default 0.1
        Length of the polynomials of POLYNOMIAL (s).

    Returns
    -------
    VelocityRecord
        Velocity (mm/s), estimated position noise (mm), and method.

    Raises
    ------
    DataError
        The shapes differ, there are fewer than 15 samples, a number is not finite, or the times do not increase.
        SMOOTHER also raises it for a constant position.
    """
    from scipy.signal import savgol_filter

    time, position = np.asarray(time_s, float), np.asarray(position_mm, float)
    if time.ndim != 1 or time.shape != position.shape or time.size < 15:
        raise DataError(
            Mistake("depth_mm", f"shape {position.shape}", "must be as long as time_s, and hold at least 15 samples")
        )
    if not np.isfinite(position).all() or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
        raise DataError(Mistake("depth_mm", "", "must be finite numbers at increasing times"))
    third = np.diff(position, 3)
    noise = _MAD_TO_SD * float(np.median(np.abs(third - np.median(third)))) / _THIRD_DIFFERENCE_SD
    steps = np.diff(time)
    interval = float(np.median(steps))
    even = bool(np.abs(steps - interval).max() <= _UNEVEN * interval)
    if noise < _NOISY_MM and even:
        window = min(max(2 * round(window_s / interval / 2) + 1, 5), 2 * ((time.size - 1) // 2) + 1)
        velocity = savgol_filter(position, window, 3, deriv=1, delta=interval)
        return VelocityRecord(np.asarray(velocity), noise, VelocityMethod.POLYNOMIAL)
    frequency = dominant_frequency_hz(time, position)
    omega = 2 * np.pi * frequency
    jerk = sine_at(frequency, time, position).amplitude * omega**3
    smoothed = TrackerFilter(max(noise, 1e-4), max(jerk**2 / (2 * omega), 1e-9)).smooth(time, position)
    return VelocityRecord(smoothed.velocity_mm_s, noise, VelocityMethod.SMOOTHER)
