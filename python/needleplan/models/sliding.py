"""Dahl's bristle along a motion: what friction that knows the path only does."""

from __future__ import annotations

import numpy as np

from needleplan.models.recurrence import recurrence
from needleplan.signals import Array, Motion

__all__ = ["slid"]


def slid(motion: Motion, length_mm: float, start: float = 0.0) -> Array:
    """Return z of z' = (v - |v| z)/length along a motion, shape (samples,); `start` is z at the first sample.

    Exact for a velocity that is linear between samples, a reversal within a step too: on either side of it z goes
    exponentially with the way to the sign of the velocity.
    """
    first, last = motion.velocity_mm_s[:-1], motion.velocity_mm_s[1:]
    h = motion.interval_s
    turns = first * last < 0
    share = np.where(turns, first / np.where(turns, first - last, 1.0), 1.0)  # of the step, before the reversal
    way = np.where(turns, first * share / 2, (first + last) / 2) * h
    back = np.where(turns, last * (1 - share) / 2, 0.0) * h
    e1, e2 = np.exp(-np.abs(way) / length_mm), np.exp(-np.abs(back) / length_mm)
    offset = np.sign(way) * (1 - e1) * e2 + np.sign(back) * (1 - e2)
    return recurrence(e1 * e2, offset, start)
