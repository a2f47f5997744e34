"""What the loop needs to know of the tip, and a filter that tells it.

State: x, y, heading of the tip and the curvature of its path; between frames of the tracker it follows the arc that the
stage's depth and the roll of the tip say. The coil sits behind the tip: what the tracker should see is found by going
back along the path as it was inserted, straight before the entry.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from needleplan.signals import Array

__all__ = ["ArcFilter", "TipEstimate", "TipEstimator", "Uncertainty"]

_STEP_MM = 0.05
"""Shorter insertions are gathered before the state follows them."""

_KEPT_MM = 5.0


@dataclass(frozen=True)
class TipEstimate:
    """The tip in the plane of the plan: mm and rad; `curvature_per_mm` is the size of the bevel's curvature.

    Standard deviations follow the values; `out_of_plane_mm` is the distance from the plane, up positive.
    """

    x_mm: float
    y_mm: float
    heading_rad: float
    out_of_plane_mm: float
    curvature_per_mm: float
    position_sd_mm: float
    heading_sd_rad: float
    curvature_sd_per_mm: float
    frames: int
    """Frames of the tracker that are in it."""


class TipEstimator(Protocol):
    """Estimates the tip from what stage and tracker say, both in the plan's frame."""

    def moved(self, path_mm: float, tip_roll_rad: float) -> None:
        """Take note of the inserted length, beyond the entry, and of the roll of the tip (0 bends left)."""

    def seen(self, position_mm: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        """Take note of where the coil is and of the direction of the needle there, towards the tip."""

    @property
    def estimate(self) -> TipEstimate:
        """The tip now."""


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations that the filter takes for granted."""

    position_mm: float = 0.1
    """Of a frame of the tracker, along each axis."""

    direction_rad: float = 0.02
    heading_rad_sqrt_mm: float = 0.002
    """How the heading wanders from the arc, after 1 mm; grows as a root."""

    curvature_share: float = 0.2
    """Of the plan's curvature, before anything was seen."""

    curvature_share_sqrt_mm: float = 0.01
    """How the curvature changes along the path, after 1 mm, as a share of the plan's."""


class ArcFilter:
    """An extended Kalman filter along the arc; starts at a pose that is roughly known."""

    def __init__(
        self, x_mm: float, y_mm: float, heading_rad: float, curvature_per_mm: float, coil_offset_mm: float,
        uncertainty: Uncertainty | None = None, path_mm: float = 0.0,
    ) -> None:  # fmt: skip
        its = self._its = uncertainty or Uncertainty()
        self._coil_mm = coil_offset_mm
        self._planned = curvature_per_mm
        self._state = np.array([x_mm, y_mm, heading_rad, curvature_per_mm])
        self._cov = np.diag([5.0**2, 5.0**2, 0.1**2, (its.curvature_share * curvature_per_mm) ** 2])
        self._path_mm = path_mm
        self._now_mm, self._bend = path_mm, 0.0
        self._pieces: deque[tuple[float, float]] = deque()
        self._z_mm, self._frames = 0.0, 0

    def moved(self, path_mm: float, tip_roll_rad: float) -> None:
        """Take note of the inserted length and of the roll of the tip."""
        bend = math.cos(tip_roll_rad)
        if abs(path_mm - self._path_mm) >= _STEP_MM or bend != self._bend:
            self._follow()
        self._now_mm, self._bend = path_mm, bend

    def seen(self, position_mm: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        """Take note of a frame of the tracker."""
        self._follow()
        its = self._its
        seen = self._coil(self._state)
        jacobian = np.empty((3, 4))
        for column, size in enumerate((1e-4, 1e-4, 1e-6, 1e-8)):
            other = self._state.copy()
            other[column] += size
            jacobian[:, column] = (self._coil(other) - seen) / size
        heading = math.atan2(direction[1], direction[0])
        off = np.array([position_mm[0], position_mm[1], heading]) - seen
        off[2] = math.remainder(off[2], 2 * math.pi)
        noise = np.diag([its.position_mm**2, its.position_mm**2, its.direction_rad**2])
        gain = self._cov @ jacobian.T @ np.linalg.inv(jacobian @ self._cov @ jacobian.T + noise)
        self._state = self._state + gain @ off
        rest = np.eye(4) - gain @ jacobian
        self._cov = rest @ self._cov @ rest.T + gain @ noise @ gain.T
        self._frames += 1
        self._z_mm += (position_mm[2] + self._coil_mm * direction[2] - self._z_mm) / min(self._frames, 10)

    @property
    def estimate(self) -> TipEstimate:
        """The tip now."""
        self._follow()
        x, y, heading, curvature = self._state.tolist()
        sd = np.sqrt(np.diag(self._cov)).tolist()
        return TipEstimate(
            x, y, heading, self._z_mm, abs(curvature), math.hypot(sd[0], sd[1]), sd[2], sd[3], self._frames
        )

    def _follow(self) -> None:
        """Let the state follow the arc to where the stage is."""
        length = self._now_mm - self._path_mm
        if length == 0:
            return
        bend = self._bend if self._now_mm > 0 else 0.0
        self._remember(length, bend)
        x, y, heading, curvature = self._state.tolist()
        self._state[:3] = _arc(x, y, heading, curvature * bend, length)
        middle = heading + curvature * bend * length / 2
        along = np.eye(4)
        along[0, 2], along[1, 2] = -length * math.sin(middle), length * math.cos(middle)
        along[2, 3] = bend * length
        along[0, 3], along[1, 3] = along[0, 2] * bend * length / 2, along[1, 2] * bend * length / 2
        its, size = self._its, abs(length)
        self._cov = along @ self._cov @ along.T
        self._cov[2, 2] += its.heading_rad_sqrt_mm**2 * size
        self._cov[3, 3] += (its.curvature_share_sqrt_mm * self._planned) ** 2 * size
        self._path_mm = self._now_mm

    def _remember(self, length: float, bend: float) -> None:
        pieces = self._pieces
        while length < 0 and pieces:
            kept, its = pieces.pop()
            if kept + length > 0:
                pieces.append((kept + length, its))
                return
            length += kept
        if length <= 0:
            return
        if pieces and pieces[-1][1] == bend and pieces[-1][0] < _KEPT_MM:
            length += pieces.pop()[0]
        pieces.append((length, bend))
        while len(pieces) > 1 and sum(each for each, _ in pieces) - pieces[0][0] > self._coil_mm:
            pieces.popleft()

    def _coil(self, state: Array) -> Array:
        x, y, heading, curvature = state.tolist()
        left = self._coil_mm
        for length, bend in reversed(self._pieces):
            part = min(length, left)
            x, y, heading = _arc(x, y, heading, curvature * bend, -part)
            left -= part
            if left <= 0:
                break
        return np.array([x - left * math.cos(heading), y - left * math.sin(heading), heading])


def _arc(x: float, y: float, heading: float, curvature: float, length: float) -> tuple[float, float, float]:
    """Return what `arc_step` does, for numbers alone."""
    half = curvature * length / 2
    chord = length * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + 2 * half
