"""Effects on the path of a tip, as models around a model: each changes one thing of it and leaves the rest."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from needleplan.models.parameter import parameter
from needleplan.models.steered import SteeredModel
from needleplan.signals import Array, Motion

__all__ = ["Altered", "Shifted", "direction_yz"]


@dataclass(frozen=True, kw_only=True)
class Altered(SteeredModel):
    """A model around another one, from which it takes what it does not change; abstract."""

    base: SteeredModel
    size: float = parameter("", -1e9, 1e9, "how much of it", typical=1.0)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the base."""
        return self.base.bend_per_mm(motion, roll_rad)

    def entry(self, motion: Motion) -> tuple[Array, Array]:
        """Return the entry of the base."""
        return self.base.entry(motion)

    def following(self, roll_rad: Array, motion: Motion) -> Array:
        """Return the roll that the base follows."""
        return self.base.following(roll_rad, motion)

    def rolls(self, motion: Motion, start_rad: float) -> Array:
        """Return the roll in the base."""
        return self.base.rolls(motion, start_rad)

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:
        """Return what the base shows."""
        return self.base.shown(state, motion, whole)


@dataclass(frozen=True, kw_only=True)
class Shifted(Altered):
    """A model whose tip, or what is shown of it, is somewhere else; abstract."""

    @abstractmethod
    def shift(self, state: Array, motion: Motion) -> Array:
        """Return where to it is moved for size 1, shape (3, ...)."""

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:
        """Return what the base shows, moved."""
        return np.asarray(self.base.shown(state, motion, whole) + self.size * self.shift(state, motion))


def direction_yz(angle_rad: float, like: Array) -> Array:
    """Return a direction across the x axis, shape (3, ...) with the shape of `like` behind."""
    one = np.ones_like(np.asarray(like, float))
    return np.array([0 * one, np.cos(angle_rad) * one, np.sin(angle_rad) * one])
