"""Rotation-minimising frames along the path of a tip in 3D.

The frame of the tip consists of the tangent t and two normals n and b that do not rotate about t (Bishop's frame). The
roll of the needle is counted from n. With the curvature (kn, kb) = k (cos phi, sin phi), per length of the path::

    p' = t,    t' = kn n + kb b,    n' = -kn t,    b' = -kb t

For phi = 0 and pi the path is `arc_step` in the plane of t and n (Webster et al., Int. J. Robotics Research 25 (2006)
509). `TipFrame` takes single arcs. `quaternions_along` rotates a frame through many arcs at once; quaternions are (w,
x, y, z) along a leading axis of length four.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.signals import Array

__all__ = ["TipFrame", "Vector", "axes_of", "quaternion_of", "quaternions_along"]

Vector = tuple[float, float, float]

# Curvature below which an arc counts as straight, 1/mm; division by smaller numbers is inaccurate.
_STRAIGHT_PER_MM = 1e-18


@dataclass(frozen=True, slots=True)
class TipFrame(CallRepr):
    """Position and orientation of the tip in 3D.

    Parameters
    ----------
    position_mm : tuple of float
        Position x, y, z.
    tangent, normal, binormal : tuple of float
        Right-handed orthonormal axes t, n and b.

    Examples
    --------
    >>> import math
    >>> from needleplan.models import TipFrame
    >>> quarter = TipFrame.planar(0.0, 0.0, 0.0).arc(0.1, 0.0, 5 * math.pi)
    >>> [round(value, 6) for value in quarter.position_mm]
    [10.0, 10.0, 0.0]
    """

    position_mm: Vector
    tangent: Vector
    normal: Vector
    binormal: Vector

    @classmethod
    def planar(cls, x_mm: float, y_mm: float, heading_rad: float) -> TipFrame:
        """Return a frame in the plane z = 0, with n to the left of the path and b along +z.

        Parameters
        ----------
        x_mm, y_mm, heading_rad : float
            Pose in the plane.

        Returns
        -------
        TipFrame
            The frame.
        """
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return cls((x_mm, y_mm, 0.0), (cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0))

    def arc(self, along_n_per_mm: float, along_b_per_mm: float, length_mm: float) -> TipFrame:
        """Return the frame after an arc of constant curvature.

        Parameters
        ----------
        along_n_per_mm, along_b_per_mm : float
            Components of the curvature along n and b; both may be zero.
        length_mm : float
            Length of the arc.

        Returns
        -------
        TipFrame
            The frame at the end of the arc.
        """
        bend = math.hypot(along_n_per_mm, along_b_per_mm)
        if bend < _STRAIGHT_PER_MM:
            return TipFrame(_added(self.position_mm, length_mm, self.tangent), self.tangent, self.normal, self.binormal)
        cn, cb = along_n_per_mm / bend, along_b_per_mm / bend
        (tx, ty, tz), (nx, ny, nz), (bx, by, bz) = self.tangent, self.normal, self.binormal
        # d is the direction of the bending, e the axis of the rotation, which does not change.
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

    def raised(self, elevation_rad: float) -> TipFrame:
        """Return the frame turned about n, so that the tangent rises toward b.

        Parameters
        ----------
        elevation_rad : float
            Angle of the turn.

        Returns
        -------
        TipFrame
            The turned frame, at the same position.
        """
        cos, sin = math.cos(elevation_rad), math.sin(elevation_rad)
        (tx, ty, tz), (bx, by, bz) = self.tangent, self.binormal
        return TipFrame(
            self.position_mm, (cos * tx + sin * bx, cos * ty + sin * by, cos * tz + sin * bz), self.normal,
            (cos * bx - sin * tx, cos * by - sin * ty, cos * bz - sin * tz),
        )  # fmt: skip

    def moved(self, shift_mm: Vector) -> TipFrame:
        """Return the frame shifted by a vector.

        Parameters
        ----------
        shift_mm : tuple of float
            The shift.

        Returns
        -------
        TipFrame
            The shifted frame.
        """
        return TipFrame(_added(self.position_mm, 1.0, shift_mm), self.tangent, self.normal, self.binormal)


def _added(start: Vector, length: float, direction: Vector) -> Vector:
    return (start[0] + length * direction[0], start[1] + length * direction[1], start[2] + length * direction[2])


def quaternions_along(turns_rad: Array, start: Array) -> Array:
    """Return the orientation after each of n rotations, shape (4, n + 1).

    `turns_rad`, shape (3, n), are rotation vectors in the moving frame; `start`, shape (4,), is the first orientation.
    The products are computed by a parallel prefix in log2(n) passes.
    """
    angle = np.sqrt((turns_rad**2).sum(axis=0))
    share = np.sinc(angle / (2 * np.pi)) / 2
    # w + x i + y j + z k = a + b j with a = w + x i and b = y + z i: products of complex numbers need fewer operations.
    a = np.append(start[0] + 1j * start[1], np.cos(angle / 2) + 1j * (share * turns_rad[0]))
    b = np.append(start[2] + 1j * start[3], share * (turns_rad[1] + 1j * turns_rad[2]))
    reach = 1
    while reach < a.size:
        a1, b1, a2, b2 = a[:-reach], b[:-reach], a[reach:], b[reach:]
        a[reach:], b[reach:] = a1 * a2 - b1 * b2.conj(), a1 * b2 + b1 * a2.conj()
        reach *= 2
    whole = np.array([a.real, a.imag, b.real, b.imag])
    return np.asarray(whole / np.sqrt((whole**2).sum(axis=0)))


def axes_of(quaternions: Array) -> tuple[Array, Array, Array]:
    """Return tangent, normal and binormal, shape (3, ...) each, for quaternions of the shape (4, ...)."""
    w, x, y, z = quaternions
    return (
        np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]),
        np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]),
        np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]),
    )


def quaternion_of(tangent: Array, normal: Array) -> Array:
    """Return the quaternion, shape (4,), of the frame with an orthonormal tangent and normal, shape (3,) each."""
    (a, b, c), (d, e, f) = tangent.tolist(), normal.tolist()
    m = np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([1 + trace, *(1 + 2 * m[i, i] - trace for i in range(3))])
    # The largest of the four components is far from zero; the other three follow by division.
    k = int(squares.argmax())
    quaternion = np.empty(4)
    quaternion[k] = 0.5 * np.sqrt(squares[k])
    sums = {(0, 1): m[2, 1] - m[1, 2], (0, 2): m[0, 2] - m[2, 0], (0, 3): m[1, 0] - m[0, 1],
            (1, 2): m[0, 1] + m[1, 0], (1, 3): m[0, 2] + m[2, 0], (2, 3): m[1, 2] + m[2, 1]}  # fmt: skip
    for other in range(4):
        if other != k:
            quaternion[other] = sums[min(k, other), max(k, other)] / (4 * quaternion[k])
    return quaternion
