"""A reading that is late: it arrives some time after the force.

A line that delays has no finite state. 32 lags of first order in a row, each a 32nd of the delay, are nearly
one: what goes in as a step comes out within a fifth of the delay (an Erlang distribution; MacDonald, Time Lags in
Biological Models, 1978).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.models.base import Channel, Model, SelfIntegratingModel
from needleplan.models.parameter import parameter
from needleplan.models.recurrence import recurrence
from needleplan.models.simulate import simulate
from needleplan.signals import Array, Motion

__all__ = ["Lagging"]

_STAGES = 32
_SHORTEST_S = 1e-9
_MOST_PARTS = 8


@dataclass(frozen=True, kw_only=True)
class Lagging(SelfIntegratingModel):
    """A model as it is measured by a sensor that is late by `size`.

    State: that of the model, then y_1 to y_32, of which the last is read: (size/32) y_i' = y_(i-1) - y_i, y_0 = F.
    """

    base: Model
    size: float = parameter("s", 0, 10, "time by which the reading is late", typical=0.01)

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    def initial_state(self, motion: Motion) -> Array:
        """Return that of the base, and its output at every stage."""
        own = self.base.initial_state(motion)
        first = motion[0] if np.ndim(motion.depth_mm) else motion
        return np.append(own, np.full(_STAGES, float(self.base.output(own, first))))

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of the base and of the stages."""
        own, stages = state[:-_STAGES], state[-_STAGES:]
        before = np.concatenate([self.base.output(own, motion)[None], stages[:-1]])
        return np.concatenate([self.base.derivative(own, motion), (before - stages) / self._lag_s])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the reading; the output of the base, where the size is 0."""
        return np.asarray(state[-1]) if self.size else self.base.output(state[:-_STAGES], motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states; the stages exactly for what is linear within parts of a sample that suit the lag."""
        states = simulate(self.base, motion, start[:-_STAGES]).states
        force = np.asarray(self.base.output(states, motion), float)
        parts = min(max(math.ceil(float(motion.interval_s.max()) / self._lag_s), 1), _MOST_PARTS)
        share = np.arange(1, parts + 1) / parts
        entering = np.append(force[0], (force[:-1, None] + np.diff(force)[:, None] * share).ravel())
        h = np.repeat(motion.interval_s / parts, parts)
        decay = np.exp(-h / self._lag_s)
        stages = np.empty((_STAGES, len(force)))
        for index, begin in enumerate(start[-_STAGES:]):
            slope = np.diff(entering) / h
            entering = entering + recurrence(decay, -self._lag_s * slope * (1 - decay), float(begin - entering[0]))
            stages[index] = entering[::parts]
        return np.vstack([states, stages])

    @property
    def _lag_s(self) -> float:
        return max(self.size / _STAGES, _SHORTEST_S)
