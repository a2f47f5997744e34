"""Exact distances between the chords of paths and the boxes of obstacle voxels.

All coordinates are local mm: the voxel (i, j, k) of size h is the box of (i - 1/2, j - 1/2, k - 1/2) h to
(i + 1/2, j + 1/2, k + 1/2) h. Local coordinates are the patient's, turned and shifted, so distances are the same.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
_PAIRS = 4_000_000  # pairs of chord and voxel that are looked up at once
_ROUNDING_MM = 1e-4  # of distances in single precision


def box_distances(points: Array, low: Array, high: Array) -> Array:
    """Distances in mm from points to boxes, (..., 3) each; 0 inside."""
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1)


def segment_box_distances(start: Array, end: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Exact distances of segments to boxes.

    Along a segment the squared distance is convex, and a parabola between crossings of the planes of the box's faces.
    Its slope is known at the crossings, and is linear between the two where it changes its sign.

    Parameters
    ----------
    start, end : ndarray
        Ends of the segments in mm, (n, 3).
    low, high : ndarray
        Corners of the boxes in mm, (n, 3).

    Returns
    -------
    distance, share : ndarray
        Distances in mm, and the share of the segment where each is reached, (n,).
    """
    course = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate([(low - start) / course, (high - start) / course], axis=1)
    ends = np.broadcast_to([0.0, 1.0], (len(start), 2))
    shares = np.sort(np.concatenate([np.clip(np.nan_to_num(crossings), 0.0, 1.0), ends], axis=1), axis=1)
    points = start[:, None] + shares[..., None] * course[:, None]
    outward = np.maximum(points - high[:, None], 0.0) - np.maximum(low[:, None] - points, 0.0)
    slope = (outward * course[:, None]).sum(-1)
    rising = slope >= 0.0
    after = np.where(rising.any(1), rising.argmax(1), shares.shape[1] - 1)
    before = np.maximum(after - 1, 0)
    row = np.arange(len(start))
    fall, rise = -np.minimum(slope[row, before], 0.0), np.maximum(slope[row, after], 0.0)
    between = np.divide(fall, fall + rise, out=np.ones(len(start)), where=fall + rise > 0.0)
    share = shares[row, before] + between * (shares[row, after] - shares[row, before])
    return box_distances(start + share[:, None] * course, low, high), share


