"""Dahl's bristle along a motion: what friction that knows the path only does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

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
    velocity = np.frombuffer(velocity_mm_s)
    first, last = velocity[:-1], velocity[1:]
    h = np.diff(np.frombuffer(time_s))
    turns = first * last < 0
    share = np.where(turns, first / np.where(turns, first - last, 1.0), 1.0)  # of the step, before the reversal
    way = np.where(turns, first * share / 2, (first + last) / 2) * h
    back = np.where(turns, last * (1 - share) / 2, 0.0) * h
    e1, e2 = np.exp(-np.abs(way) / length_mm), np.exp(-np.abs(back) / length_mm)
    offset = np.sign(way) * (1 - e1) * e2 + np.sign(back) * (1 - e2)
    found = recurrence(e1 * e2, offset, start)
    found.flags.writeable = False
    return found
