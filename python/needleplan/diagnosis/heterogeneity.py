"""Heterogeneous tissue: random functions of depth with an exponential correlation (Ornstein-Uhlenbeck).

The functions are expanded in their eigenfunctions, the modes of the heterogeneity.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from needleplan.signals import Array

__all__ = ["GRID_MM", "HETEROGENEITY_SDS", "LARGEST_HETEROGENEITY", "at_depth", "functions_of_depth"]

# Correlation length (mm) of the tissue's heterogeneity along the path.
_CORRELATION_MM = 6.0
# Spacing (mm) of the depth grid of heterogeneity modes.
GRID_MM = 0.5
# Share of the variance that the retained heterogeneity modes hold at least.
_VARIANCE_SHARE = 0.995
# Heterogeneity standard deviations that are summed over, relative to the mean of the tissue's property.
HETEROGENEITY_SDS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
# Remark of a diagnosis whose heterogeneity is the last of these.
LARGEST_HETEROGENEITY = f"the heterogeneity is at its limit, {HETEROGENEITY_SDS[-1]:.0%}: model or noise is far off"


def at_depth(depth_mm: Array, places: Array, rows: Array) -> Array:
    """Interpolate `rows`, functions on the uniform grid `places`, linearly at depths, clipped; shape (samples, m)."""
    at = (depth_mm - places[0]) / (places[1] - places[0])
    left = np.clip(at.astype(int), 0, len(places) - 2)
    share = np.clip(at - left, 0.0, 1.0)[:, None]
    return np.asarray(rows[left] * (1 - share) + rows[left + 1] * share)


@lru_cache(maxsize=8)
def functions_of_depth(deepest_mm: float) -> tuple[Array, Array]:
    """Return scaled eigenfunctions of the heterogeneity, shape (places, modes), and their depths `places` (mm)."""
    places = np.arange(0.0, deepest_mm + GRID_MM, GRID_MM)
    covariance = np.exp(-np.abs(places[:, None] - places) / _CORRELATION_MM)
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    count = min(int(np.searchsorted(np.cumsum(values) / values.sum(), _VARIANCE_SHARE)) + 1, 40)
    return vectors[:, :count] * np.sqrt(values[:count]), places
