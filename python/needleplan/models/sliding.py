"""Dahl's bristle along a motion: what friction that knows the path only does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from needleplan.models.recurrence import recurrence
from needleplan.signals import Array, Motion

__all__ = ["slid", "slid_along"]


def slid(motion: Motion, length_mm: float, start: float = 0.0) -> Array:
    """Return z of z' = (v - |v| z)/length along a motion, shape (samples,), not to be written to.

    `start` is z at the first sample.

    Exact for a velocity that is linear between samples, a reversal within a step too: on either side of it z goes
    exponentially with the way to the sign of the velocity.
    """
    velocity, time = np.asarray(motion.velocity_mm_s, float), np.asarray(motion.time_s, float)
    return _slid(velocity.tobytes(), time.tobytes(), float(length_mm), float(start))


def slid_along(velocity_mm_s: Array, time_s: Array, length_mm: float) -> Array:
    """Return z of many motions at the same times, (motions, samples), that starts at 0; `velocity_mm_s` has its shape.

    One recurrence for all: what takes the end of a motion to the begin of the next one forgets it.
    """
    factor, offset = np.zeros(velocity_mm_s.shape), np.zeros(velocity_mm_s.shape)
    factor[:, :-1], offset[:, :-1] = _steps(*_ways_of(velocity_mm_s, np.diff(time_s)), length_mm)
    return recurrence(factor.ravel()[:-1], offset.ravel()[:-1], 0.0).reshape(velocity_mm_s.shape)


@lru_cache(maxsize=32)
def _slid(velocity_mm_s: bytes, time_s: bytes, length_mm: float, start: float) -> Array:
    """Return it for the bytes of a motion: a fit asks for it many times with the same length, term after term."""
    found = recurrence(*_steps(*_ways(velocity_mm_s, time_s), length_mm), start)
    found.flags.writeable = False
    return found


_Turns = tuple[NDArray[np.intp], ...]


def _steps(way: Array, back: Array, turns: _Turns, length_mm: float) -> tuple[Array, Array]:
    """Return how much of z is left after every step, and what is added to it."""
    e1 = np.exp(-np.abs(way) / length_mm)
    offset = np.sign(way) * (1 - e1)
    if back.size:
        e2 = np.exp(-np.abs(back) / length_mm)
        offset[turns] = offset[turns] * e2 + np.sign(back) * (1 - e2)
        e1[turns] *= e2
    return e1, offset


@lru_cache(maxsize=16)
def _ways(velocity_mm_s: bytes, time_s: bytes) -> tuple[Array, Array, _Turns]:
    """Return it for the bytes of a motion: it does not depend on the length, of which a fit tries many."""
    return _ways_of(np.frombuffer(velocity_mm_s), np.diff(np.frombuffer(time_s)))


def _ways_of(velocity: Array, h: Array) -> tuple[Array, Array, _Turns]:
    """Return the way of every step, up to a reversal within it; the way back after each reversal; and in which steps.

    The last axis of `velocity` is that of the samples, one more than `h` has.
    """
    first, last = velocity[..., :-1], velocity[..., 1:]
    way = (first + last) / 2 * h
    turns = np.nonzero(first * last < 0)
    before, after, seconds = first[turns], last[turns], h[turns[-1]]
    share = before / (before - after)  # of the step, before the reversal
    way[turns] = before * share / 2 * seconds
    return way, after * (1 - share) / 2 * seconds, turns
