"""Series of insertions through one guide, steady or drifting, with the true tips.

Written without reading the law that judges them: the scatter is drawn from a log-normal distribution, a drift is a
slope, a step or a walk of the direction of entry, the curvature fades with depth, the heading wanders on the way, and
the tracker has white noise and a slow error. The needle is integrated in steps of half a millimetre.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

__all__ = ["Drift", "Insertion", "Series", "drawn"]

Floats = NDArray[np.float64]

STEP_MM, LENGTH_MM = 0.5, 100.0
ALONG = np.arange(0.0, LENGTH_MM + STEP_MM / 2, STEP_MM)
# Samples of the tracker along a path.
SAMPLES = 120


class Drift(StrEnum):
    """What becomes of the direction of entry from insertion to insertion."""

    STEADY = "steady"
    SLOPE = "slope"
    STEP = "step"
    WALK = "walk"


@dataclass(frozen=True)
class Insertion:
    """One insertion: measured depth and positions (mm), shape (samples,), and the true y and z of its end."""

    depth_mm: Floats
    y_mm: Floats
    z_mm: Floats
    tip_mm: Floats


@dataclass(frozen=True)
class Series:
    """Insertions in their order.

    `scatter_mm` is the standard deviation of the true tips in each plane about the drift `drift_mm`, shape
    (insertions, 2).
    """

    insertions: tuple[Insertion, ...]
    scatter_mm: float
    drift_mm: Floats

    @property
    def tips_mm(self) -> Floats:
        """True tips, shape (insertions, 2)."""
        return np.array([each.tip_mm for each in self.insertions])


def drawn(
    random: np.random.Generator, drift: Drift, count: int, *, typical_mm: float = 0.5, spread: float = 0.4,
    noise_mm: float = 0.1, wander_rad: float = 1e-3,
) -> Series:  # fmt: skip
    """Draw a series.

    The scatter of the tips is `typical_mm` times a log-normal factor with the deviation `spread`. `noise_mm` is the
    white noise of the tracker, and `wander_rad` the random walk of the heading in 1 mm.
    """
    scatter = typical_mm * float(np.exp(spread * random.standard_normal()))
    # The wander scatters the tips too; what is left is the scatter of the directions of entry.
    wandered = wander_rad * LENGTH_MM**1.5 / np.sqrt(3)
    scatter = max(scatter, 1.1 * wandered)
    entry = np.sqrt(scatter**2 - wandered**2) / LENGTH_MM
    moved = _moved(random, drift, count, scatter)
    mean = np.array([0.03, 0.0]) + 0.01 * random.standard_normal(2)
    bend = np.array([random.uniform(5e-4, 1.5e-3), random.uniform(-1e-4, 1e-4)])
    fading = np.exp(-ALONG / random.uniform(60.0, 200.0))
    found = []
    for number in range(count):
        heading = mean + moved[number] / LENGTH_MM + entry * random.standard_normal(2)
        turns = np.outer(fading, bend) * STEP_MM
        turns += wander_rad * np.sqrt(STEP_MM) * random.standard_normal(turns.shape)
        headings = heading + np.concatenate([np.zeros((1, 2)), np.cumsum(turns[:-1], axis=0)])
        places = np.concatenate([np.zeros((1, 2)), np.cumsum(headings[:-1] * STEP_MM, axis=0)])
        depth = np.linspace(4.0, LENGTH_MM, SAMPLES)
        slow = 0.5 * noise_mm * np.outer(np.sin(depth / 17.0 + random.uniform(0, 2 * np.pi)), random.standard_normal(2))
        seen = np.stack([np.interp(depth, ALONG, places[:, plane]) for plane in (0, 1)], axis=1) + slow
        seen += noise_mm * random.standard_normal(seen.shape)
        found.append(Insertion(depth, seen[:, 0], seen[:, 1], places[-1]))
    return Series(tuple(found), scatter, moved)


def _moved(random: np.random.Generator, drift: Drift, count: int, scatter_mm: float) -> Floats:
    """Return the drift of the tips (mm), shape (count, 2), in a random direction; a walk drifts in both planes."""
    number = np.arange(count)
    angle = random.uniform(0, 2 * np.pi)
    way = np.array([np.cos(angle), np.sin(angle)])
    if drift is Drift.SLOPE:
        return np.outer(random.uniform(0.5, 2.0) * scatter_mm * number, way)
    if drift is Drift.STEP:
        return np.outer(random.uniform(3.0, 8.0) * scatter_mm * (number >= random.integers(1, max(count - 1, 2))), way)
    if drift is Drift.WALK:
        size = random.uniform(0.5, 2.0) * scatter_mm
        return np.cumsum(size * random.standard_normal((count, 2)) * (number > 0)[:, None], axis=0)
    return np.zeros((count, 2))
