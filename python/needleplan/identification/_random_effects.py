"""Regression of estimates with known errors and an unknown scatter between them (random effects).

The estimates are y = X b + u + e, with u ~ N(0, t^2) and e ~ N(0, s^2). t^2 comes from moments (DerSimonian and Laird,
Controlled Clinical Trials 7 (1986) 177). The covariance of b has the factor of Knapp and Hartung (Statistics in
Medicine 22 (2003) 2693), which is at least one. The mean of several estimates is the case of one column of ones.
"""

from __future__ import annotations

import numpy as np

from needleplan.signals import Array

__all__ = ["between_variance", "weighted_fit"]


def between_variance(design: Array, found: Array, variance: Array) -> float:
    """Return t^2, 0 if the estimates agree better than by chance; design (n, k), estimates and their variances (n,)."""
    weight = np.diag(1 / variance)
    hat = weight @ design @ np.linalg.inv(design.T @ weight @ design) @ design.T @ weight
    excess = found @ (weight - hat) @ found - (len(found) - design.shape[1])
    return max(0.0, float(excess / np.trace(weight - hat)))


def weighted_fit(design: Array, found: Array, variance: Array) -> tuple[Array, Array]:
    """Return the coefficients b, shape (k,), and their covariance (k, k); `variance` is s^2 + t^2."""
    scaled, target = design / np.sqrt(variance)[:, None], found / np.sqrt(variance)
    inverse = np.linalg.inv(scaled.T @ scaled)
    values = inverse @ scaled.T @ target
    spread = float(np.sum((target - scaled @ values) ** 2)) / (len(found) - design.shape[1])
    return values, inverse * max(1.0, spread)
