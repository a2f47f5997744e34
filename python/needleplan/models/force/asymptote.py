"""Closed forms of the force-depth model once z has settled: the force far behind the peak.

z follows its equilibrium z = beta g(l) / sigma0 with the rate l sigma0 / g(l). Where that is fast beside the change of
l, the damping term is gone and, exactly in the limit,

    insertion  f -> (beta g(l) + sigma2) l,        retraction  f -> (beta g(l) - sigma2) l.
"""

from __future__ import annotations

import numpy as np

from needleplan.models.force.base import DepthForce
from needleplan.signals import Array

__all__ = ["insertion_asymptote", "retraction_asymptote", "steady_state"]


def steady_state(model: DepthForce, depth_mm: Array) -> Array:
    """Return the equilibrium of z at each depth, shape as given."""
    return np.asarray(model.beta * model.g(depth_mm) / model.sigma0)


def insertion_asymptote(model: DepthForce, depth_mm: Array) -> Array:
    """Return the force (N) of an insertion at each depth, shape as given, once z has settled."""
    return np.asarray((model.beta * model.g(depth_mm) + model.sigma2) * depth_mm)


def retraction_asymptote(model: DepthForce, depth_mm: Array) -> Array:
    """Return the force (N) of a retraction at each depth, shape as given, once z has settled."""
    return np.asarray((model.beta * model.g(depth_mm) - model.sigma2) * depth_mm)
