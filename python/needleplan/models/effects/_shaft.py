"""Effects of friction along the shaft and of cutting at the tip.

The internal state of every term contains two properties of the past path: the deflection of Dahl's bristle along the
shaft, and the largest depth so far.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from needleplan.models._parameter import constant, parameter
from needleplan.models.effects._base import Term
from needleplan.models.effects._laws import USUAL_MM_S
from needleplan.models.friction import slid
from needleplan.signals import Array, Motion, SpannedMotion, recurrence

__all__ = [
    "Bump",
    "CuttingLayer",
    "CuttingSpeed",
    "CuttingWithDepth",
    "FreshCutting",
    "FrictionLayer",
    "PathDamage",
    "PathTerm",
    "Puncture",
    "Relaxation",
    "Stribeck",
    "Viscous",
    "decaying",
    "reached",
]


@dataclass(frozen=True, kw_only=True)
class PathTerm(Term):
    """Abstract base class of a term whose state is Dahl's bristle z of the shaft and the largest depth so far (mm)."""

    order: ClassVar[int] = 2
    presliding_mm: float = constant("mm", 1e-4, 50, "travel over which the bristle reverses", default=0.05)

    def initial(self, motion: Motion) -> Array:
        """Return z = 0 and the first depth, shape (2,)."""
        return np.array([0.0, float(np.ravel(motion.depth_mm)[0])])

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of bristle and largest depth, shape (2, ...)."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        fresh = np.asarray(motion.depth_mm) >= state[1]
        return np.array(
            [(velocity - np.abs(velocity) * state[0]) / self.presliding_mm, np.where(fresh, np.maximum(velocity, 0), 0)]
        )

    def states(self, motion: Motion, start: Array) -> Array:
        """Return bristle and largest depth along a motion, shape (2, samples)."""
        return np.array([slid(motion, self.presliding_mm, float(start[0])), reached(motion, float(start[1]))])


def reached(motion: Motion, start: float) -> Array:
    """Return the largest depth (mm) up to each sample, shape (samples,); `start` is the largest depth before."""
    return np.maximum(np.maximum.accumulate(motion.depth_mm), start)


def decaying(decay: Array, target: Array, start: float) -> Array:
    """Return y, shape (n + 1,), with y[0] = start and y[k+1] = target[k] + (y[k] - target[k]) decay[k]."""
    return recurrence(decay, target * (1 - decay), start)


# Length of a cell of the path, mm, and number of cells: `PathDamage` ignores depths beyond 150 mm.
_CELL_MM = 2.0
_CELLS = 75


def _inserted(motion: Motion) -> Array:
    return np.asarray(np.maximum(motion.depth_mm, 0.0))


@dataclass(frozen=True, kw_only=True)
class FrictionLayer(PathTerm):
    """A deeper layer of tissue with higher or lower friction."""

    size: float = parameter("N/mm", -1, 1, "change of the friction per length at the layer", typical=1e-3)
    depth_mm: float = parameter("mm", 0, 500, "depth at which the layer begins", typical=1.0)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the length of the shaft in the layer (mm) times the bristle, which gives the sign."""
        return np.asarray(np.maximum(_inserted(motion) - self.depth_mm, 0.0) * state[0])


@dataclass(frozen=True, kw_only=True)
class Stribeck(PathTerm):
    """Friction that is higher at low speed.

    The amplitude is a share of the model's friction, because that friction differs from trial to trial.
    """

    size: float = parameter("", 0, 20, "additional friction at rest, as a share of the friction", typical=0.1)
    speed_mm_s: float = parameter("mm/s", 1e-2, 100, "speed over which the additional friction decays")
    friction: float = constant("N/mm", 0, 10, "friction per inserted length of the model", default=1.0)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the friction of the shaft (N) times exp(-|v|/speed)."""
        shaft = self.friction * _inserted(motion) * state[0]
        return np.asarray(shaft * np.exp(-np.abs(motion.velocity_mm_s) / self.speed_mm_s))


