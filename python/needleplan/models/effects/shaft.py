"""Effects along the shaft: what friction does besides being the same everywhere and at any speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from needleplan.models.effects.path import PathTerm, decaying
from needleplan.models.parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["Bump", "FrictionLayer", "PathDamage", "Relaxation", "Stribeck", "Viscous"]

_CELL_MM = 2.0
_CELLS = 75


def _inserted(motion: Motion) -> Array:
    return np.asarray(np.maximum(motion.depth_mm, 0.0))


@dataclass(frozen=True, kw_only=True)
class FrictionLayer(PathTerm):
    """Another layer rubs more, or less."""

    name: ClassVar[str] = "friction_layer"
    size: float = parameter("N/mm", -1, 1, "friction per length in the layer, above that before it", typical=1e-3)
    depth_mm: float = parameter("mm", 0, 500, "where the layer begins", typical=1.0)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the length of shaft in the layer, with the sign of the friction."""
        return np.asarray(np.maximum(_inserted(motion) - self.depth_mm, 0.0) * state[0])


@dataclass(frozen=True, kw_only=True)
class Stribeck(PathTerm):
    """Friction is larger at low speed: by a share of what the model has, which differs from trial to trial."""

    name: ClassVar[str] = "stribeck"
    size: float = parameter("", 0, 20, "share of the friction that comes to it at rest", typical=0.1)
    speed_mm_s: float = parameter("mm/s", 1e-2, 100, "speed over which it goes")
    friction: float = constant("N/mm", 0, 10, "friction per inserted length of the model", default=1.0)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the friction of the shaft times exp(-|v|/speed)."""
        shaft = self.friction * _inserted(motion) * state[0]
        return np.asarray(shaft * np.exp(-np.abs(motion.velocity_mm_s) / self.speed_mm_s))


@dataclass(frozen=True, kw_only=True)
class Viscous(PathTerm):
    """Friction grows in proportion to the speed."""

    name: ClassVar[str] = "viscous"
    size: float = parameter("N s/mm2", -1e-2, 1e-2, "friction per length and speed", typical=1e-4)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return length times velocity."""
        return np.asarray(_inserted(motion) * np.asarray(motion.velocity_mm_s))


@dataclass(frozen=True, kw_only=True)
class Relaxation(PathTerm):
    """The force sinks while the needle rests, and is there again after a little travel (Maxwell)."""

    name: ClassVar[str] = "relaxation"
    order: ClassVar[int] = 3
    size: float = parameter("", 0, 1, "share of the force that relaxes", typical=0.1)
    time_s: float = parameter("s", 0.02, 1e3, "time over which it does")
    recovery_mm: float = parameter("mm", 1e-3, 20, "travel after which it is back")

    def initial(self, motion: Motion) -> Array:
        """Return nothing relaxed."""
        return np.asarray(np.append(super().initial(motion), 0.0))

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates; what has relaxed grows with time and is undone by travel."""
        speed = np.abs(np.asarray(motion.velocity_mm_s, float))
        relaxed = (1 - state[2]) / self.time_s - state[2] * speed / self.recovery_mm
        return np.asarray(np.concatenate([super().rate(state[:2], motion), relaxed[None]]))

    def states(self, motion: Motion, start: Array) -> Array:
        """Return all three; exact for the mean speed between two samples."""
        rows = (np.asarray(row, float).tobytes() for row in (motion.depth_mm, motion.time_s))
        share = _relaxed(*rows, self.time_s, self.recovery_mm, float(start[2]))
        return np.asarray(np.vstack([super().states(motion, start[:2]), share]))

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return minus the relaxed share of the force."""
        return np.asarray(-state[2] * plain)


