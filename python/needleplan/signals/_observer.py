"""The high-gain observer: velocity from positions (thesis, chapter 4), and the pair of a fast and a slow one.

In continuous time, with theta the measured and h the estimated position, w the estimated velocity::

    h' = w + (alpha1/eps) (theta - h)          w' = (alpha2/eps^2) (theta - h)

Semi-implicit Euler at samples T apart gives the recursion and its transfer function::

    h_i = (eps h_(i-1) + eps T w_(i-1) + alpha1 T theta_i) / (eps + alpha1 T)
    w_i = w_(i-1) + (alpha2 T/eps^2) (theta_i - h_i)
    Psi(z) = (alpha2 T/eps) z (z - 1) / [(eps + alpha1 T) z^2 - (2 eps + alpha1 T - alpha2 T^2/eps) z + eps]

Wrong in print: (4.1) and (4.2) divide alpha2 by eps once instead of twice, and so hold for eps = 1 only. The printed
observer (`ObserverForm.PRINTED`) is the corrected one with alpha2 multiplied by eps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals._filters import DiscreteFilter
from needleplan.signals._record import Array

__all__ = ["FAST_ALPHA1", "HighGainObserver", "ObserverForm", "ObserverStream", "Projection"]

FAST_ALPHA1 = 40.0
"""The fast observer of the thesis, 1/s; alpha2 = 400/s^2."""


class ObserverForm(StrEnum):
    """Which equations are meant; they differ where eps is not 1."""

    CORRECTED = "corrected"
    PRINTED = "printed"
    """(4.1) and (4.2) as they stand."""


@dataclass(frozen=True)
class HighGainObserver:
    """An observer for samples `interval_s` apart; alpha1 in 1/s, alpha2 in 1/s^2, both greater than 0.

    Raises ModelError for other numbers, and for an interval at which the recursion is not stable.
    """

    alpha1: float
    alpha2: float
    interval_s: float
    epsilon: float = 1.0
    form: ObserverForm = ObserverForm.CORRECTED

    def __post_init__(self) -> None:
        numbers = {name: getattr(self, name) for name in ("alpha1", "alpha2", "interval_s", "epsilon")}
        mistakes = [
            Mistake(name, f"{value:g}", "must be a number greater than 0")
            for name, value in numbers.items()
            if not 0 < value < math.inf
        ]
        if not mistakes and self.interval_s >= self.longest_interval_s:
            rule = f"must be less than {self.longest_interval_s:.4g} s, or the observer is not stable"
            mistakes = [Mistake("interval_s", f"{self.interval_s:g}", rule)]
        if mistakes:
            raise ModelError(mistakes, "observer")

    @classmethod
    def critically_damped(cls, alpha1: float, interval_s: float, epsilon: float = 1.0) -> HighGainObserver:
        """Return the observer with alpha2 = alpha1^2/4, as all those of the thesis are."""
        return cls(alpha1, alpha1**2 / 4, interval_s, epsilon)

    @property
    def correction(self) -> float:
        """What multiplies the error of the position in w', 1/s^2."""
        return self.alpha2 / (self.epsilon if self.form is ObserverForm.PRINTED else self.epsilon**2)

    @property
    def longest_interval_s(self) -> float:
        """Interval from which on a pole of Psi lies at or outside of -1 (Jury's criterion)."""
        a1, a2 = self.alpha1 / self.epsilon, self.correction
        return (a1 + math.sqrt(a1**2 + 4 * a2)) / a2

    @property
    def transfer(self) -> DiscreteFilter:
        """Psi(z): from position to velocity, mm to mm/s."""
        eps, t, gain = self.epsilon, self.interval_s, self.epsilon * self.correction * self.interval_s
        denominator = (eps + self.alpha1 * t, -(2 * eps + self.alpha1 * t - gain * t), eps)
        return DiscreteFilter((gain, -gain, 0.0), denominator, t)

    @property
    def normalised(self) -> DiscreteFilter:
        """Psi(z) over the difference quotient: the low pass that a velocity goes through; its gain at rest is one."""
        psi = self.transfer
        return DiscreteFilter((psi.numerator[0] * self.interval_s, 0.0, 0.0), psi.denominator, self.interval_s)

    def observe(self, position: Array) -> Array:
        """Return the velocity at every sample of `position`, shape (samples,); at rest before the first one.

        Bitwise what `stream` gives. Raises DataError for anything but a row of finite numbers.
        """
        position = np.asarray(position, float)
        if position.ndim != 1 or not np.isfinite(position).all():
            raise DataError(Mistake("position", f"shape {position.shape}", "must be a row of finite numbers"))
        stream = self.stream()
        return np.array([stream.push(each) for each in position.tolist()], float)

    def stream(self) -> ObserverStream:
        """Return the observer for positions that come one at a time."""
        return ObserverStream(self)


class ObserverStream:
    """An observer at work; `position` is its estimate, `velocity` is in its unit per second."""

    def __init__(self, observer: HighGainObserver) -> None:
        self._eps, self._t = observer.epsilon, observer.interval_s
        self._pull = observer.alpha1 * observer.interval_s
        self._gain = observer.correction * observer.interval_s
        self.position: float | None = None
        self.velocity = 0.0

    def push(self, position: float) -> float:
        """Take a measured position and return the velocity."""
        last = position if self.position is None else self.position
        eps = self._eps
        self.position = (eps * last + eps * self._t * self.velocity + self._pull * position) / (eps + self._pull)
        self.velocity += self._gain * (position - self.position)
        return self.velocity


@dataclass(frozen=True)
class Projection:
    """H(z) = Psi_slow/Psi_fast, equation (4.3): from the velocity of the needle to that relative to the tissue.

    The factors z (z - 1) cancel exactly, so H and its inverse are causal, and stable where both observers are. The
    inverse amplifies whatever lies above the slow observer's corner: by `inverse.response` at Nyquist.
    Raises ModelError for observers of different intervals.
    """

    fast: HighGainObserver
    slow: HighGainObserver

    def __post_init__(self) -> None:
        if self.fast.interval_s != self.slow.interval_s:
            rule = f"must be that of the fast observer, {self.fast.interval_s:g} s"
            raise ModelError(Mistake("slow.interval_s", f"{self.slow.interval_s:g}", rule), "projection")

    @classmethod
    def critically_damped(cls, slow_alpha1: float, interval_s: float, fast_alpha1: float = FAST_ALPHA1) -> Projection:
        """Return the projection between two critically damped observers."""
        fast, slow = (HighGainObserver.critically_damped(each, interval_s) for each in (fast_alpha1, slow_alpha1))
        return cls(fast, slow)

    @property
    def transfer(self) -> DiscreteFilter:
        """H(z): apply it to the velocity of the fast observer."""
        fast, slow = self.fast.transfer, self.slow.transfer
        ratio = slow.numerator[0] / fast.numerator[0]
        return DiscreteFilter(tuple(ratio * each for each in fast.denominator), slow.denominator, fast.interval_s)

    @property
    def inverse(self) -> DiscreteFilter:
        """1/H(z): back to the velocity of the fast observer."""
        return self.transfer.inverse()

    def attenuation(self, frequency_hz: Array | float) -> Array:
        """Return 1 - |H|, shape as given."""
        return np.asarray(1 - np.abs(self.transfer.response(frequency_hz)))

    def lag_rad(self, frequency_hz: Array | float) -> Array:
        """Return by how much H delays a sine, shape as given; positive is late."""
        return np.asarray(-np.angle(self.transfer.response(frequency_hz)))
