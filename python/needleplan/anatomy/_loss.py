"""What a lattice changes of the obstacles of a file: judged in the voxels of the file, at random points.

**Volumes.** Random points in the obstacle voxels, and in the free voxels, of the file show how much of each volume is
on the other side on the lattice. Of the obstacles, nothing is, by construction.

**Passages.** The middle of a passage is a free voxel of the file whose distance d to the obstacles falls to both sides
along an axis of the file, towards walls that face each other: their directions are at least 120 degrees apart. (Beside
a convex body, the distance is convex, and falls to one side at most.) The passage is closed if the lattice has an
obstacle there. Its width is 2 d, or the distance of the walls if that is less.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy._voxels import FREE, IS_OBSTACLE, IS_OUTSIDE, OBSTACLE, TARGET

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._frame import FileDistances, SpaceFrame
    from needleplan.anatomy._volume import LabelVolume

__all__ = ["LatticeLoss", "lattice_loss"]

# Number of random points in the box of the lattice. With obstacles in 1 % of it, the share has a standard error of 1 %.
_POINTS = 500_000
# Largest cosine of the angle between the directions to walls that face each other.
_OPPOSITE = -0.5


@dataclass(frozen=True)
class LatticeLoss:
    """Differences between the obstacles on a lattice and the obstacles in the segmentation file.

    Parameters
    ----------
    obstacle_share : float
        Share of the volume of the obstacles, within the lattice, that is free or target on the lattice.
    free_share : float
        Share of the free volume, within the lattice, that is closed on the lattice: by the margin, the needle's
        thickness, and the size of the voxels of the lattice.
    closed_passage_mm : float
        Width of the widest passage between obstacles that the lattice closes; 0 if there is none.
    """

    obstacle_share: float
    free_share: float
    closed_passage_mm: float


def lattice_loss(
    volume: LabelVolume,
    meaning: NDArray[np.uint8],
    frame: SpaceFrame,
    voxels: NDArray[np.uint8],
    distances: FileDistances,
    farthest_mm: float,
) -> LatticeLoss:
    """Compare the obstacles on a lattice with the obstacles in the segmentation file.

    Parameters
    ----------
    volume : LabelVolume
        The volume of the file.
    meaning : numpy.ndarray
        Bits of the voxels of the file, as for `lattice_voxels`.
    frame : SpaceFrame
        The frame of the lattice.
    voxels : numpy.ndarray
        Codes of the voxels of the lattice.
    distances : FileDistances
        Distances of the voxels of the file to the obstacles.
    farthest_mm : float
        Largest distance from the obstacles of the file at which a voxel of the lattice can be an obstacle.
    """
    if not distances.distances_mm.size:
        return LatticeLoss(0.0, 0.0, 0.0)
    box = tuple(slice(a, a + n) for a, n in zip(distances.first.tolist(), distances.distances_mm.shape, strict=True))
    part, size_mm = meaning[box], frame.spacing_mm * frame.shape[0] / voxels.shape[0]

    def codes(index: NDArray[Any]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return the codes of the lattice at places in the box, (n, 3), and which places are within the lattice."""
        at = np.floor(frame.local(volume.world(index + distances.first)) / size_mm + 0.5).astype(np.int64)
        within = ((at >= 0) & (at < voxels.shape)).all(-1)
        return voxels[tuple(np.clip(at, 0, np.array(voxels.shape) - 1).T)], within

    random, shape = np.random.default_rng(0), np.array(part.shape)
    places = random.random((_POINTS, 3)) * shape - 0.5
    known = part[tuple(np.floor(places + 0.5).astype(np.int64).T)]
    file_codes, within = codes(places)

    def share(of: NDArray[np.bool_], wrong: NDArray[np.bool_]) -> float:
        return float(wrong[of & within].mean()) if (of & within).any() else 0.0

    is_free = (known & (IS_OBSTACLE | IS_OUTSIDE)) == 0
    middles, widths_mm = _passages(
        (part & IS_OBSTACLE) == 0, distances.distances_mm, volume.sizes_mm, farthest_mm + float(volume.sizes_mm.max())
    )
    at_middle, within_lattice = codes(middles)
    closed_mm = widths_mm[(at_middle == OBSTACLE) & within_lattice]
    return LatticeLoss(
        share((known & IS_OBSTACLE) > 0, (file_codes == FREE) | (file_codes == TARGET)),
        share(is_free, file_codes == OBSTACLE),
        float(closed_mm.max(initial=0.0)),
    )


def _passages(
    free: NDArray[np.bool_], distances_mm: NDArray[np.float32], sizes_mm: NDArray[np.float64], farthest_mm: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the free voxels in the middle of passages between obstacles, and the widths of the passages.

    A voxel is in the middle of a passage if its distance to the obstacles is a local maximum along an axis, and the
    nearest obstacle voxels on both sides are in opposite directions. `free` and `distances_mm`, the distance of each
    voxel to the nearest obstacle, have the shape of the volume. Voxels farther than `farthest_mm` are left out.
    Returns the indices of the voxels, shape (n, 3), and the widths (mm), shape (n,).
    """
    from scipy import ndimage
    from scipy.spatial import KDTree

    voxels = np.argwhere(free & (distances_mm <= farthest_mm))
    last = np.array(free.shape) - 1

    def distances_at(offset: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the distances (mm) of the voxels that are shifted by an offset from `voxels`."""
        return np.asarray(distances_mm[tuple(np.clip(voxels + offset, 0, last).T)])

    surface = np.argwhere(~free & ndimage.binary_dilation(free))
    tree, distances = KDTree(surface * sizes_mm), distances_mm[tuple(voxels.T)]
    passages, widths = [np.empty((0, 3), np.int64)], [np.empty(0)]
    for step in np.eye(3, dtype=np.int64):
        # A passage of an even number of voxels has two voxels in its middle, at the same distance.
        is_even = (distances_at(step) == distances) & (distances_at(2 * step) < distances)
        maxima = np.flatnonzero((distances_at(-step) < distances) & ((distances_at(step) < distances) | is_even))
        middles, ahead = voxels[maxima], np.where(is_even[maxima], 2, 1)[:, None] * step
        walls = [surface[tree.query((middles + offset) * sizes_mm)[1]] - middles for offset in (-step, ahead)]
        left, right = (wall * sizes_mm for wall in walls)
        cosines = (left * right).sum(-1) / (np.linalg.norm(left, axis=-1) * np.linalg.norm(right, axis=-1))
        is_passage = cosines < _OPPOSITE
        passages.append(middles[is_passage])
        # Walls are at the faces of their voxels.
        wall_distances = np.linalg.norm(left - right, axis=-1) - sizes_mm.min()
        widths.append(np.minimum(wall_distances, 2 * distances[maxima])[is_passage])
    return np.concatenate(passages), np.concatenate(widths)
