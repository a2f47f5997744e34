"""First-order displacement of a 3D path by a small additional curvature.

An additional curvature dk at the length s, toward the unit vector d perpendicular to the tangent t, rotates the path
beyond s by t x d dk. Every position p beyond s moves by the cross product of this rotation with p - p(s). The sum of
the displacements over all s is exact to first order, so it also gives the displacement by a random curvature.
"""

from __future__ import annotations

import numpy as np

from needleplan.signals import Array, Motion

__all__ = ["bevel_direction", "fixed_direction", "path_displacement"]


def path_displacement(
    states: Array, motion: Motion, added_per_mm: Array, direction: Array, felt_mm: float = 0.0
) -> Array:
    """Return the displacement (mm) of every position caused by each additional curvature, shape (3 * samples, m).

    The rows are all x, then all y, then all z.

    Parameters
    ----------
    states
        States of a `SteeredModel` along the motion, shape (10, samples).
    motion
        The motion of the path.
    added_per_mm
        Additional curvatures (1/mm), one per column, shape (samples, m).
    direction
        Unit direction of the additional curvature, perpendicular to the tangent, shape (3, samples).
    felt_mm
        Length over which an elastic needle averages its load (`SpatialBeam.felt_mm`); 0 for a path without elasticity.
    """
    tangent, place = states[3:6], states[:3]
    step = np.append(np.diff(np.maximum(motion.depth_mm, 0.0)), 0.0)
    rotations = np.cross(tangent, direction, axis=0)[..., None] * (added_per_mm * step[:, None])[None]
    # The sum of rotation(s) x (p - p(s)) over all s before p, as two cumulative sums without the present sample.
    rotated = np.cumsum(rotations, axis=1) - rotations
    moments = _cross(rotations, place[..., None])
    before = np.cumsum(moments, axis=1) - moments
    moved = _cross(rotated, place[..., None]) - before
    if felt_mm:
        moved = moved + felt_mm * np.cross(rotated, tangent[..., None], axis=0)
        moved = moved + felt_mm**2 / 2 * direction[..., None] * added_per_mm
    return np.asarray(moved.reshape(-1, added_per_mm.shape[1]))


def bevel_direction(states: Array, offset_rad: float) -> Array:
    """Return the unit vector across the path at `offset_rad` from the bevel, for each sample, shape (3, samples)."""
    return _across(states, states[9] + offset_rad)


def fixed_direction(states: Array, angle_rad: float) -> Array:
    """Return the unit vector across the path at `angle_rad` from the normal n, for each sample, shape (3, samples)."""
    return _across(states, np.full(states.shape[1], angle_rad))


def _across(states: Array, angle_rad: Array) -> Array:
    tangent, normal = states[3:6], states[6:9]
    return np.asarray(np.cos(angle_rad) * normal + np.sin(angle_rad) * np.cross(tangent, normal, axis=0))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of vectors along the first axis; several times as fast as `numpy.cross`."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
