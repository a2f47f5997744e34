"""Surfaces of bodies on a grid, as triangles for the 3D view.

Surface nets: S. F. F. Gibson, Constrained elastic surface nets, MICCAI 1998. Every cell of eight grid points that
the surface crosses has one vertex, at the mean of the crossed edges' midpoints; every crossed edge has a square between
the four cells around it. The vertices are then smoothed, each within its cell.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["surface"]

# Number of times that every vertex moves to the mean of its neighbours. More make the surface smoother; two are enough
# for the eye, and vertices stay within their cells in any case.
_SMOOTHED = 2


def surface(body: NDArray[np.bool_], spacing_mm: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return the surface of a body.

    Parameters
    ----------
    body : numpy.ndarray
        Which grid points belong to the body, shape (nx, ny, nz). The surface is closed at the border of the grid.
    spacing_mm : float
        Distance of grid points.

    Returns
    -------
    vertices : numpy.ndarray
        Positions in mm from grid point 0, shape (n, 3).
    triangles : numpy.ndarray
        Numbers of the vertices, counter-clockwise seen from outside, shape (m, 3).
    """
    inside = np.pad(body, 1)
    crossed, vertices = _vertices(inside)
    number = np.full(crossed.shape, -1, np.int64)
    number[crossed] = np.arange(len(vertices))
    squares = _squares(inside, number)
    vertices = _smooth(vertices, squares, np.argwhere(crossed))
    triangles = squares[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    # Index 1 of the padded grid is grid point 0.
    return ((vertices - 1) * spacing_mm).astype(np.float32), triangles.astype(np.uint32)


def _vertices(inside: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return which cells the surface crosses, and for each of them the mean of the midpoints of its crossed edges."""
    size = np.array(inside.shape) - 1

    def corner(at: tuple[int, ...]) -> NDArray[np.bool_]:
        return inside[tuple(slice(a, a + n) for a, n in zip(at, size, strict=True))]

    corners = list(itertools.product((0, 1), repeat=3))
    count = sum(corner(at).astype(np.uint8) for at in corners)
    crossed = np.asarray((count > 0) & (count < 8))
    total, crossings = np.zeros((int(crossed.sum()), 3)), np.zeros(int(crossed.sum()))
    for one, other in itertools.combinations(corners, 2):
        if sum(abs(a - b) for a, b in zip(one, other, strict=True)) == 1:
            differs = (corner(one) != corner(other))[crossed]
            total += np.outer(differs, (np.array(one) + other) / 2)
            crossings += differs
    return crossed, np.argwhere(crossed) + total / crossings[:, None]


def _squares(inside: NDArray[np.bool_], number: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers of the vertices of every square, counter-clockwise seen from outside, shape (m, 4)."""
    found = []
    for axis in range(3):
        ahead, behind = (np.delete(inside, end, axis) for end in (0, -1))
        edges = np.argwhere(ahead != behind)
        one, other = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        around = [edges - a * one - b * other for a, b in ((1, 1), (0, 1), (0, 0), (1, 0))]
        square = np.stack([number[tuple(cells.T)] for cells in around], -1)
        inward = ahead[tuple(edges.T)]  # the body lies ahead, so outside is behind
        square[inward] = square[inward][:, ::-1]
        found.append(square)
    return np.concatenate(found)


def _smooth(vertices: NDArray[np.float64], squares: NDArray[np.int64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    ends = np.concatenate([squares[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    neighbours = np.bincount(ends.ravel(), minlength=len(vertices))
    for _ in range(_SMOOTHED):
        total = np.zeros_like(vertices)
        for axis in range(3):
            for here, there in (ends.T, ends.T[::-1]):
                total[:, axis] += np.bincount(here, vertices[there, axis], len(vertices))
        vertices = np.clip(total / np.maximum(neighbours, 1)[:, None], cells, cells + 1)
    return vertices
