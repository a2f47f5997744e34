"""Equations of effects, for floats and arrays: models evaluate them on whole motions, the lab twin tick by tick.

| effect | equation |
|---|---|
| curvature that depends on the speed | k (1 + size ((v / 5 mm/s)^power - 1) / power) |
| bent needle | (kn, kb) += size (cos, sin)(phi_tip + direction) |
| weight of the needle | curvature downwards: size exp(-l / fading) |
| breathing | u = size/2 (sin a - rest/2 cos(a)^2 + rest), a = 2 pi f t + phase |
"""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["USUAL_MM_S", "bent_needle", "breathing", "speed_factor", "weight_curvature"]

# Reference speed of laws of the speed, mm/s.
USUAL_MM_S = 5.0


def speed_factor(speed_mm_s: Any, size: Any, power: float = 1.0) -> Any:
    """Return the curvature at a speed (>= 0), as a multiple of the curvature at 5 mm/s.

    `size` is the relative change of the curvature per 5 mm/s of speed, at 5 mm/s. If `size` equals `power`, the factor
    is (speed / 5 mm/s)^power.
    """
    return 1 + size * ((speed_mm_s / USUAL_MM_S) ** power - 1) / power


def bent_needle(tip_rad: Any, size: Any, direction_rad: Any) -> tuple[Any, Any]:
    """Return the curvatures (1/mm) along n and b of a needle that is bent, which turn with the tip."""
    angle = tip_rad + direction_rad
    return size * np.cos(angle), size * np.sin(angle)


def weight_curvature(depth_mm: Any, size: Any, fading_mm: Any) -> Any:
    """Return the downward curvature (1/mm) that the weight of the needle causes at an inserted length."""
    return size * np.exp(-np.maximum(depth_mm, 0.0) / fading_mm)


def breathing(time_s: Any, frequency_hz: Any, phase_rad: Any, rest: Any) -> tuple[Any, Any]:
    """Return displacement (mm) and velocity (mm/s) of breathing tissue for amplitude 1; all arguments broadcast.

    The displacement from one end to the other is 1. For rest 0 it is a sine about 0. For rest 1 it is
    ((1 + sin a)/2)^2, which dwells at exhalation.
    """
    rate = 2 * np.pi * frequency_hz
    angle = rate * time_s + phase_rad
    sine, cosine = np.sin(angle), np.cos(angle)
    return (sine + rest * (1 - cosine**2 / 2)) / 2, rate / 2 * cosine * (1 + rest * sine)
