"""Memories of the path that terms share: which way the shaft is bent, and how deep the tip has been."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.effects.base import Term
from needleplan.models.parameter import constant
from needleplan.models.recurrence import recurrence
from needleplan.models.sliding import slid
from needleplan.signals import Array, Motion

__all__ = ["PathTerm", "decaying", "reached"]


@dataclass(frozen=True, kw_only=True)
class PathTerm(Term):
    """A term that knows z, Dahl's bristle of the shaft, and the greatest depth so far (mm); abstract."""

    order: ClassVar[int] = 2
    presliding_mm: float = constant("mm", 1e-4, 50, "travel over which the bristle turns round", default=0.05)

    def initial(self, motion: Motion) -> Array:
        """Return a straight bristle, and the first depth as the greatest."""
        return np.array([0.0, float(np.ravel(motion.depth_mm)[0])])

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates of bristle and greatest depth."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        fresh = np.asarray(motion.depth_mm) >= state[1]
        return np.array(
            [(velocity - np.abs(velocity) * state[0]) / self.presliding_mm, np.where(fresh, np.maximum(velocity, 0), 0)]
        )

    def states(self, motion: Motion, start: Array) -> Array:
        """Return both along a motion."""
        return np.array([slid(motion, self.presliding_mm, float(start[0])), reached(motion, float(start[1]))])


def reached(motion: Motion, start: float) -> Array:
    """Return the greatest depth so far, shape (samples,)."""
    return np.maximum(np.maximum.accumulate(motion.depth_mm), start)


def decaying(decay: Array, target: Array, start: float) -> Array:
    """Return y, shape (n + 1,), of y[k+1] = target[k] + (y[k] - target[k]) decay[k]."""
    return recurrence(decay, target * (1 - decay), start)
