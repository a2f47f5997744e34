"""Programs of moves for a stage: insert, rotate, dwell, within the limits of machine and tissue."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals._profiles import lspb
from needleplan.signals._record import Array, Motion

__all__ = ["LEAST_ROOM_MM", "Dwell", "Insert", "Limits", "Program", "Rotate"]

LEAST_ROOM_MM = 5.0
"""Least permitted distance (mm) between the shallowest and the deepest position."""


@dataclass(frozen=True)
class Limits(CallRepr):
    """Limits of the machine and the tissue.

    Raises DataError if a speed or an acceleration is not positive, or if the depths leave no room to move.
    """

    deepest_mm: float
    fastest_mm_s: float = 15.0
    shallowest_mm: float = -2.0
    """Depth (mm) at which a motion starts; negative depths are in the air, where the zero of the sensor is recorded."""

    acceleration_mm_s2: float = 100.0
    velocity_rad_s: float = 6.0
    acceleration_rad_s2: float = 60.0

    def __post_init__(self) -> None:
        mistakes = [
            Mistake(name, f"{getattr(self, name):g}", "must be a positive number")
            for name in ("fastest_mm_s", "acceleration_mm_s2", "velocity_rad_s", "acceleration_rad_s2")
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0)
        ]
        ends = (self.shallowest_mm, self.deepest_mm)
        if not all(map(math.isfinite, ends)) or self.deepest_mm < self.shallowest_mm + LEAST_ROOM_MM:
            rule = f"must be at least {LEAST_ROOM_MM:g} mm below shallowest_mm: there is no room to move"
            mistakes.append(Mistake("deepest_mm", f"{self.deepest_mm:g}", rule))
        if mistakes:
            raise DataError(mistakes, "limits")


@dataclass(frozen=True)
class Insert:
    """Insert or retract the needle to a depth."""

    to_mm: float
    velocity_mm_s: float


@dataclass(frozen=True)
class Rotate:
    """Rotate the base to an angle."""

    to_rad: float
    velocity_rad_s: float


@dataclass(frozen=True)
class Dwell:
    """Keep the needle at rest for some seconds."""

    seconds: float


@dataclass(frozen=True)
class Program(CallRepr):
    """A sequence of moves that starts at the shallowest position; each move starts and ends at rest."""

    name: str
    about: str
    moves: tuple[Insert | Rotate | Dwell, ...]
    limits: Limits

    def motion(self, rate_hz: float) -> Motion:
        """Return the motion with trapezoidal velocities, sampled at `rate_hz`."""
        depth, angle = self.limits.shallowest_mm, 0.0
        depths, velocities, angles = [np.array([depth])], [np.zeros(1)], [np.zeros(1)]
        for move in self.moves:
            if isinstance(move, Dwell):
                count = max(round(move.seconds * rate_hz), 1)
                parts = np.full(count, depth), np.zeros(count), np.full(count, angle)
            elif isinstance(move, Insert):
                blend_s = move.velocity_mm_s / self.limits.acceleration_mm_s2
                run = lspb([depth, move.to_mm], [move.velocity_mm_s], blend_s=blend_s, rate_hz=rate_hz)[1:]
                parts = run.depth_mm, run.velocity_mm_s, np.full(len(run), angle)
                depth = move.to_mm
            else:
                blend_s = move.velocity_rad_s / self.limits.acceleration_rad_s2
                turn = lspb([angle, move.to_rad], [move.velocity_rad_s], blend_s=blend_s, rate_hz=rate_hz)[1:]
                parts = np.full(len(turn), depth), np.zeros(len(turn)), turn.depth_mm
                angle = move.to_rad
            for kept, part in zip((depths, velocities, angles), parts, strict=True):
                kept.append(part)
        depth_mm: Array = np.concatenate(depths)
        time_s = np.arange(len(depth_mm)) / rate_hz
        return Motion.sampled(time_s, depth_mm, np.concatenate(velocities), np.concatenate(angles))