@dataclass(frozen=True, kw_only=True)
class Viscous(PathTerm):
    """Friction in proportion to the speed."""

    size: float = parameter("N s/mm2", -1e-2, 1e-2, "friction per length and speed", typical=1e-4)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the inserted length times the velocity (mm2/s)."""
        return np.asarray(_inserted(motion) * np.asarray(motion.velocity_mm_s))


@dataclass(frozen=True, kw_only=True)
class Relaxation(PathTerm):
    """Decay of the force while the needle rests; a short travel restores the force (Maxwell)."""

    order: ClassVar[int] = 3
    size: float = parameter("", 0, 1, "share of the force that relaxes", typical=0.1)
    time_s: float = parameter("s", 0.02, 1e3, "time constant of the relaxation")
    recovery_mm: float = parameter("mm", 1e-3, 20, "travel over which the force recovers")

    def initial(self, motion: Motion) -> Array:
        """Return the state of the path and a relaxed share of 0, shape (3,)."""
        return np.asarray(np.append(super().initial(motion), 0.0))

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change, shape (3, ...); the relaxed share grows with time and decays with travel."""
        speed = np.abs(np.asarray(motion.velocity_mm_s, float))
        relaxed = (1 - state[2]) / self.time_s - state[2] * speed / self.recovery_mm
        return np.asarray(np.concatenate([super().rate(state[:2], motion), relaxed[None]]))

    def states(self, motion: Motion, start: Array) -> Array:
        """Return the internal state along a motion, shape (3, samples).

        The solution is exact if the speed is constant between samples.
        """
        rows = (np.asarray(row, float).tobytes() for row in (motion.depth_mm, motion.time_s))
        share = _relaxed(*rows, self.time_s, self.recovery_mm, float(start[2]))
        return np.asarray(np.vstack([super().states(motion, start[:2]), share]))

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the force (N) times the relaxed share, with negative sign."""
        return np.asarray(-state[2] * plain)


@dataclass(frozen=True, kw_only=True)
class PathDamage(PathTerm):
    """Friction that decreases where the shaft has slid.

    The internal state also contains the sliding distance (mm) in every cell of the path.
    """

    order: ClassVar[int] = 2 + _CELLS
    size: float = parameter("", 0, 1.5, "share of the friction that wears away", typical=0.2)
    sliding_mm: float = parameter("mm", 0.5, 5000, "sliding distance over which the friction wears away")
    friction: float = constant("N/mm", 0, 10, "friction per inserted length of the model", default=1.0)

    def initial(self, motion: Motion) -> Array:
        """Return the state of the path and sliding distances of 0, shape (2 + cells,)."""
        return np.asarray(np.concatenate([super().initial(motion), np.zeros(_CELLS)]))

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change, shape (2 + cells, ...); sliding distances grow in the cells behind the tip."""
        depth, speed = np.asarray(motion.depth_mm, float), np.abs(np.asarray(motion.velocity_mm_s, float))
        slid = np.zeros((_CELLS, *speed.shape))
        filled = _filled(depth)
        slid[: len(filled)] = filled * speed
        return np.asarray(np.concatenate([super().rate(state[:2], motion), slid]))

    def states(self, motion: Motion, start: Array) -> Array:
        """Return the internal state along a motion, shape (2 + cells, samples)."""
        states = np.empty((self.order, len(motion)))
        states[:2] = super().states(motion, start[:2])
        states[2:] = start[2:, None]
        slid = _slid_past(np.asarray(motion.depth_mm, float).tobytes())
        states[2 : 2 + len(slid), 1:] += slid
        return states

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the friction (N) of the shaft, weighted with the wear of each cell, with negative sign."""
        filled = _filled(_inserted(motion))
        worn = -np.expm1(-np.maximum(state[2 : 2 + len(filled)], 0.0) / self.sliding_mm)
        return np.asarray(-self.friction * (worn * filled * _CELL_MM).sum(axis=0) * state[0])


@lru_cache(maxsize=8)
def _slid_past(depth_mm: bytes) -> Array:
    """Return the sliding distance (mm) in each cell after each step, shape (cells, steps).

    `depth_mm` is the byte string of the depths, so that the result can be cached: a fit repeats the same motion.
    """
    depth = np.frombuffer(depth_mm)
    filled = _filled(depth)
    return _read_only(np.cumsum(np.abs(np.diff(depth)) * (filled[:, 1:] + filled[:, :-1]) / 2, axis=1))


@lru_cache(maxsize=16)
def _relaxed(depth_mm: bytes, time_s: bytes, relaxing_s: float, recovery_mm: float, start: float) -> Array:
    """Return the relaxed share, shape (samples,).

    Depths and times are byte strings, so that the result can be cached: a fit repeats the same motion.
    """
    step = np.diff(np.frombuffer(time_s))
    rate = 1 / relaxing_s + np.abs(np.diff(np.frombuffer(depth_mm))) / step / recovery_mm
    return _read_only(decaying(np.exp(-rate * step), 1 / (relaxing_s * rate), start))


def _read_only(values: Array) -> Array:
    """Make an array read-only, because several callers share it, and return it."""
    values.flags.writeable = False
    return values


def _filled(depth_mm: Array) -> Array:
    """Return the share of each cell that the shaft fills, shape (cells, ...), up to the cell of the largest depth."""
    count = math.ceil(min(max(1.0, float(np.max(depth_mm)) / _CELL_MM), _CELLS))
    edges = (np.arange(count) * _CELL_MM).reshape((-1,) + (1,) * np.ndim(depth_mm))
    return np.asarray(np.clip((depth_mm - edges) / _CELL_MM, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Bump(PathTerm):
    """Resistance at one depth each time the tip passes this depth, caused by an air bubble, a fibre or a lesion."""

    size: float = parameter("N", -20, 20, "force at the bump", typical=0.1)
    depth_mm: float = parameter("mm", 0, 500, "depth of the bump", typical=1.0)
    width_mm: float = parameter("mm", 0.1, 30, "half width at which the force has fallen to 1/e")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return a Gaussian in depth times the bristle, which directs the force against the movement."""
        return np.asarray(np.exp(-(((np.asarray(motion.depth_mm) - self.depth_mm) / self.width_mm) ** 2)) * state[0])


