"""Distances of a path to each obstacle of the file, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._anatomy import Anatomy

__all__ = ["obstacle_distances"]

# Distance (mm) from which on an obstacle counts as far and is left out.
_FAR_MM = 30.0


def obstacle_distances(anatomy: Anatomy, points_mm: NDArray[np.float64]) -> dict[str, float]:
    """Return the smallest distance of the points of a path to each obstacle, to the faces of its voxels in the file.

    Parameters
    ----------
    anatomy : Anatomy
        The anatomy.
    points_mm : numpy.ndarray
        Points along the path in RAS mm, shape (n, 3): those of the centre line of the needle, without its thickness.

    Returns
    -------
    dict
        Distances (mm) by the name or number of the label in `obstacles`, the nearest first; 0 in an obstacle. Obstacles
        farther than 30 mm are left out.
    """
    from scipy.spatial import KDTree

    volume, regions = anatomy.volume, anatomy.regions
    sizes = volume.sizes_mm
    index = volume.voxels(points_mm)
    low = np.clip(np.floor(index.min(0) - _FAR_MM / sizes), 0, volume.labels.shape).astype(np.int64)
    high = np.clip(np.ceil(index.max(0) + _FAR_MM / sizes) + 1, 0, volume.labels.shape).astype(np.int64)
    part = volume.labels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    # In voxel axes with their sizes, voxels are boxes along the axes.
    points, nearest_mm = (index - low) * sizes, {}
    for label, number in zip(regions.obstacles, anatomy.numbers(regions.obstacles), strict=True):
        centers = np.argwhere(part == number) * sizes
        if not len(centers):
            continue
        tree = KDTree(centers)
        nearest, _ = tree.query(points)
        # The nearest box has its centre at most a diagonal farther than the nearest centre.
        reach = float(np.min(nearest) + np.linalg.norm(sizes))
        near = [np.array(indices, np.int64) for indices in tree.query_ball_point(points, reach)]
        apart = np.concatenate([abs(centers[indices] - point) for point, indices in zip(points, near, strict=True)])
        distance = float(np.linalg.norm(np.maximum(apart - sizes / 2, 0), axis=-1).min())
        if distance <= _FAR_MM:
            nearest_mm[str(label)] = distance
    return dict(sorted(nearest_mm.items(), key=lambda item: item[1]))
