"""The bicycle model in space: a bevel tip bends in the direction in which its bevel looks.

The frame of the tip is its tangent t and two directions n and b across it that do not turn about t on their own
(Bishop's frame), so that the roll of the needle is counted from n. With the curvature (kn, kb) = k (cos phi, sin phi)::

    p' = t,    t' = kn n + kb b,    n' = -kn t,    b' = -kb t

per length of the path. For phi = 0 and pi this is `arc_step` in the plane of t and n (Webster et al., Int. J. Robotics
Research 25 (2006) 509).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["TipFrame", "Vector"]

Vector = tuple[float, float, float]

_STRAIGHT_PER_MM = 1e-18
"""Below that no length turns a heading, and quotients of such numbers are no directions."""


@dataclass(frozen=True, slots=True)
class TipFrame:
    """A place on a path: position (mm), tangent, and the directions n and b across it; right-handed, orthonormal."""

    position_mm: Vector
    tangent: Vector
    normal: Vector
    binormal: Vector

    @classmethod
    def planar(cls, x_mm: float, y_mm: float, heading_rad: float) -> TipFrame:
        """Return a frame in the plane z = 0; n points to the left of the path, b along +z."""
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return cls((x_mm, y_mm, 0.0), (cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0))

    def arc(self, along_n_per_mm: float, along_b_per_mm: float, length_mm: float) -> TipFrame:
        """Return the frame after an arc of constant curvature; for any length and curvature, zero as well."""
        bend = math.hypot(along_n_per_mm, along_b_per_mm)
        if bend < _STRAIGHT_PER_MM:
            return TipFrame(_added(self.position_mm, length_mm, self.tangent), self.tangent, self.normal, self.binormal)
        cn, cb = along_n_per_mm / bend, along_b_per_mm / bend
        (tx, ty, tz), (nx, ny, nz), (bx, by, bz) = self.tangent, self.normal, self.binormal
        # d is where it bends to, e the axis about which it turns: that one stays.
        dx, dy, dz = cn * nx + cb * bx, cn * ny + cb * by, cn * nz + cb * bz
        ex, ey, ez = cn * bx - cb * nx, cn * by - cb * ny, cn * bz - cb * nz
        turn = bend * length_mm
        half = turn / 2
        chord = length_mm * (math.sin(half) / half if abs(half) > 1e-8 else 1.0)
        forward, aside = chord * math.cos(half), chord * math.sin(half)
        cos, sin = math.cos(turn), math.sin(turn)
        px, py, pz = self.position_mm
        gx, gy, gz = cos * dx - sin * tx, cos * dy - sin * ty, cos * dz - sin * tz
        return TipFrame(
            (px + forward * tx + aside * dx, py + forward * ty + aside * dy, pz + forward * tz + aside * dz),
            (cos * tx + sin * dx, cos * ty + sin * dy, cos * tz + sin * dz),
            (cn * gx - cb * ex, cn * gy - cb * ey, cn * gz - cb * ez),
            (cb * gx + cn * ex, cb * gy + cn * ey, cb * gz + cn * ez),
        )

    def moved(self, shift_mm: Vector) -> TipFrame:
        """Return the frame shifted."""
        return TipFrame(_added(self.position_mm, 1.0, shift_mm), self.tangent, self.normal, self.binormal)


def _added(start: Vector, length: float, direction: Vector) -> Vector:
    return (start[0] + length * direction[0], start[1] + length * direction[1], start[2] + length * direction[2])
