"""Effects of tissue that moves: with the needle, because it gives way, or by itself, because somebody breathes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from needleplan.models.base import Channel, Model, SelfIntegratingModel
from needleplan.models.insertion import ShaftAndTip
from needleplan.models.parameter import parameter
from needleplan.models.simulate import simulate
from needleplan.models.sliding import slid_along
from needleplan.signals import Array, Motion

__all__ = ["BreathingTissue", "GivingTissue", "SlowTurning", "breathing_forces"]

_AT_ONCE = 16


@dataclass(frozen=True, kw_only=True)
class SlowTurning(SelfIntegratingModel):
    """A model whose friction turns round over a travel that is longer by `size`; the state is that of the model."""

    base: ShaftAndTip
    size: float = parameter("mm", 0, 20, "travel beyond that of the model over which friction turns round", typical=0.1)

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    @cached_property
    def slow(self) -> ShaftAndTip:
        """The base with the longer travel; the base itself, where the size is 0."""
        longest = self.base.parameters()["presliding_mm"].upper
        travel = min(self.base.presliding_mm + self.size, longest)
        return self.base.with_values(presliding_mm=travel) if self.size else self.base

    def initial_state(self, motion: Motion) -> Array:
        """Return that of the base."""
        return self.base.initial_state(motion)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates."""
        return self.slow.derivative(state, motion)

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the force."""
        return self.slow.output(state, motion)

    def shaft_n(self, state: Array, motion: Motion) -> Array:
        """Return the friction along the shaft."""
        return self.slow.shaft_n(state, motion)

    def tip_n(self, state: Array, motion: Motion) -> Array:
        """Return the force on the tip."""
        return self.slow.tip_n(state, motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states."""
        return self.slow.integrate(motion, start)


