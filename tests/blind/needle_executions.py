"""A bevel-tip needle as a moving point: position x and unit tangent t.

In tissue the tip moves along its tangent, x' = t, and turns toward the unit vector b across it, t' = b / R. With b held
in the plane of the step the path is a circle's arc.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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
