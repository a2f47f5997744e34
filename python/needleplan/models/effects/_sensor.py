"""Effects of the force sensor and of the mass attached to it; they change the measured force but not the needle.

**Delay.** A pure delay has no finite-dimensional state. `Lagging` approximates it by 256 first-order lags in series,
each with a 256th of the delay. A step at the input reaches the output after the delay. The step is spread out with a
standard deviation of a sixteenth of the delay (Erlang distribution; MacDonald, Time Lags in Biological Models, 1978).
With fewer lags, a fit would mistake this spread for the sensor's own filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import gammainc, gammaincinv, gammaln, xlogy

from needleplan.models._base import Model, WrappingModel
from needleplan.models._parameter import parameter
from needleplan.models._simulate import output_from_rest, simulate
from needleplan.models.effects._base import Memoryless, Term
from needleplan.signals import Array, Motion

__all__ = ["Bias", "Drift", "GainError", "Inertia", "Lagging", "ThermalDrift"]

# Force that accelerates 1 kg by 1 mm/s^2, N.
_N_PER_KG_MM_S2 = 1e-3
# Time constant of the acceleration filter, s; shorter than the lag of a force sensor.
_DIFFERENCE_S = 0.005


@dataclass(frozen=True, kw_only=True)
class Bias(Memoryless):
    """A constant offset of the sensor."""

    size: float = parameter("N", -20, 20, "reading at zero force", typical=0.01)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return ones, of the shape of the depth."""
        return np.ones_like(np.asarray(motion.depth_mm, float))


@dataclass(frozen=True, kw_only=True)
class Drift(Memoryless):
    """A linear drift of the sensor's zero from the time 0 of each trial."""

    size: float = parameter("N/s", -1, 1, "rate of the zero", typical=1e-3)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the time (s), shape (...)."""
        return np.asarray(motion.time_s, float)


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(Memoryless):
    """An exponential drift of the sensor's zero while the sensor warms up, from the time 0 of each trial."""

    size: float = parameter("N", -20, 20, "final shift of the zero", typical=0.01)
    time_s: float = parameter("s", 0.1, 1e4, "time constant of the warming")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return 1 - exp(-t/time)."""
        return -np.expm1(-np.asarray(motion.time_s, float) / self.time_s)


@dataclass(frozen=True, kw_only=True)
class GainError(Memoryless):
    """A wrong gain of the sensor.

    If friction and cutting are fitted too, their parameters absorb this effect. The effect is visible only if the
    parameters of the base model are known.
    """

    size: float = parameter("", -0.9, 5, "relative error of the gain", typical=0.01)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the force without the effect (N), shape (...)."""
        return plain


