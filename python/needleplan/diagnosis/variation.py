"""How tissue that is not the same everywhere shows in a channel: as modes, each with variance 1 at level 1.

Friction and resistance of the tip are taken as random functions of depth, each about its mean, with an exponential
correlation (Ornstein and Uhlenbeck) over `CORRELATION_MM`: rough enough for any tissue, and a few dozen modes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from needleplan.models import Model, simulate
from needleplan.signals import Array, Motion

__all__ = ["CORRELATION_MM", "at_depth", "functions_of_depth", "tissue_modes"]

CORRELATION_MM = 6.0
_GRID_MM = 0.5
_SHARE = 0.995
"""Part of the variance that the modes kept must hold."""


def tissue_modes(model: Model, motion: Motion) -> Array:
    """Return what the force gains for every mode of the tissue at level 1, shape (samples, modes).

    A model that knows the forces of shaft and tip says them (`shaft_n`, `tip_n`); for any other, all of the force is
    taken as the one and as the other.
    """
    run = simulate(model, motion)
    mean, at_tip = _along_path(np.asarray(motion.depth_mm, float).tobytes())
    shaft = model.shaft_n(run.states, motion) if hasattr(model, "shaft_n") else run.output
    tip = model.tip_n(run.states, motion) if hasattr(model, "tip_n") else run.output
    count = mean.shape[1]
    found = np.empty((len(mean), 2 * count))
    np.multiply(shaft[:, None], mean, out=found[:, :count])
    np.multiply(tip[:, None], at_tip, out=found[:, count:])
    return found


@lru_cache(maxsize=8)
def _along_path(depth_mm: bytes) -> tuple[Array, Array]:
    """Return the functions of depth along a path, as their mean along the shaft and at the tip: (samples, modes)."""
    depth = np.clip(np.frombuffer(depth_mm), 0.0, None)
    modes, places = functions_of_depth(float(np.ceil(max(depth.max(), 1.0))))
    sums = np.concatenate([np.zeros((1, modes.shape[1])), np.cumsum((modes[1:] + modes[:-1]) / 2, axis=0)]) * _GRID_MM
    return at_depth(depth, places, sums) / np.maximum(depth, _GRID_MM)[:, None], at_depth(depth, places, modes)


def at_depth(depth_mm: Array, places: Array, rows: Array) -> Array:
    """Return functions that are known at places of equal distance, (places, m), at depths, (samples, m), linearly."""
    at = (depth_mm - places[0]) / (places[1] - places[0])
    left = np.clip(at.astype(int), 0, len(places) - 2)
    share = np.clip(at - left, 0.0, 1.0)[:, None]
    return np.asarray(rows[left] * (1 - share) + rows[left + 1] * share)


@lru_cache(maxsize=8)
def functions_of_depth(deepest_mm: float) -> tuple[Array, Array]:
    """Return eigenfunctions times the roots of their eigenvalues, shape (places, modes), and the places."""
    places = np.arange(0.0, deepest_mm + _GRID_MM, _GRID_MM)
    covariance = np.exp(-np.abs(places[:, None] - places) / CORRELATION_MM)
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    count = min(int(np.searchsorted(np.cumsum(values) / values.sum(), _SHARE)) + 1, 40)
    return vectors[:, :count] * np.sqrt(values[:count]), places
