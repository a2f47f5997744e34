"""How the normal force is spread along the inserted shaft.

fn(zeta) is the normal force per length at the distance zeta from the entry, for an inserted length L (thesis, (3.15)).
With a plateau f and ramps of the length w::

    right trapezoid          zeta/w on the first w, then 1                                  Fn = f (L - w/2)
    isosceles trapezoid      zeta/w on the first w, then 1, (L - zeta)/w on the last w      Fn = f (L - w)

Short lengths are triangles: up to zeta = L for L <= w, Fn = f L^2/(2w); up to L/2 and down again for L <= 2w,
Fn = f L^2/(4w). The thesis keeps f (L - w) for any length in (3.19), which is negative for L < w.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from needleplan.signals import Array

__all__ = ["Profile", "intensity", "normal_length_mm"]


class Profile(StrEnum):
    """Which function fn(zeta) is."""

    CONSTANT = "constant"
    """Total normal force Fn whatever the length: the thesis, which sets Fn = 1 N for Models I and II."""

    UNIFORM = "uniform"
    """fn = f: the force grows in proportion to the inserted length."""

    RIGHT = "right"
    """Right trapezoid: Model III-A."""

    ISOSCELES = "isosceles"
    """Isosceles trapezoid: Model III-B."""


def normal_length_mm(profile: Profile, length_mm: Array, ramp_mm: float) -> Array:
    """Return Fn/f (mm) for inserted lengths, any shape; for the constant profile 1, as that has no f."""
    length = np.asarray(length_mm, float)
    if profile is Profile.CONSTANT:
        return np.ones_like(length)
    if profile is Profile.UNIFORM:
        return length
    if profile is Profile.RIGHT:
        return np.where(length <= ramp_mm, length**2 / (2 * ramp_mm), length - ramp_mm / 2)
    return np.where(length <= 2 * ramp_mm, length**2 / (4 * ramp_mm), length - ramp_mm)


def intensity(profile: Profile, position_mm: Array, length_mm: Array | float, ramp_mm: float) -> Array:
    """Return fn/f at positions from the entry; zero outside of (0, length). The shapes broadcast.

    The constant profile is taken as a uniform one: it says nothing about how its force is spread.
    """
    position, length = np.broadcast_arrays(np.asarray(position_mm, float), np.asarray(length_mm, float))
    inside = (position >= 0) & (position <= length)
    rising = np.minimum(position / ramp_mm, 1.0)
    if profile is Profile.RIGHT:
        return np.where(inside, rising, 0.0)
    if profile is Profile.ISOSCELES:
        return np.where(inside, np.minimum(rising, (length - position) / ramp_mm), 0.0)
    return np.where(inside, 1.0, 0.0)