def _pushed(state: Array) -> Array:
    """Return the share of the cutting force that acts: 1 while the tip is pushed in, 0 after some retraction."""
    return np.asarray((1 + state[0]) / 2)


@dataclass(frozen=True, kw_only=True)
class Puncture(PathTerm):
    """A membrane that deforms until it breaks.

    The force grows as exp((L - depth)/bulge) and decays fast after the break. Later passes of the tip meet no force.
    """

    size: float = parameter("N", 0, 20, "force at which the membrane breaks", typical=0.1)
    depth_mm: float = parameter("mm", 0, 500, "depth at which the membrane breaks", typical=1.0)
    bulge_mm: float = parameter("mm", 0.1, 30, "travel over which the force grows by the factor e")
    release_mm: float = constant("mm", 1e-3, 10, "travel over which the force decays after the break", default=0.3)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return exp((L - depth)/bulge) until the membrane breaks, and the decay after the break.

        A sample of a `SpannedMotion` whose tip is in fresh tissue has the mean over its depths: within a sample
        interval the force falls by a large part.
        """
        depth = np.asarray(motion.depth_mm)
        before = np.exp(np.minimum((depth - self.depth_mm) / self.bulge_mm, 0.0))
        broken = np.exp(-np.maximum(state[1] - self.depth_mm, 0.0) / self.release_mm)
        force = np.asarray(before * broken)
        if isinstance(motion, SpannedMotion):
            fresh = (motion.span_mm > 0) & (depth >= state[1])
            place, half = depth[fresh] - self.depth_mm, motion.span_mm[fresh] / 2
            force[fresh] = (self._work(place + half) - self._work(place - half)) / (2 * half)
        return np.asarray(force * _pushed(state))

    def _work(self, place_mm: Array) -> Array:
        """Return the integral (mm) of the shape in fresh tissue up to depths that are measured from the membrane."""
        before = self.bulge_mm * np.exp(np.minimum(place_mm, 0.0) / self.bulge_mm)
        return np.asarray(before - self.release_mm * np.expm1(-np.maximum(place_mm, 0.0) / self.release_mm))


@dataclass(frozen=True, kw_only=True)
class CuttingLayer(PathTerm):
    """A deeper layer of tissue with a higher or lower cutting force."""

    size: float = parameter("N", -20, 20, "change of the cutting force at the layer", typical=0.1)
    depth_mm: float = parameter("mm", 0, 500, "depth at which the layer begins", typical=1.0)
    width_mm: float = parameter("mm", 0.05, 20, "half width of the transition between the layers")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return a smooth step from 0 to 1 in depth, while the tip is pushed in."""
        step = 0.5 * (1 + np.tanh((np.asarray(motion.depth_mm) - self.depth_mm) / self.width_mm))
        return np.asarray(step * _pushed(state))


