"""The voxels that segments cross, in their order.

A segment enters the next voxel where it crosses a face. Along each axis, the faces between the voxels of its ends are
crossed one after another, at shares of the segment that follow from a division. So the voxels on the way are those
after each crossing, in the order of the shares: what the traversal of Amanatides and Woo (A fast voxel traversal
algorithm for ray tracing, Eurographics 1987) finds step by step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["crossed_voxels"]


def crossed_voxels(
    start: NDArray[np.float64], end: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the voxels that segments cross, and the share of each segment at which it enters them.

    Voxels have the size 1, and their centres are at whole numbers. A segment through an edge enters one more voxel,
    which it only touches.

    Parameters
    ----------
    start, end : numpy.ndarray
        Ends of the segments, shape (n, 3).

    Returns
    -------
    voxels : numpy.ndarray
        Indices of the voxels, from that of `start` to that of `end`, shape (n, m, 3). Segments that cross fewer voxels
        repeat their last one.
    shares : numpy.ndarray
        Shares from 0 to 1, ascending, shape (n, m); 0 for the voxel of `start`, infinity for repeated ones.
    """
    first, last = (np.floor(point + 0.5).astype(np.int64) for point in (start, end))
    count, sign = abs(last - first), np.sign(last - first)
    number = np.arange(count.max(initial=0))
    faces = first[..., None] + sign[..., None] * (number + 0.5)
    is_crossed = number < count[..., None]
    ahead = np.where(count > 0, end - start, 1.0)
    shares = np.where(is_crossed, (faces - start[..., None]) / ahead[..., None], np.inf)
    moves = np.where(is_crossed, sign[..., None], 0)[..., None] * np.eye(3, dtype=np.int64)[:, None]
    shares, moves = shares.reshape(len(start), -1), moves.reshape(len(start), -1, 3)
    order = np.argsort(shares, axis=-1, kind="stable")
    shares = np.take_along_axis(shares, order, -1)
    moves = np.take_along_axis(moves, order[..., None], 1)
    voxels = np.concatenate([first[:, None], first[:, None] + moves.cumsum(1)], 1)
    return voxels, np.concatenate([np.zeros((len(start), 1)), np.clip(shares, 0, None)], 1)
