"""The high-gain observer of the velocity (thesis, chapter 4), and the projection from a fast to a slow observer.

In continuous time, with the measured position theta, the estimated position h and the estimated velocity w, the
observer is equation (1) of docs/explanation/tissue-motion.md::

    h' = w + (alpha1/eps) (theta - h)          w' = (alpha2/eps^2) (theta - h)

The semi-implicit Euler method at intervals T gives the recursion and its transfer function, equation (2)::

    h_i = (eps h_(i-1) + eps T w_(i-1) + alpha1 T theta_i) / (eps + alpha1 T)
    w_i = w_(i-1) + (alpha2 T/eps^2) (theta_i - h_i)
    Psi(z) = (alpha2 T/eps) z (z - 1) / [(eps + alpha1 T) z^2 - (2 eps + alpha1 T - alpha2 T^2/eps) z + eps]

**Correction to the print.** Equations (4.1) and (4.2) of the thesis divide alpha2 by eps once instead of twice, and
therefore hold for eps = 1 only. The printed observer (`ObserverForm.PRINTED`) equals the corrected observer with alpha2
multiplied by eps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals._filters import DiscreteFilter
from needleplan.signals._record import Array

__all__ = ["FAST_ALPHA1", "HighGainObserver", "ObserverForm", "ObserverStream", "Projection"]

FAST_ALPHA1 = 40.0
"""alpha1 of the fast observer in the thesis, 1/s. The alpha2 of this observer is 400/s^2."""


class ObserverForm(StrEnum):
    """The equations of the observer; the two forms differ unless eps is 1."""

    CORRECTED = "corrected"
    PRINTED = "printed"
    """Equations (4.1) and (4.2) as printed in the thesis."""


@dataclass(frozen=True)
class HighGainObserver:
    """A high-gain observer for samples at intervals of `interval_s`; alpha1 is in 1/s, alpha2 in 1/s^2.

    The constructor raises ModelError unless all numbers are positive and `interval_s` is below `longest_interval_s`.
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
        """Return the observer with alpha2 = alpha1^2 / 4, as in the thesis.

        Parameters
        ----------
        alpha1 : float
            Gain alpha1 (1/s).
        interval_s : float
            Interval between samples (s).
        epsilon : float, default 1.0
            Time scale eps of the observer, without unit.

        Returns
        -------
        HighGainObserver
        """
        return cls(alpha1, alpha1**2 / 4, interval_s, epsilon)

    @property
    def correction(self) -> float:
        """Gain from the position error theta - h to w', 1/s^2."""
        return self.alpha2 / (self.epsilon if self.form is ObserverForm.PRINTED else self.epsilon**2)

    @property
    def longest_interval_s(self) -> float:
        """Interval (s) at which the observer becomes unstable: a pole of Psi is -1 (Jury's criterion)."""
        a1, a2 = self.alpha1 / self.epsilon, self.correction
        return (a1 + math.sqrt(a1**2 + 4 * a2)) / a2

    @property
    def transfer(self) -> DiscreteFilter:
        """Psi(z), from position (mm) to velocity (mm/s)."""
        eps, t, gain = self.epsilon, self.interval_s, self.epsilon * self.correction * self.interval_s
        denominator = (eps + self.alpha1 * t, -(2 * eps + self.alpha1 * t - gain * t), eps)
        return DiscreteFilter((gain, -gain, 0.0), denominator, t)

    @property
    def normalised(self) -> DiscreteFilter:
        """Psi(z) divided by the backward difference quotient: a low-pass filter with unit gain at zero frequency."""
        psi = self.transfer
        return DiscreteFilter((psi.numerator[0] * self.interval_s, 0.0, 0.0), psi.denominator, self.interval_s)

    def observe(self, position: Array) -> Array:
        """Return the estimated velocity at every sample of `position`, shape (samples,), starting from rest.

        The result equals that of `stream`, bit by bit. Raises DataError unless `position` is a row of finite numbers.
        """
        position = np.asarray(position, float)
        if position.ndim != 1 or not np.isfinite(position).all():
            raise DataError(Mistake("position", f"shape {position.shape}", "must be a row of finite numbers"))
        stream = self.stream()
        return np.array([stream.push(each) for each in position.tolist()], float)

    def stream(self) -> ObserverStream:
        """Return a running observer that processes one position at a time."""
        return ObserverStream(self)


class ObserverStream:
    """A running observer. `position` and `velocity` are the latest estimates, None and 0 before the first sample."""

    def __init__(self, observer: HighGainObserver) -> None:
        self._eps, self._t = observer.epsilon, observer.interval_s
        self._pull = observer.alpha1 * observer.interval_s
        self._gain = observer.correction * observer.interval_s
        self.position: float | None = None
        self.velocity: float = 0.0

    def push(self, position: float) -> float:
        """Process one measured position and return the estimated velocity, in the unit of the position per second."""
        last = position if self.position is None else self.position
        eps = self._eps
        self.position = (eps * last + eps * self._t * self.velocity + self._pull * position) / (eps + self._pull)
        self.velocity += self._gain * (position - self.position)
        return self.velocity


@dataclass(frozen=True)
class Projection(CallRepr):
    """H(z) = Psi_slow/Psi_fast, (4.3): from the velocity of the needle to the velocity relative to the tissue.

    The factors z (z - 1) cancel, so that H and its inverse are causal and stable. The inverse amplifies frequencies
    above the corner frequency of the slow observer; the gain is largest at the Nyquist frequency. The constructor
    raises ModelError if the intervals of the observers differ.
    """

    fast: HighGainObserver
    slow: HighGainObserver

    def __post_init__(self) -> None:
        if self.fast.interval_s != self.slow.interval_s:
            rule = f"must be that of the fast observer, {self.fast.interval_s:g} s"
            raise ModelError(Mistake("slow.interval_s", f"{self.slow.interval_s:g}", rule), "projection")

    @classmethod
    def critically_damped(cls, slow_alpha1: float, interval_s: float, fast_alpha1: float = FAST_ALPHA1) -> Projection:
        """Return the projection between two critically damped observers.

        Parameters
        ----------
        slow_alpha1 : float
            Gain alpha1 of the slow observer (1/s).
        interval_s : float
            Interval between samples (s).
        fast_alpha1 : float, optional
            Gain alpha1 of the fast observer (1/s).

        Returns
        -------
        Projection
        """
        fast, slow = (HighGainObserver.critically_damped(each, interval_s) for each in (fast_alpha1, slow_alpha1))
        return cls(fast, slow)

    @property
    def transfer(self) -> DiscreteFilter:
        """H(z), from the velocity of the fast observer to the relative velocity."""
        fast, slow = self.fast.transfer, self.slow.transfer
        ratio = slow.numerator[0] / fast.numerator[0]
        return DiscreteFilter(tuple(ratio * each for each in fast.denominator), slow.denominator, fast.interval_s)

    @property
    def inverse(self) -> DiscreteFilter:
        """1/H(z), from the relative velocity to the velocity of the fast observer."""
        return self.transfer.inverse()

    def attenuation(self, frequency_hz: Array | float) -> Array:
        """Return 1 - |H| at each frequency, of the shape of `frequency_hz`."""
        return np.asarray(1 - np.abs(self.transfer.response(frequency_hz)))

    def lag_rad(self, frequency_hz: Array | float) -> Array:
        """Return the phase lag of H (rad), of the shape of `frequency_hz`; positive for a delay."""
        return np.asarray(-np.angle(self.transfer.response(frequency_hz)))
