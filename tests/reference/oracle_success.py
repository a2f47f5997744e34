"""The success between grid points, read slowly: cubic where all is free, else from the free corners of the cell.

* A grid point is free if it is on the grid and not in an obstacle; one in the target is free and has the success 1.
* If the 4 x 4 grid points around a place are free: the polynomial of degree three in x and in y through them
  (Lagrange), limited to [0, 1].
* Otherwise the bilinear mean of the free corners of the cell. Their weights are divided by their sum, if that is above
  0.05.
* The end of a step on a grid line counts to the cell ahead, in the direction in which the heading moves most.
"""

import numpy as np
from numpy.typing import NDArray
from oracle_arc import Floats, Ints, Problem

NODES = (-1, 0, 1, 2)
LEAST_SUM = 0.05
ON_LINE = 1e-9


def lagrange(f: Floats) -> list[Floats]:
    """The weights of the nodes for a place at f, by their definition."""
    return [np.prod([(f - other) / (node - other) for other in NODES if other != node], axis=0) for node in NODES]


def cells_of(places: Floats, backwards: NDArray[np.bool_]) -> tuple[Ints, Floats]:
    """Cells and fractions of places in units of the spacing."""
    whole = np.where(np.abs(places - np.rint(places)) < ON_LINE, np.rint(places), np.floor(places))
    fraction = np.clip(places - whole, 0.0, 1.0)
    before = backwards & (fraction == 0.0)
    return (whole - before).astype(int), np.where(before, 1.0, np.where(fraction < ON_LINE, 0.0, fraction))


def interpolated_success(
    problem: Problem,
    free: NDArray[np.bool_],
    table: Floats,
    place: tuple[Floats, Floats],
    plane: tuple[Ints, Ints],
    heading: Floats,
) -> Floats:
    """Read a table [x, y, heading, bevel] at places and planes (heading, bevel); the heading gives the direction."""
    nx, ny = free.shape
    along_x, along_y = np.cos(heading) / problem.dx, np.sin(heading) / problem.dy
    horizontal = np.abs(along_x) >= np.abs(along_y)
    (i, f), (j, g) = (
        cells_of(place[0] / problem.dx, horizontal & (along_x <= 0)),
        cells_of(place[1] / problem.dy, ~horizontal & (along_y <= 0)),
    )
    shape = np.broadcast_shapes(i.shape, plane[0].shape, plane[1].shape)
    cubic, bilinear, total, all_free = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.ones(shape, dtype=bool)
    of_x, of_y = lagrange(f), lagrange(g)
    for a, wx in zip(NODES, of_x, strict=True):
        for b, wy in zip(NODES, of_y, strict=True):
            on_grid = (i + a >= 0) & (i + a < nx) & (j + b >= 0) & (j + b < ny)
            at = np.clip(i + a, 0, nx - 1), np.clip(j + b, 0, ny - 1)
            is_free = on_grid & free[at]
            value = np.where(is_free, table[(*at, *plane)], 0.0)
            all_free &= is_free
            cubic += wx * wy * value
            if a in (0, 1) and b in (0, 1):
                share = (f if a else 1 - f) * (g if b else 1 - g)
                bilinear += share * value
                total += share * is_free
    return np.where(all_free, np.clip(cubic, 0.0, 1.0), bilinear / np.where(total > LEAST_SUM, total, 1.0))