def surface(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The voxels of a mask with a free neighbour across a face; from outside, one of them is always the nearest."""
    inner = mask.copy()
    for axis in range(3):
        rows = np.moveaxis(mask, axis, 0)
        covered = np.moveaxis(inner, axis, 0)
        covered[0] = covered[-1] = False
        covered[1:-1] &= rows[:-2] & rows[2:]
    return mask & ~inner


def centre_distances(mask: NDArray[np.bool_], spacing: Array, reach_mm: float) -> NDArray[np.float32]:
    """Distance in mm from the centre of every voxel to the nearest box of the mask; infinite beyond reach_mm."""
    squared = np.where(mask, np.float32(0.0), np.float32(np.inf))
    for axis in range(3):
        nearest = np.moveaxis(squared, axis, 0)
        before = nearest.copy()
        for offset in range(1, min(int(reach_mm / spacing[axis] + 0.5) + 1, len(before))):
            gap = np.float32(((offset - 0.5) * spacing[axis]) ** 2)
            np.minimum(nearest[offset:], before[:-offset] + gap, out=nearest[offset:])
            np.minimum(nearest[:-offset], before[offset:] + gap, out=nearest[:-offset])
    return np.sqrt(squared)


def _cropped(mask: NDArray[np.bool_], low: Indices, high: Indices) -> NDArray[np.bool_]:
    """The voxels from low to high (included), free where the mask has none."""
    part = np.zeros(high - low + 1, bool)
    first, last = np.maximum(low, 0), np.minimum(high + 1, mask.shape)
    if (first < last).all():
        inside = tuple(slice(*edge) for edge in zip(first, last, strict=True))
        part[tuple(slice(*edge) for edge in zip(first - low, last - low, strict=True))] = mask[inside]
    return part


def _neighbourhood(spacing: Array, reach_mm: float) -> Indices:
    """Offsets of all voxels whose box may be within reach_mm of a point of the voxel in the middle, (m, 3)."""
    counts = (reach_mm / spacing).astype(int) + 1
    axes = [np.arange(-count, count + 1) for count in counts]
    offsets = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    gaps = np.maximum(np.abs(offsets) - 1, 0) * spacing
    return offsets[(gaps**2).sum(1) <= reach_mm**2]


def nearest_boxes(
    start: Array, end: Array, path: Indices, paths: int, mask: NDArray[np.bool_], spacing: Array, reach_mm: float
) -> tuple[Array, Indices, Array]:
    """Smallest distance of each path to a box of the mask, as far as it is within reach.

    Parameters
    ----------
    start, end : ndarray
        Ends of the chords in local mm, (n, 3); none is inside the mask.
    path : ndarray
        The path of each chord, (n,), from 0 to paths - 1.
    paths : int
        The number of paths.
    mask : ndarray
        The obstacle voxels, (ni, nj, nk).
    spacing : ndarray
        Sizes of a voxel in mm, (3,).
    reach_mm : float
        Larger distances are returned as infinite.

    Returns
    -------
    distance : ndarray
        In mm, (paths,).
    chord, share : ndarray
        Where each is reached: the chord and the share of it, (paths,); chord -1 beyond the reach.
    """
    best, chord, share = np.full(paths, np.inf), np.full(paths, -1), np.zeros(paths)
    middle, half = 0.5 * (start + end), 0.5 * np.linalg.norm(end - start, axis=1)
    extent = (np.array(mask.shape) - 0.5) * spacing
    near = np.flatnonzero(box_distances(middle, -0.5 * spacing, extent) <= reach_mm + half)
    if not near.size:
        return best, chord, share
    slack = reach_mm + half.max() + 0.5 * np.linalg.norm(spacing)
    cells = np.floor(middle[near] / spacing + 0.5).astype(int)
    margin = (slack / spacing).astype(int) + 4
    origin = cells.min(0) - margin
    solid = _cropped(mask, origin, cells.max(0) + margin)
    field = centre_distances(solid, spacing, slack)[tuple((cells - origin).T)].astype(float)
    off_centre = np.linalg.norm(middle[near] - cells * spacing, axis=1)
    least = field - off_centre - half[near] - _ROUNDING_MM
    most = np.full(paths, reach_mm)
    np.minimum.at(most, path[near], field + off_centre + _ROUNDING_MM)
    limit = most[path[near]]
    edge = surface(solid)
    steps = np.ceil((limit + half[near]) / (2.0 * spacing.min())).astype(int)
    for step in np.unique(steps[least <= limit]):
        group = np.flatnonzero((least <= limit) & (steps == step))
        offsets = _neighbourhood(spacing, 2.0 * spacing.min() * step)
        for part in np.array_split(group, len(group) * len(offsets) // _PAIRS + 1):
            row, column = _hits(edge, cells[part] - origin, offsets)
            boxes = (cells[part][row] + offsets[column]) * spacing
            candidate = near[part][row]
            rough = box_distances(middle[candidate], boxes - 0.5 * spacing, boxes + 0.5 * spacing)
            kept = rough - half[candidate] <= np.minimum(most, best)[path[candidate]]
            candidate, boxes = candidate[kept], boxes[kept]
            distance, place = segment_box_distances(
                start[candidate], end[candidate], boxes - 0.5 * spacing, boxes + 0.5 * spacing
            )
            order = np.lexsort((distance, path[candidate]))
            numbers, first = np.unique(path[candidate][order], return_index=True)
            winner = order[first]
            closer = distance[winner] < best[numbers]
            numbers, winner = numbers[closer], winner[closer]
            best[numbers], chord[numbers], share[numbers] = distance[winner], candidate[winner], place[winner]
    beyond = best > reach_mm
    best[beyond], chord[beyond] = np.inf, -1
    return best, chord, share


def _hits(edge: NDArray[np.bool_], cells: Indices, offsets: Indices) -> tuple[Indices, Indices]:
    """Pairs of cell and offset that lead to a voxel of the edge."""
    strides = np.array([edge.shape[1] * edge.shape[2], edge.shape[2], 1])
    lookup = (cells @ strides)[:, None] + (offsets @ strides)[None]
    # The crop is wide enough for all offsets from a cell of a chord.
    return np.divmod(np.flatnonzero(edge.ravel()[lookup].ravel()), len(offsets))