@dataclass(frozen=True, kw_only=True)
class GivingTissue(SelfIntegratingModel):
    """A model in tissue that a spring and a damper hold (Kelvin and Voigt), and that gives way by `size`.

    The tissue goes with the needle until spring and damper, k u + c u', reach the friction; then it stays at u = size.
    In parts of the friction y = (u + lag u') / size, from -1 to 1: along the shaft y is what the bristle of the base is
    otherwise. The tip, which cuts, feels nothing of it.
    State: that of the model, then u (mm).
    """

    base: ShaftAndTip | SlowTurning
    size: float = parameter("mm", 0, 50, "how far the tissue goes with the needle before it slides", typical=0.5)
    lag_s: float = parameter("s", 1e-3, 20, "damper over spring")

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    def initial_state(self, motion: Motion) -> Array:
        """Return that of the base, and tissue where it rests."""
        return np.append(self.base.initial_state(motion), 0.0)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates; the tissue has the velocity of the needle, or that with which it sinks back."""
        velocity, moved = np.asarray(motion.velocity_mm_s, float), state[1]
        pull = moved + self.lag_s * velocity
        sinking = (np.sign(pull) * self.size - moved) / self.lag_s
        tissue = np.where(np.abs(pull) <= self.size, velocity, sinking)
        return np.concatenate([self.base.derivative(state[:1], motion), np.asarray(tissue)[None]])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the force; that of the base, where the size is 0."""
        if not self.size:
            return self.base.output(state[:1], motion)
        pull = (state[1] + self.lag_s * np.asarray(motion.velocity_mm_s)) / self.size
        shaft = self.base.shaft_n(np.clip(pull, -1.0, 1.0)[None], motion)
        return shaft + self.base.tip_n(state[:1], motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states; the tissue step by step, at the mean velocity of each."""
        rows = (np.asarray(row, float).tobytes() for row in (motion.velocity_mm_s, motion.time_s))
        places = _given_way(*rows, self.size, self.lag_s, float(start[1]))
        return np.vstack([self.base.integrate(motion, start[:1]), places])


@lru_cache(maxsize=16)
def _given_way(velocity_mm_s: bytes, time_s: bytes, size_mm: float, lag_s: float, start_mm: float) -> Array:
    """Return where the tissue is, (samples,), for the bytes of a motion: whatever base a fit tries, it moves alike."""
    velocity, h = np.frombuffer(velocity_mm_s), np.diff(np.frombuffer(time_s))
    moved, places = start_mm, [start_mm]
    steps = (velocity[1:] + velocity[:-1]) / 2 * h
    for step, seconds in zip(steps.tolist(), h.tolist(), strict=True):
        pull = moved + lag_s * step / seconds
        if abs(pull) <= size_mm:
            moved += step
        else:
            target = math.copysign(size_mm, pull)
            moved = target + (moved - target) * math.exp(-seconds / lag_s)
        places.append(moved)
    return np.array(places)


@dataclass(frozen=True, kw_only=True)
class BreathingTissue(SelfIntegratingModel):
    """A model whose tissue moves along the needle with the breath; the state is that of the model.

    u = size/2 (sin a - rest/2 cos^2 a + rest), a = 2 pi f t + phase: from one end to the other and back. At rest 0 this
    is a sine. At 1 it is size ((1 + sin a)/2)^2, which dwells where the breath is out, u = 0, and is the form that is
    usual for organs (Lujan et al., Med. Phys. 26 (1999) 715, n = 2). At -1 it dwells at the other end: the needle comes
    from the other side.
    """

    base: Model
    size: float = parameter("mm", 0, 30, "way of the tissue from one end to the other", typical=0.5)
    frequency_hz: float = parameter("Hz", 0.02, 5, "frequency of the breathing")
    phase_rad: float = parameter("rad", -20, 20, "phase at the begin of a trial", typical=1.0)
    rest: float = parameter("", -1, 1, "how much longer it dwells at one end: 0 a sine, 1 where u = 0", typical=1.0)

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    def relative(self, motion: Motion) -> Motion:
        """Return the motion of the needle relative to the tissue; `motion` itself, where the size is 0."""
        if not self.size:
            return motion
        times = np.asarray(motion.time_s, float).tobytes()
        moved, speed = _breath(times, self.frequency_hz, self.phase_rad, self.rest)
        shape = np.shape(motion.time_s)
        depth = motion.depth_mm - self.size * moved.reshape(shape)
        velocity = motion.velocity_mm_s - self.size * speed.reshape(shape)
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


@lru_cache(maxsize=16)
def _breath(time_s: bytes, frequency_hz: float, phase_rad: float, rest: float) -> tuple[Array, Array]:
    """Return it for the bytes of times: a fit asks for it with one base after another."""
    return _breathing(np.frombuffer(time_s), frequency_hz, phase_rad, rest)


def _breathing(time_s: Array, frequency_hz: Any, phase_rad: Any, rest: Any) -> tuple[Array, Array]:
    """Return place and velocity of the tissue for size 1; numbers, or arrays of one shape with the times."""
    rate = 2 * np.pi * frequency_hz
    angle = rate * time_s + phase_rad
    sine, cosine = np.sin(angle), np.cos(angle)
    return (sine + rest * (1 - cosine**2 / 2)) / 2, rate / 2 * cosine * (1 + rest * sine)


def breathing_forces(base: ShaftAndTip, motion: Motion, breaths: Sequence[Mapping[str, float]]) -> Array:
    """Return the force in tissue that breathes, (breaths, samples), for breaths with all of their parameters.

    What `BreathingTissue` simulates for each, for as many at once as stay in fast memory.
    """
    found = np.empty((len(breaths), len(motion)))
    sizes = np.array([[each["size"]] for each in breaths])
    rows = np.array([[each[name] for name in ("frequency_hz", "phase_rad", "rest")] for each in breaths])
    kinds, which = np.unique(rows, axis=0, return_inverse=True)  # many differ in size only
    moved, speed = _breathing(motion.time_s, *kinds.T[..., None])
    for first in range(0, len(breaths), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        kind, size = which.ravel()[part], sizes[part]
        depth, velocity = motion.depth_mm - size * moved[kind], motion.velocity_mm_s - size * speed[kind]
        bristle = slid_along(velocity, motion.time_s, base.presliding_mm)
        along = Motion(motion.time_s, depth, velocity, np.sign(velocity), motion.angle_rad)
        found[part] = base.output(bristle[None], along)
    return found
