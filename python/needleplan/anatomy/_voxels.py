"""What is in the voxels of a lattice, by the voxels of the file.

Values of a plan live at the grid points of the lattice, collisions are tested in voxels of a fraction of their spacing.

**Obstacles.** A voxel of the lattice is blocked if it has a volume in common with a voxel of an obstacle, grown by half
of the needle's diameter and by the margin. So no path through free voxels comes closer to an obstacle of the file. At
most one voxel of the lattice is lost beside each surface.

**Target.** A voxel of the lattice belongs to the target if its centre does; if there is none, the one that contains the
centre of the target does. The pass plans with these voxels. Executions and look-ups end in the target itself
(`TargetBody`), so that a path that ends in the target ends in that of the file.

**Outside, entry.** Those of the voxel of the file at the centre.

**What is possible.** For a proof that no path exists, the same test is made for the opposite: a cell of the lattice
counts as passable if it has a volume in common with any voxel of the file that is neither obstacle nor outside.

The voxels that segments cross, in their order.

A segment enters the next voxel where it crosses a face. Along each axis, the faces between the voxels of its ends are
crossed one after another, at shares of the segment that follow from a division. So the voxels on the way are those
after each crossing, in the order of the shares: what the traversal of Amanatides and Woo (A fast voxel traversal
algorithm for ray tracing, Eurographics 1987) finds step by step.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan import _ppvi
from needleplan.anatomy._file import Sphere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._frame import SpaceFrame
    from needleplan.anatomy._volume import LabelVolume

__all__ = [
    "FREE",
    "IS_ENTRY",
    "IS_OBSTACLE",
    "IS_OUTSIDE",
    "OBSTACLE",
    "OUTSIDE",
    "TARGET",
    "Growths",
    "crossed_voxels",
    "entered_cells",
    "lattice_voxels",
    "possible_cells",
    "possible_codes",
]


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


FREE, TARGET, OBSTACLE, OUTSIDE = 0, 1, 2, 3
# Bits of the meaning of a voxel of the file.
IS_OBSTACLE, IS_OUTSIDE, IS_ENTRY = 1, 2, 8
# Code of the voxels of the first of several targets while they are found; those of the others follow.
_FIRST_TARGET = 4
# Largest number of cells of a proof between two grid points along an axis, and in all: its time grows with the cells.
_MOST_PROOF_REFINEMENT, _MOST_PROOF_CELLS = 2, 4_000_000
# Bit of a cell that a voxel of the entry region reaches, beside its code.
_ENTERED = 4


@dataclass(frozen=True, eq=False)
class Growths:
    """Growth of obstacles: `kinds` of the voxels (0: none), and the growth (mm) of the kinds 1, 2 and so on."""

    kinds: NDArray[np.uint8]
    growths_mm: tuple[float, ...]


def _not_grown(bodies: NDArray[np.bool_]) -> Growths:
    return Growths(bodies.astype(np.uint8), (0.0,))


def lattice_voxels(
    volume: LabelVolume,
    meaning: NDArray[np.uint8],
    frame: SpaceFrame,
    growths: Growths,
    refinement: int,
    targets: Sequence[int | Sphere],
) -> list[NDArray[np.uint8]]:
    """Return the codes of the voxels of a lattice for each target, shape `refinement` times that of the frame.

    `meaning` holds the bits of the voxels of the file, `growths` how far obstacles are grown, `targets` the number of
    the label of each target, or a ball.
    """
    labels = np.zeros(65536, np.uint8)
    for number, target in enumerate(targets, start=_FIRST_TARGET):
        if isinstance(target, int):
            labels[target] = number
    codes = labels[volume.labels]
    codes[(meaning & IS_OUTSIDE) > 0] = OUTSIDE
    lattice, size = _rasterized(volume, codes, growths, frame, refinement), frame.spacing_mm / refinement
    return [_aimed(volume, lattice, number, target, frame, size)
            for number, target in enumerate(targets, start=_FIRST_TARGET)]  # fmt: skip


def _aimed(
    volume: LabelVolume,
    lattice: NDArray[np.uint8],
    number: int,
    target: int | Sphere,
    frame: SpaceFrame,
    size_mm: float,
) -> NDArray[np.uint8]:
    """Return the codes of the voxels of a lattice for one target, a ball or the label with `number` in `lattice`."""
    meanings = np.arange(256, dtype=np.uint8)
    meanings[_FIRST_TARGET:] = FREE
    meanings[number] = TARGET
    aimed = meanings[lattice]
    if isinstance(target, Sphere):
        _mark_ball(frame.local(target.center_mm), target.radius_mm, size_mm, aimed)
    if not (aimed == TARGET).any():
        center = (
            np.array(target.center_mm)
            if isinstance(target, Sphere)
            else volume.world(np.argwhere(volume.labels == target).mean(0))
        )
        at = np.floor(frame.local(center) / size_mm + 0.5).astype(np.int64)
        if ((at >= 0) & (at < aimed.shape)).all() and aimed[tuple(at)] == FREE:
            aimed[tuple(at)] = TARGET
    return aimed


def _mark_ball(center_mm: NDArray[np.float64], radius_mm: float, size_mm: float, lattice: NDArray[np.uint8]) -> None:
    """Make the free voxels of a lattice with their centre in a ball the target."""
    low = np.clip(np.floor((center_mm - radius_mm) / size_mm), 0, lattice.shape).astype(np.int64)
    high = np.clip(np.ceil((center_mm + radius_mm) / size_mm) + 1, 0, lattice.shape).astype(np.int64)
    box = lattice[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    axes = np.meshgrid(*[np.arange(a, b) * size_mm for a, b in zip(low, high, strict=True)], indexing="ij")
    box[(box == FREE) & (np.linalg.norm(np.stack(axes, -1) - center_mm, axis=-1) <= radius_mm)] = TARGET


def possible_cells(
    volume: LabelVolume, meaning: NDArray[np.uint8], frame: SpaceFrame, targets: Iterable[NDArray[np.bool_]]
) -> Iterator[NDArray[np.uint8]]:
    """Yield the codes of the cells of the reachability proof for each target.

    A cell has the spacing of the frame or half of it. The code of a cell is target or free if any voxel of the file in
    the cell is target or free, else obstacle. 4 is added if a voxel of the entry region reaches the cell. `targets` are
    the voxels of the file in each target.
    """
    finer = _MOST_PROOF_REFINEMENT
    if math.prod(frame.shape) * finer**3 > _MOST_PROOF_CELLS:
        finer = 1
    # Cells at the rim reach beyond the file.
    rim = [math.ceil(frame.spacing_mm / size) + 1 for size in volume.sizes_mm]
    around = [(count, count) for count in rim]
    padded = np.pad(meaning, around, constant_values=IS_OUTSIDE)
    nothing = np.zeros(padded.shape, np.uint8)

    def reached(bits: NDArray[np.bool_]) -> NDArray[np.bool_]:
        cells = _rasterized(volume, nothing, _not_grown(bits), frame, finer, np.array(rim))
        return np.asarray(cells == OBSTACLE)

    known = np.full([finer * count for count in frame.shape], OBSTACLE, np.uint8)
    known[reached((padded & (IS_OBSTACLE | IS_OUTSIDE)) == 0)] = FREE
    is_entered = reached((padded & IS_ENTRY) > 0)
    for target in targets:
        codes = known.copy()
        codes[reached(np.pad(target, around))] = TARGET
        codes[is_entered] |= _ENTERED
        yield codes


def possible_codes(possible: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the codes of `possible_cells`."""
    return np.ascontiguousarray(possible & np.uint8(_ENTERED - 1))


def entered_cells(possible: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which cells of `possible_cells` a voxel of the entry region reaches."""
    return np.asarray((possible & _ENTERED) > 0)


def _rasterized(
    volume: LabelVolume,
    codes: NDArray[np.uint8],
    growths: Growths,
    frame: SpaceFrame,
    refinement: int,
    rim: NDArray[np.int64] | None = None,
) -> NDArray[np.uint8]:
    """Return codes in the voxels of a lattice; the arrays have `rim` voxels more on each side than the file."""
    nx, ny, nz = (count * refinement for count in frame.shape)
    first = volume.world(-rim if rim is not None else np.zeros(3))
    x, y, z = frame.local(first).tolist()
    directions = (volume.affine[:3, :3] / volume.sizes_mm).T @ frame.axes.T
    return _ppvi.lattice_codes(
        codes=np.ascontiguousarray(codes),
        obstacles=np.ascontiguousarray(growths.kinds),
        growth_mm=list(growths.growths_mm),
        axes=directions.tolist(),
        sizes_mm=volume.sizes_mm.tolist(),
        origin_mm=[x, y, z],
        count=[nx, ny, nz],
        size_mm=frame.spacing_mm / refinement,
    )
