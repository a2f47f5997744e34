"""A bevel-tip needle as a moving point: position x, unit tangent t, and the roll angle of the bevel as the action.

In tissue the tip moves along its tangent, x' = t, and turns toward the unit vector b across it, t' = b / R. With b held
in the plane of the step the path is a circle's arc. Tip noise turns the tangent before a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def transverse(tangent: ArrayLike) -> tuple[Array, Array]:
    """Two unit vectors e1, e2 across unit tangents (..., 3), so that (t, e1, e2) is right-handed.

    Parameters
    ----------
    tangent : array_like
        Unit tangents, (..., 3).

    Returns
    -------
    e1, e2 : ndarray
        Unit vectors, (..., 3); e1 is across the coordinate axis that is farthest from t.
    """
    tangent = np.asarray(tangent, float)
    axis = np.eye(3)[np.abs(tangent).argmin(-1)]
    e1 = np.cross(axis, tangent)
    e1 = e1 / np.linalg.norm(e1, axis=-1, keepdims=True)
    return e1, np.cross(tangent, e1)


def bending_direction(tangent: ArrayLike, roll_rad: ArrayLike) -> Array:
    """Direction b(phi) = cos(phi) e1 + sin(phi) e2 in which a tip with roll angle phi bends.

    Parameters
    ----------
    tangent : array_like
        Unit tangents, (..., 3).
    roll_rad : array_like
        Roll angles phi, (...).

    Returns
    -------
    ndarray
        Unit vectors across the tangents, (..., 3).
    """
    e1, e2 = transverse(tangent)
    roll = np.asarray(roll_rad, float)[..., None]
    return np.cos(roll) * e1 + np.sin(roll) * e2


def arc(
    point: ArrayLike, tangent: ArrayLike, bending_direction: ArrayLike, radius: ArrayLike, lengths: ArrayLike
) -> tuple[Array, Array]:
    """Points and tangents of a needle after inserted lengths along one arc; all arguments broadcast.

    x(s) = x + R sin(s/R) t + R (1 - cos(s/R)) b and t(s) = cos(s/R) t + sin(s/R) b.

    Parameters
    ----------
    point : array_like
        Tip position in mm, (..., 3).
    tangent, bending_direction : array_like
        Unit vectors, perpendicular to each other, (..., 3).
    radius : array_like
        Radius R in mm, (...); infinite for a straight step.
    lengths : array_like
        Inserted lengths s in mm, (...).

    Returns
    -------
    points, tangents : ndarray
        Positions in mm and unit tangents, (..., 3).
    """
    point, tangent, across = (np.asarray(vector, float) for vector in (point, tangent, bending_direction))
    length = np.asarray(lengths, float)[..., None]
    angle = length / np.asarray(radius, float)[..., None]
    # R sin(s/R) and R (1 - cos(s/R)), without cancellation for large R.
    along = length * np.sinc(angle / np.pi)
    aside = 0.5 * length * angle * np.sinc(0.5 * angle / np.pi) ** 2
    return point + along * tangent + aside * across, np.cos(angle) * tangent + np.sin(angle) * across


def disturb(tangent: ArrayLike, length: ArrayLike, rng: np.random.Generator, noise: float) -> Array:
    """Unit tangents after the tip noise of steps.

    Parameters
    ----------
    tangent : array_like
        Unit tangents, (..., 3).
    length : array_like
        Lengths of the steps in mm, (...).
    rng : numpy.random.Generator
        Source of two normal numbers for each tangent.
    noise : float
        Standard deviation in degrees of each of the two transverse angles after 10 mm.

    Returns
    -------
    ndarray
        Unit tangents, (..., 3).
    """
    tangent = np.asarray(tangent, float)
    e1, e2 = transverse(tangent)
    deviation = np.deg2rad(noise) * np.sqrt(np.asarray(length, float) / 10.0)
    angles = rng.standard_normal((*tangent.shape[:-1], 2)) * deviation[..., None]
    turn = np.linalg.norm(angles, axis=-1, keepdims=True)
    aside = (angles[..., :1] * e1 + angles[..., 1:] * e2) * np.sinc(turn / np.pi)
    turned = np.cos(turn) * tangent + aside
    return turned / np.linalg.norm(turned, axis=-1, keepdims=True)
