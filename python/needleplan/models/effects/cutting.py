"""Effects at the tip: what it takes to cut, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.effects.path import PathTerm
from needleplan.models.parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["CuttingLayer", "CuttingWithDepth", "FreshCutting", "Puncture"]


def _pushed(state: Array) -> Array:
    """Return how much of the cutting force the tip takes: it resists only where it is pushed in."""
    return np.asarray((1 + state[0]) / 2)


@dataclass(frozen=True, kw_only=True)
class Puncture(PathTerm):
    """A membrane bulges until it breaks: exp((L - depth)/bulge) up, then gone within a short way; on the first pass."""

    name: ClassVar[str] = "puncture"
    size: float = parameter("N", 0, 20, "force at which the membrane breaks", typical=0.1)
    depth_mm: float = parameter("mm", 0, 500, "where it breaks", typical=1.0)
    bulge_mm: float = parameter("mm", 0.1, 30, "how far it is pushed in before it breaks; force grows by e per bulge")
    release_mm: float = constant("mm", 1e-3, 10, "way over which the force is gone once it broke", default=0.3)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return exp((L - depth)/bulge) until the membrane breaks, and what is left of it then."""
        before = np.exp(np.minimum((np.asarray(motion.depth_mm) - self.depth_mm) / self.bulge_mm, 0.0))
        broken = np.exp(-np.maximum(state[1] - self.depth_mm, 0.0) / self.release_mm)
        return np.asarray(before * broken * _pushed(state))


@dataclass(frozen=True, kw_only=True)
class CuttingLayer(PathTerm):
    """Another layer takes more, or less, to cut."""

    name: ClassVar[str] = "cutting_layer"
    size: float = parameter("N", -20, 20, "cutting force in the layer, above that before it", typical=0.1)
    depth_mm: float = parameter("mm", 0, 500, "where the layer begins", typical=1.0)
    width_mm: float = parameter("mm", 0.05, 20, "over which one layer goes over into the other")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return a smooth step in depth."""
        step = 0.5 * (1 + np.tanh((np.asarray(motion.depth_mm) - self.depth_mm) / self.width_mm))
        return np.asarray(step * _pushed(state))


@dataclass(frozen=True, kw_only=True)
class FreshCutting(PathTerm):
    """What was cut once is not cut again: the tip meets less where it has been before.

    A share of what the model has for cutting, which differs from trial to trial and comes up with the depth.
    """

    name: ClassVar[str] = "fresh_cutting"
    size: float = parameter("", 0, 1.5, "share of the cutting that is missing in tissue that is cut", typical=0.2)
    margin_mm: float = parameter("mm", 0.01, 10, "how near to the end of the old path the tip cuts in full again")
    cutting: float = constant("N", 0, 100, "cutting force of the model", default=1.0)
    onset_mm: float = constant("mm", 1e-2, 50, "depth over which it comes up in the model", default=1e-2)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return minus the cutting of a tip that is in its old path."""
        depth = np.asarray(motion.depth_mm)
        full = -self.cutting * np.expm1(-np.maximum(depth, 0.0) / self.onset_mm)
        behind = np.maximum(state[1] - depth, 0.0)
        return np.asarray(full * np.expm1(-behind / self.margin_mm) * _pushed(state))


@dataclass(frozen=True, kw_only=True)
class CuttingWithDepth(PathTerm):
    """Cutting takes more the deeper the tip is."""

    name: ClassVar[str] = "cutting_with_depth"
    size: float = parameter("N/mm", -1, 1, "growth of the cutting force with depth", typical=1e-3)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the depth while the tip is pushed in."""
        return np.asarray(np.maximum(motion.depth_mm, 0.0) * _pushed(state))