@dataclass(frozen=True, kw_only=True)
class FreshCutting(PathTerm):
    """Lower cutting force along the old path of the tip, because the tissue is already cut there.

    The amplitude is a share of the model's cutting force, because that force differs from trial to trial and rises with
    the depth.
    """

    size: float = parameter("", 0, 1.5, "missing share of the cutting force in tissue that is already cut", typical=0.2)
    margin_mm: float = parameter(
        "mm", 0.01, 10, "distance from the end of the old path over which the cutting force returns"
    )
    cutting: float = constant("N", 0, 100, "cutting force of the model", default=1.0)
    onset_mm: float = constant("mm", 1e-2, 50, "depth over which the cutting force of the model rises", default=1e-2)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the model's cutting force (N) along the old path of the tip, with negative sign; 0 in fresh tissue."""
        depth = np.asarray(motion.depth_mm)
        full = -self.cutting * np.expm1(-np.maximum(depth, 0.0) / self.onset_mm)
        behind = np.maximum(state[1] - depth, 0.0)
        return np.asarray(full * np.expm1(-behind / self.margin_mm) * _pushed(state))


@dataclass(frozen=True, kw_only=True)
class CuttingWithDepth(PathTerm):
    """Cutting force that grows with the depth."""

    size: float = parameter("N/mm", -1, 1, "growth of the cutting force with depth", typical=1e-3)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the depth (mm) while the tip is pushed in, 0 after some retraction."""
        return np.asarray(np.maximum(motion.depth_mm, 0.0) * _pushed(state))


@dataclass(frozen=True, kw_only=True)
class CuttingSpeed(PathTerm):
    """Cutting force that depends on the speed, as the work of fracture of a viscoelastic solid does.

    The amplitude is a share of the model's cutting force, because that force differs from trial to trial and rises with
    the depth.
    """

    size: float = parameter("", -0.9, 20, "additional cutting force at 5 mm/s, as a share of that at rest", typical=0.1)
    power: float = parameter("", 0.1, 1.5, "exponent of the speed")
    cutting: float = constant("N", 0, 100, "cutting force of the model", default=1.0)
    onset_mm: float = constant("mm", 1e-2, 50, "depth over which the cutting force of the model rises", default=1e-2)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the model's cutting force (N) times (v / 5 mm/s)^power, while the tip is pushed in."""
        full = -self.cutting * np.expm1(-np.maximum(motion.depth_mm, 0.0) / self.onset_mm)
        return np.asarray(full * (np.maximum(motion.velocity_mm_s, 0.0) / USUAL_MM_S) ** self.power * _pushed(state))
