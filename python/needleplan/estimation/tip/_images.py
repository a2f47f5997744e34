"""Positions of the tip in ultrasound images, kept by their places along the path.

The path is Markov in its length. Poses of the coil and images of the tip are therefore used in the order of their
places on the path: an image ahead of the coil corrects the predicted path there, equation (3) of
docs/explanation/tip-fibre.md, and corrects the state for good when the coil has passed the place.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from needleplan import _ppvi
from needleplan.estimation.tip._estimate import TipSettings
from needleplan.models.path import ImagePlane
from needleplan.signals import Array

__all__ = ["ImageFixes"]

# Length of path (mm) over which detections count as one position: on a radius of 40 mm their mean is 0.03 mm off.
_MERGED_MM = 5.0


@dataclass
class _Fix:
    """Mean of detections: path length (mm), coordinates in the image (mm), and their number."""

    length_mm: float
    place_mm: Array
    count: int = 1


class ImageFixes:
    """Detected positions of the tip along the path.

    Parameters
    ----------
    plane
        Image plane in the frame of the plan.
    settings
        Standard deviation of a position, and significance level of outliers.
    """

    def __init__(self, plane: ImagePlane, settings: TipSettings) -> None:
        self._axes, self._origin = plane.axes[:2], plane.axes[:2] @ np.array(plane.origin_mm)
        self._model: list[list[float]] = self._axes.T.tolist()
        self._variance = settings.image_sd_mm**2
        self._gate = float(chdtri(2, settings.gate))
        self._fixes: list[_Fix] = []

    def following(self, length_mm: float) -> float:
        """Return the path length of the first position beyond a path length; infinite if there is none."""
        number = bisect_right(self._fixes, length_mm, key=lambda fix: fix.length_mm)
        return self._fixes[number].length_mm if number < len(self._fixes) else np.inf

    def agrees(self, place_mm: Array, state: Array, covariance: Array) -> bool:
        """Return whether a detected position, shape (2,), agrees with the predicted state."""
        return self._update(place_mm, state, covariance)[0] <= self._gate

    def add(self, length_mm: float, place_mm: Array, beyond_mm: float) -> None:
        """Keep a position at a path length. A near position ahead of the coil is merged with it."""
        number = bisect_right(self._fixes, length_mm, key=lambda fix: fix.length_mm)
        near = self._fixes[number - 1] if number else None
        if near is None or near.length_mm <= beyond_mm or length_mm - near.length_mm > _MERGED_MM / 2:
            self._fixes.insert(number, _Fix(length_mm, place_mm))
            return
        near.count += 1
        near.length_mm += (length_mm - near.length_mm) / near.count
        near.place_mm = near.place_mm + (place_mm - near.place_mm) / near.count

    def forget_beyond(self, length_mm: float) -> None:
        """Discard positions beyond a path length, at which the tip has left its channel for a new one."""
        del self._fixes[bisect_right(self._fixes, length_mm, key=lambda fix: fix.length_mm) :]

    def corrected(self, length_mm: float, state: Array, covariance: Array) -> tuple[Array, Array]:
        """Return state and covariance at a path length, corrected by the position there, if there is one."""
        number = bisect_right(self._fixes, length_mm, key=lambda fix: fix.length_mm) - 1
        if number < 0 or self._fixes[number].length_mm < length_mm:
            return state, covariance
        return self.used(self._fixes[number].place_mm, state, covariance, self._fixes[number].count)

    def used(self, place_mm: Array, state: Array, covariance: Array, count: int = 1) -> tuple[Array, Array]:
        """Return state and covariance, corrected by the mean of `count` detected positions."""
        return self._update(place_mm, state, covariance, count)[1]

    def _update(
        self, place_mm: Array, state: Array, covariance: Array, count: int = 1
    ) -> tuple[float, tuple[Array, Array]]:
        """Return the normalised squared innovation, and state and covariance after the measurement."""
        innovation = place_mm + self._origin - self._axes @ state[:3]
        return _ppvi.path_corrected(
            state, covariance, (0, 1, 2), self._model, innovation, variance=self._variance / count, gate=np.inf
        )
