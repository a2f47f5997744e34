"""Random numbers: one stream a cause, so that one noise does not change another."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

__all__ = ["Draws", "Stream", "random_for"]


class Stream(IntEnum):
    """What random numbers are for. The numbers are part of what a seed means: never change one."""

    CURVATURE = 1
    HEADING = 2
    RESPIRATION = 3
    FORCE_NOISE = 4
    TRACKER_NOISE = 5
    TRACKER_WANDER = 6
    TRACKER_ANGLE = 7
    TRACKER_DROPOUT = 8
    TRACKER_FIELD = 9


def random_for(seed: int, stream: Stream) -> np.random.Generator:
    """Return the generator of a stream for a seed (0 or above)."""
    return np.random.default_rng([seed, int(stream)])


class Draws:
    """Standard normal numbers one row at a time, drawn many at once."""

    def __init__(self, random: np.random.Generator, width: int) -> None:
        self._random, self._width = random, width
        self._rows: list[list[float]] = []

    def next(self) -> list[float]:
        """Return the next row."""
        if not self._rows:
            self._rows = self._random.standard_normal((256, self._width))[::-1].tolist()
        return self._rows.pop()
