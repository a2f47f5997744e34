"""Smooth functions."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from needleplan.signals import Array

__all__ = ["splines"]


def splines(values: Array, low: float, high: float, count: int) -> Array:
    """Return cubic B-splines on equal intervals, shape (samples, count)."""
    inner = np.linspace(low, high, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(values, low, high * (1 - 1e-12)), knots, 3).toarray())
