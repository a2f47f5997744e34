"""Dahl's bristle along a motion: what friction that knows the path only does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from needleplan.models.recurrence import recurrence
from needleplan.signals import Array, Motion

__all__ = ["slid"]


def slid(motion: Motion, length_mm: float, start: float = 0.0) -> Array:
    """Return z of z' = (v - |v| z)/length along a motion, shape (samples,), not to be written to.

    `start` is z at the first sample.

    Exact for a velocity that is linear between samples, a reversal within a step too: on either side of it z goes
    exponentially with the way to the sign of the velocity.
    """
    velocity, time = np.asarray(motion.velocity_mm_s, float), np.asarray(motion.time_s, float)
    return _slid(velocity.tobytes(), time.tobytes(), float(length_mm), float(start))


@lru_cache(maxsize=32)
def _slid(velocity_mm_s: bytes, time_s: bytes, length_mm: float, start: float) -> Array:
    """Return it for the bytes of a motion: a fit asks for it many times with the same length, term after term."""
    way, back, turns = _ways(velocity_mm_s, time_s)
    e1 = np.exp(-np.abs(way) / length_mm)
    offset = np.sign(way) * (1 - e1)
    if turns.size:
        e2 = np.exp(-np.abs(back) / length_mm)
        offset[turns] = offset[turns] * e2 + np.sign(back) * (1 - e2)
        e1[turns] *= e2
    found = recurrence(e1, offset, start)
    found.flags.writeable = False
    return found


@lru_cache(maxsize=16)
def _ways(velocity_mm_s: bytes, time_s: bytes) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return the way of every step, up to a reversal within it; the way back after each reversal; and in which steps.

    They do not depend on the length, of which a fit tries many.
    """
    velocity = np.frombuffer(velocity_mm_s)
    first, last = velocity[:-1], velocity[1:]
    h = np.diff(np.frombuffer(time_s))
    way = (first + last) / 2 * h
    turns = np.flatnonzero(first * last < 0)
    share = first[turns] / (first[turns] - last[turns])  # of the step, before the reversal
    way[turns] = first[turns] * share / 2 * h[turns]
    return way, last[turns] * (1 - share) / 2 * h[turns], turns
