"""A small finite-element model: a half-space as an axisymmetric body, pushed at a point of its axis."""

import numpy as np
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.linalg import spsolve

from needleplan.signals import Array

_FAR_MM = 2000.0
_FINEST_MM = 0.5


def graded(length: float, count: int) -> Array:
    """Return `count` + 1 places from 0 to a length, whose distances begin at the finest and grow by one factor."""
    factor = brentq(lambda q: _FINEST_MM * (q**count - 1) / (q - 1) - length, 1.0001, 3.0)
    return np.concatenate([[0.0], np.cumsum(_FINEST_MM * factor ** np.arange(count))])


def pushed(shear: float, poisson: float, depth: float, force: float) -> tuple[Array, Array, Array]:
    """Return radii, depths and the axial displacement, (depths, radii), by a force on the axis at a depth.

    Bilinear elements with four points of Gauss' rule. The surface is free, the far sides are held.
    """
    lame = 2 * shear * poisson / (1 - 2 * poisson)
    law = lame * np.pad(np.ones((3, 3)), (0, 1)) + shear * np.diag([2.0, 2.0, 2.0, 1.0])
    radii = graded(_FAR_MM, 45)
    depths = np.concatenate([depth - graded(depth, 14)[::-1], depth + graded(_FAR_MM, 40)[1:]])
    number = np.arange(depths.size * radii.size).reshape(depths.size, radii.size)
    nodes = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    wide, high = (each.ravel() for each in np.meshgrid(np.diff(radii), np.diff(depths)))
    inner = np.meshgrid(radii[:-1], depths[:-1])[0].ravel()
    stiffness = np.zeros((len(nodes), 8, 8))
    for a, b in [(x / np.sqrt(3), y / np.sqrt(3)) for x in (-1, 1) for y in (-1, 1)]:
        shape = np.array([(1 - a) * (1 - b), (1 + a) * (1 - b), (1 + a) * (1 + b), (1 - a) * (1 + b)]) / 4
        along_r = np.array([-(1 - b), 1 - b, 1 + b, -(1 + b)]) / 2 / wide[:, None]
        along_z = np.array([-(1 - a), -(1 + a), 1 + a, 1 - a]) / 2 / high[:, None]
        radius = inner + wide * (1 + a) / 2
        strain = np.zeros((len(nodes), 4, 8))
        strain[:, 0, 0::2], strain[:, 1, 1::2], strain[:, 2, 0::2] = along_r, along_z, shape / radius[:, None]
        strain[:, 3, 0::2], strain[:, 3, 1::2] = along_z, along_r
        volume = 2 * np.pi * radius * wide * high / 4
        stiffness += np.einsum("eki,kl,elj,e->eij", strain, law, strain, volume)
    free_of = np.stack([2 * nodes, 2 * nodes + 1], axis=2).reshape(len(nodes), 8)
    rows, columns = np.repeat(free_of, 8, axis=1).ravel(), np.tile(free_of, (1, 8)).ravel()
    size = 2 * number.size
    matrix = sparse.coo_matrix((stiffness.ravel(), (rows, columns)), shape=(size, size)).tocsr()
    load = np.zeros(size)
    load[2 * number[14, 0] + 1] = force
    far = np.concatenate([number[-1], number[:, -1]])
    free = np.setdiff1d(np.arange(size), np.concatenate([2 * number[:, 0], 2 * far, 2 * far + 1]))
    moved = np.zeros(size)
    moved[free] = spsolve(matrix[free][:, free].tocsc(), load[free])
    return radii, depths, moved[1::2].reshape(number.shape)
