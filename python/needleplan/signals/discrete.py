"""Linear filters of sampled signals: transfer function, whole records, one sample at a time, the inverse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals.array import Array, ComplexArray

__all__ = ["DiscreteFilter", "FilterStream"]


@dataclass(frozen=True)
class DiscreteFilter:
    """The transfer function B(z)/A(z) at samples `interval_s` apart.

    `numerator` and `denominator` are the coefficients of falling powers of z, of the same length; A begins with a
    number that is not zero. Raises ModelError where they cannot be a causal filter.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    interval_s: float

    def __post_init__(self) -> None:
        mistakes = []
        if not self.numerator or len(self.numerator) != len(self.denominator):
            mistakes.append(Mistake("numerator", str(self.numerator), "must be as long as the denominator"))
        if not np.isfinite([*self.numerator, *self.denominator]).all():
            mistakes.append(Mistake("denominator", str(self.denominator), "must be finite numbers, as the numerator"))
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
        """Whether all poles lie inside of the unit circle."""
        return bool((np.abs(self.poles) < 1).all())

    @property
    def minimum_phase(self) -> bool:
        """Whether the inverse is causal and stable as well: all poles and zeros lie inside of the unit circle."""
        return self.stable and self.numerator[0] != 0 and bool((np.abs(self.zeros) < 1).all())

    def response(self, frequency_hz: Array | float) -> ComplexArray:
        """Return the complex gain at frequencies, shape as given; exact, at any frequency up to Nyquist."""
        z = np.exp(2j * np.pi * np.asarray(frequency_hz, float) * self.interval_s)
        return np.asarray(np.polyval(self.numerator, z) / np.polyval(self.denominator, z))

    def inverse(self) -> DiscreteFilter:
        """Return A(z)/B(z). Raises ModelError where that is not causal or not stable."""
        if not self.minimum_phase:
            rule = "must lie inside of the unit circle, or the inverse is not causal and stable"
            raise ModelError(Mistake("zeros", np.array2string(self.zeros, precision=4), rule), "filter")
        return DiscreteFilter(self.denominator, self.numerator, self.interval_s)

    def apply(self, values: Array) -> Array:
        """Filter a record, shape (samples,), as if its first value had been there for ever. Raises DataError."""
        from scipy.signal import lfilter

        values = np.asarray(values, float)
        if values.ndim != 1 or not values.size:
            raise DataError(Mistake("values", f"shape {values.shape}", "must be a row of numbers"))
        filtered, _ = lfilter(self.numerator, self.denominator, values, zi=self._settled(values[0]))
        return np.asarray(filtered)

    def stream(self) -> FilterStream:
        """Return the same filter for samples that come one at a time."""
        return FilterStream(self)

    def _settled(self, value: float) -> Array:
        """Return the memory of the filter after `value` has been there for ever, shape (order,)."""
        first = self.denominator[0]
        b, a = np.array(self.numerator) / first, np.array(self.denominator) / first
        out = value * b.sum() / a.sum()
        # What each place holds is what the later coefficients still make of input and output.
        return np.cumsum((b * value - a * out)[:0:-1])[::-1]


class FilterStream:
    """A filter at work, in transposed direct form II; gives what `DiscreteFilter.apply` gives."""

    def __init__(self, what: DiscreteFilter) -> None:
        first = what.denominator[0]
        self._b = [each / first for each in what.numerator]
        self._a = [each / first for each in what.denominator]
        self._what = what
        self._memory: list[float] | None = None

    def push(self, value: float) -> float:
        """Take a sample and return the filtered one."""
        if self._memory is None:
            self._memory = [*self._what._settled(value).tolist(), 0.0]
        memory, a, b = self._memory, self._a, self._b
        filtered = memory[0] + b[0] * value
        for index in range(len(a) - 1):
            memory[index] = memory[index + 1] + b[index + 1] * value - a[index + 1] * filtered
        return filtered
