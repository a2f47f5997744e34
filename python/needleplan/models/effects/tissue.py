"""Effects of tissue that moves: with the needle, because it gives way, or by itself, because somebody breathes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.base import Channel, Model, SelfIntegratingModel
from needleplan.models.effects.path import PathTerm
from needleplan.models.parameter import parameter
from needleplan.models.simulate import simulate
from needleplan.signals import Array, Motion

__all__ = ["BreathingTissue", "Lagging", "TissueMotion"]

_SHORTEST_S = 1e-9


@dataclass(frozen=True, kw_only=True)
class TissueMotion(PathTerm):
    """Part of the friction acts on tissue that a spring and a damper hold (Kelvin and Voigt).

    The tissue goes with the needle until spring and damper, k u + c u', reach the friction; then it stays at
    u = give. In parts of the friction: y = (u + lag u') / give, from -1 to 1.
    """

    name: ClassVar[str] = "tissue_motion"
    order: ClassVar[int] = 3
    size: float = parameter("N/mm", 0, 1, "friction per length on tissue that gives way", typical=1e-3)
    give_mm: float = parameter("mm", 0.02, 50, "how far the tissue goes with the needle before it slides")
    lag_s: float = parameter("s", 1e-3, 20, "damper over spring")

    def initial(self, motion: Motion) -> Array:
        """Return tissue where it rests."""
        return np.append(super().initial(motion), 0.0)

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates; the tissue has the velocity of the needle, or that with which it sinks back."""
        velocity, moved = np.asarray(motion.velocity_mm_s, float), state[2]
        pull = moved + self.lag_s * velocity
        sliding = np.sign(pull) * self.give_mm
        tissue = np.where(np.abs(pull) <= self.give_mm, velocity, (sliding - moved) / self.lag_s)
        return np.concatenate([super().rate(state[:2], motion), tissue[None]])

    def states(self, motion: Motion, start: Array) -> Array:
        """Return all three; the tissue step by step, at the mean velocity of each."""
        moved, places = float(start[2]), [float(start[2])]
        for step, h in zip(np.diff(motion.depth_mm).tolist(), motion.interval_s.tolist(), strict=True):
            pull = moved + self.lag_s * step / h
            if abs(pull) <= self.give_mm:
                moved += step
            else:
                target = math.copysign(self.give_mm, pull)
                moved = target + (moved - target) * math.exp(-h / self.lag_s)
            places.append(moved)
        return np.vstack([super().states(motion, start[:2]), places])

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return what the friction is less than on tissue that does not move."""
        pull = (state[2] + self.lag_s * np.asarray(motion.velocity_mm_s)) / self.give_mm
        return np.asarray(np.maximum(motion.depth_mm, 0.0) * (np.clip(pull, -1.0, 1.0) - state[0]))


@dataclass(frozen=True, kw_only=True)
class BreathingTissue(SelfIntegratingModel):
    """A model whose tissue moves along the needle, u = size sin(2 pi f t + phase); the state is that of the model."""

    base: Model
    size: float = parameter("mm", 0, 30, "amplitude of the tissue", typical=0.5)
    frequency_hz: float = parameter("Hz", 0.02, 5, "frequency of the breathing")
    phase_rad: float = parameter("rad", -20, 20, "phase at the begin of a trial", typical=1.0)

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    def relative(self, motion: Motion) -> Motion:
        """Return the motion of the needle relative to the tissue; `motion` itself, where the size is 0."""
        if not self.size:
            return motion
        angle = 2 * np.pi * self.frequency_hz * np.asarray(motion.time_s) + self.phase_rad
        velocity = motion.velocity_mm_s - self.size * 2 * np.pi * self.frequency_hz * np.cos(angle)
        depth = motion.depth_mm - self.size * np.sin(angle)
        return Motion(motion.time_s, depth, velocity, np.sign(velocity), motion.angle_rad)

    def initial_state(self, motion: Motion) -> Array:
        """Return that of the base."""
        return self.base.initial_state(motion)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of the base in the relative motion."""
        return self.base.derivative(state, self.relative(motion))

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the output of the base in the relative motion."""
        return self.base.output(state, self.relative(motion))

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states of the base in the relative motion."""
        return simulate(self.base, self.relative(motion), start).states


@dataclass(frozen=True, kw_only=True)
class Lagging(SelfIntegratingModel):
    """A model as it is measured by a sensor that follows it, size y' = F - y: a delay of `size` at low frequencies.

    State: that of the model, then the reading y.
    """

    base: Model
    size: float = parameter("s", 0, 10, "time by which the reading is late", typical=0.01)

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    def initial_state(self, motion: Motion) -> Array:
        """Return that of the base, and its output."""
        own = self.base.initial_state(motion)
        first = motion[0] if np.ndim(motion.depth_mm) else motion
        return np.append(own, float(self.base.output(own, first)))

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of the base and of the reading."""
        own = state[:-1]
        behind = (self.base.output(own, motion) - state[-1]) / max(self.size, _SHORTEST_S)
        return np.concatenate([self.base.derivative(own, motion), np.asarray(behind)[None]])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the reading; the output of the base, where the size is 0."""
        return np.asarray(state[-1]) if self.size else self.base.output(state[:-1], motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states; the reading exactly for a force that is linear between samples."""
        states = simulate(self.base, motion, start[:-1]).states
        force = np.asarray(self.base.output(states, motion), float)
        lag = max(self.size, _SHORTEST_S)
        h = motion.interval_s
        decay, slope = np.exp(-h / lag), np.diff(force) / h
        behind = float(start[-1] - force[0])
        late = [behind]
        for factor, rise in zip(decay.tolist(), slope.tolist(), strict=True):
            behind = -lag * rise + (behind + lag * rise) * factor
            late.append(behind)
        return np.vstack([states, force + np.array(late)])