@dataclass(frozen=True, kw_only=True)
class PathDamage(PathTerm):
    """Tissue along which the shaft has slid rubs less. The memory is how far it slid past each part of the path."""

    name: ClassVar[str] = "path_damage"
    order: ClassVar[int] = 2 + _CELLS
    size: float = parameter("", 0, 1.5, "share of the friction that wears away", typical=0.2)
    sliding_mm: float = parameter("mm", 0.5, 5000, "way of sliding over which it does")
    friction: float = constant("N/mm", 0, 10, "friction per inserted length of the model", default=1.0)

    def initial(self, motion: Motion) -> Array:
        """Return a path along which nothing has slid."""
        return np.asarray(np.concatenate([super().initial(motion), np.zeros(_CELLS)]))

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates; every cell that the tip has left behind counts the travel."""
        depth, speed = np.asarray(motion.depth_mm, float), np.abs(np.asarray(motion.velocity_mm_s, float))
        slid = np.zeros((_CELLS, *speed.shape))
        filled = _filled(depth)
        slid[: len(filled)] = filled * speed
        return np.asarray(np.concatenate([super().rate(state[:2], motion), slid]))

    def states(self, motion: Motion, start: Array) -> Array:
        """Return the memory; every step counts in the cells that it leaves behind."""
        states = np.empty((self.order, len(motion)))
        states[:2] = super().states(motion, start[:2])
        states[2:] = start[2:, None]
        slid = _slid_past(np.asarray(motion.depth_mm, float).tobytes())
        states[2 : 2 + len(slid), 1:] += slid
        return states

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return minus the friction of the shaft that lies in worn tissue."""
        filled = _filled(_inserted(motion))
        worn = -np.expm1(-np.maximum(state[2 : 2 + len(filled)], 0.0) / self.sliding_mm)
        return np.asarray(-self.friction * (worn * filled * _CELL_MM).sum(axis=0) * state[0])


@lru_cache(maxsize=8)
def _slid_past(depth_mm: bytes) -> Array:
    """Return how far the shaft slid past each cell by the end of each step, for the bytes of depths: (cells, steps)."""
    depth = np.frombuffer(depth_mm)
    filled = _filled(depth)
    return _kept(np.cumsum(np.abs(np.diff(depth)) * (filled[:, 1:] + filled[:, :-1]) / 2, axis=1))


@lru_cache(maxsize=16)
def _relaxed(depth_mm: bytes, time_s: bytes, relaxing_s: float, recovery_mm: float, start: float) -> Array:
    """Return what has relaxed, (samples,), for the bytes of a motion: whatever base a fit tries, it is the same."""
    step = np.diff(np.frombuffer(time_s))
    rate = 1 / relaxing_s + np.abs(np.diff(np.frombuffer(depth_mm))) / step / recovery_mm
    return _kept(decaying(np.exp(-rate * step), 1 / (relaxing_s * rate), start))


def _kept(values: Array) -> Array:
    """Return an array that several callers get, not to be written to."""
    values.flags.writeable = False
    return values


def _filled(depth_mm: Array) -> Array:
    """Return which part of every cell the shaft fills, down to the deepest one that it reaches, shape (cells, ...)."""
    count = math.ceil(min(max(1.0, float(np.max(depth_mm)) / _CELL_MM), _CELLS))
    edges = (np.arange(count) * _CELL_MM).reshape((-1,) + (1,) * np.ndim(depth_mm))
    return np.asarray(np.clip((depth_mm - edges) / _CELL_MM, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Bump(PathTerm):
    """Something at one place resists the needle each time it passes, such as an air bubble, a fibre, a lesion."""

    name: ClassVar[str] = "bump"
    size: float = parameter("N", -20, 20, "force at the place", typical=0.1)
    depth_mm: float = parameter("mm", 0, 500, "place of the tip", typical=1.0)
    width_mm: float = parameter("mm", 0.1, 30, "half width, to 1/e")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return a bell about the place, against the movement."""
        return np.asarray(np.exp(-(((np.asarray(motion.depth_mm) - self.depth_mm) / self.width_mm) ** 2)) * state[0])