@dataclass(frozen=True, kw_only=True)
class Inertia(Term):
    """Inertia of the mass attached to the sensor, such as the needle holder."""

    order: ClassVar[int] = 1
    size: float = parameter("kg", 0, 100, "mass that the sensor accelerates", typical=0.1)

    def initial(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return 0, the smoothed velocity at the first sample (mm/s), shape (1,)."""
        return np.zeros(1)

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rate of change of the smoothed velocity (mm/s^2), shape (1, ...)."""
        return np.asarray((np.asarray(motion.velocity_mm_s, float) - state) / _DIFFERENCE_S)

    def states(self, motion: Motion, start: Array) -> Array:
        """Return the state (mm/s), shape (1, samples), for which `shape` is the acceleration of the motion.

        The whole motion is known, so the acceleration has no lag. The first state is `start`.
        """
        states: Array = (motion.velocity_mm_s - _DIFFERENCE_S * motion.acceleration_mm_s2)[None]
        states[:, 0] = start
        return states

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the smoothed acceleration (N/kg), shape (...)."""
        return np.asarray(_N_PER_KG_MM_S2 * (motion.velocity_mm_s - state[0]) / _DIFFERENCE_S)


# Number of first-order lags in series.
_STAGES = 256
# Delays of a force through all stages, in lags of a stage: quantiles of their distribution.
_DELAYS = gammaincinv(_STAGES, (np.arange(32) + 0.5) / 32)
# Smallest lag of a stage, s; avoids a division by zero.
_SHORTEST_S = 1e-9
# Remainder of the step response below which the impulse response is truncated.
_FORGOTTEN = 1e-13
# Relative deviation of a sampling interval above which the samples count as uneven.
_EVEN = 1e-3
# Steps of the even grid per median sampling interval, for unevenly sampled records.
_FINER = 4


@dataclass(frozen=True, kw_only=True)
class Lagging(WrappingModel):
    """A model whose measurement is delayed by `size` (s), approximated by 256 first-order lags in series.

    Lag i has the output y_i, in the unit of the channel, with (size/256) y_i' = y_(i-1) - y_i. Its input y_0 is the
    output of the base model; y_256 is the delayed output. The state, shape (n + 256, ...), is the state of the base
    model, followed by y_1 to y_256.
    """

    base: Model
    size: float = parameter("s", 0, 10, "delay of the reading", typical=0.01)

    def initial_state(self, motion: Motion) -> Array:
        """Return the state of the base at rest, followed by 256 copies of its output, shape (n + 256,)."""
        base_state = self.base.initial_state(motion)
        first = motion[0] if np.ndim(motion.depth_mm) else motion
        return np.append(base_state, np.full(_STAGES, float(self.base.output(base_state, first))))

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the state of the base and of the stages, shape (n + 256, ...)."""
        base_state, stages = state[:-_STAGES], state[-_STAGES:]
        before = np.concatenate([self.base.output(base_state, motion)[None], stages[:-1]])
        return np.concatenate([self.base.derivative(base_state, motion), (before - stages) / self._lag_s])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the delayed output; the output of the base model if the amplitude is 0."""
        return np.asarray(state[-1]) if self.size else self.base.output(state[:-_STAGES], motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the state of the base and the outputs of the lags at every sample, shape (n + 256, samples).

        The outputs of the lags are exact for a force that is linear between evenly spaced samples. For uneven samples
        the outputs are computed on a finer even grid and interpolated.
        """
        states = simulate(self.base, motion, start[:-_STAGES]).states
        force = np.asarray(self.base.output(states, motion), float)
        outputs = np.empty((len(start), len(motion)))
        outputs[:-_STAGES] = states
        _pass(force, motion.time_s, start[-_STAGES:], self._lag_s, outputs[-_STAGES:])
        return outputs

    def output_from_rest(self, motion: Motion) -> Array:
        """Return the delayed output along a motion that starts at rest, shape (samples,).

        The delays of 256 equal stages have an Erlang distribution. The output is the mean over its quantiles of the
        delayed force, which is linear between the samples.
        """
        force = output_from_rest(self.base, motion)
        times = np.asarray(motion.time_s, float)
        delayed = np.zeros(len(times))
        for delay in (self._lag_s * _DELAYS).tolist():
            delayed += np.interp(times - delay, times, force)
        return delayed / len(_DELAYS)

    @property
    def _lag_s(self) -> float:
        return max(self.size / _STAGES, _SHORTEST_S)


def _pass(force: Array, time_s: Array, start: Array, lag_s: float, outputs: Array) -> None:
    """Compute the outputs of all stages for the input `force` and write them into `outputs`, shape (stages, samples).

    `start`, shape (stages,), holds the outputs at the first sample.
    """
    step = np.diff(time_s)
    h = float(np.median(step)) if len(step) else 1.0
    if len(step) and float(np.abs(step - h).max()) > _EVEN * h:
        even = np.linspace(time_s[0], time_s[-1], int(np.ceil(_FINER * (time_s[-1] - time_s[0]) / h)) + 1)
        stages = np.empty((_STAGES, len(even)))
        _pass(np.interp(even, time_s, force), even, start, lag_s, stages)
        at = (time_s - even[0]) / (even[1] - even[0])
        left = np.minimum(at.astype(int), len(even) - 2)
        outputs[:] = stages[:, left] + (at - left) * (stages[:, left + 1] - stages[:, left])
        return
    count = min(int(np.ceil(gammaincinv(_STAGES, 1 - _FORGOTTEN) * lag_s / h)) + 2, len(force) + 1)
    # Ramp response of the stages; the second differences of a piecewise linear force weight it.
    spent, order = h / lag_s * np.arange(count)[:, None], np.arange(1, _STAGES + 2)
    through = gammainc(order, spent)
    ramp = lag_s / h * (spent * through[:, :-1] - order[:-1] * through[:, 1:])
    weights = np.diff(np.vstack([np.zeros(_STAGES), ramp]), 2, axis=0)
    before = np.concatenate([np.full(count - 2, force[0]), force])
    rows = np.array([before[count - 2 - past : len(before) - past] for past in range(count - 1)])
    np.matmul(np.ascontiguousarray(weights.T), rows, out=outputs)
    other = start - force[0]
    if other.any():  # the stages do not start in the steady state of the first force
        passed = np.arange(_STAGES)
        for index in range(min(count, len(force))):
            its = index * h / lag_s
            share = np.exp(xlogy(passed, its) - its - gammaln(passed + 1))
            outputs[:, index] += np.convolve(other, share)[:_STAGES]
