"""Arcs of needles and the noise of trackers."""

import numpy as np

from needleplan.models import arc_step
from needleplan.signals import Array

LENGTH_MM, RADIUS_MM, SIGMA_MM, POINTS = 80.0, 1200.0, 0.1, 320


def arc(curvature_per_mm: float = 1 / RADIUS_MM, points: int = POINTS, length_mm: float = LENGTH_MM) -> Array:
    """Points along an arc that begins at the origin along +x."""
    x, y, _ = arc_step(0.0, 0.0, 0.0, curvature_per_mm, np.linspace(0, length_mm, points))
    return np.column_stack([x, y])


def white(random: np.random.Generator, points: int = POINTS) -> Array:
    return random.normal(0, SIGMA_MM, (points, 2))


def correlated(random: np.random.Generator, length_mm: float, points: int = POINTS) -> Array:
    """Noise of the same size whose correlation decays as exp(-distance / length)."""
    decay = np.exp(-LENGTH_MM / (points - 1) / length_mm)
    noise = random.normal(0, SIGMA_MM, (points, 2))
    noise[1:] *= np.sqrt(1 - decay**2)
    for row in range(1, points):
        noise[row] += decay * noise[row - 1]
    return noise


def kasa(points: Array) -> float:
    """Radius by plain algebraic least squares, which is biased: the counterexample."""
    rows = np.column_stack([points, np.ones(len(points))])
    b, c, d = np.linalg.lstsq(rows, -(points**2).sum(axis=1), rcond=None)[0]
    return float(np.sqrt(b**2 / 4 + c**2 / 4 - d))
