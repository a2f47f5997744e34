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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan import _ppvi

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._file import Sphere
    from needleplan.anatomy._frame import SpaceFrame
    from needleplan.anatomy._volume import LabelVolume

__all__ = [
    "FREE",
    "IS_ENTRY",
    "IS_OBSTACLE",
    "IS_OUTSIDE",
    "IS_TARGET",
    "OBSTACLE",
    "OUTSIDE",
    "TARGET",
    "Growths",
    "entered_cells",
    "lattice_voxels",
    "possible_cells",
    "possible_codes",
]

FREE, TARGET, OBSTACLE, OUTSIDE = 0, 1, 2, 3
# Bits of the meaning of a voxel of the file.
IS_OBSTACLE, IS_OUTSIDE, IS_TARGET, IS_ENTRY = 1, 2, 4, 8
# Largest number of cells of a proof between two grid points along an axis, and in all: its time grows with the cells.
_MOST_PROOF_REFINEMENT, _MOST_PROOF_CELLS = 2, 4_000_000
# Bit of a cell that a voxel of the entry region reaches, beside its code.
_ENTERED = 4


@dataclass(frozen=True, eq=False)
class Growths:
    """How far the obstacles of a file are grown: the kind of each voxel, 0 for none, and the mm of each other kind."""

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
    ball: Sphere | None = None,
) -> NDArray[np.uint8]:
    """Return the codes of the voxels of a lattice, shape `refinement` times that of the frame.

    `meaning` holds the bits of the voxels of the file, `growths` how far obstacles are grown, `ball` the target if it
    is no label.
    """
    target = (meaning & IS_TARGET) > 0
    codes = np.zeros(meaning.shape, np.uint8)
    codes[target] = TARGET
    codes[(meaning & IS_OUTSIDE) > 0] = OUTSIDE
    found = _rasterized(volume, codes, growths, frame, refinement)
    size = frame.spacing_mm / refinement
    if ball is None:
        center = volume.world(np.argwhere(target).mean(0)) if target.any() else None
    else:
        _mark_ball(frame.local(ball.center_mm), ball.radius_mm, size, found)
        center = np.array(ball.center_mm)
    if center is not None and not (found == TARGET).any():
        at = np.floor(frame.local(center) / size + 0.5).astype(np.int64)
        if ((at >= 0) & (at < found.shape)).all() and found[tuple(at)] == FREE:
            found[tuple(at)] = TARGET
    return found


def _mark_ball(center_mm: NDArray[np.float64], radius_mm: float, size_mm: float, found: NDArray[np.uint8]) -> None:
    """Make the free voxels of a lattice with their centre in a ball the target, and no others."""
    low = np.clip(np.floor((center_mm - radius_mm) / size_mm), 0, found.shape).astype(np.int64)
    high = np.clip(np.ceil((center_mm + radius_mm) / size_mm) + 1, 0, found.shape).astype(np.int64)
    box = found[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    axes = np.meshgrid(*[np.arange(a, b) * size_mm for a, b in zip(low, high, strict=True)], indexing="ij")
    found[found == TARGET] = FREE
    box[(box == FREE) & (np.linalg.norm(np.stack(axes, -1) - center_mm, axis=-1) <= radius_mm)] = TARGET


def possible_cells(volume: LabelVolume, meaning: NDArray[np.uint8], frame: SpaceFrame) -> NDArray[np.uint8]:
    """Return the codes of the cells of the reachability proof; a cell has the spacing of the frame or half of it.

    The code of a cell is target or free if any voxel of the file in the cell is target or free, else obstacle. 4 is
    added if a voxel of the entry region reaches the cell.
    """
    finer = _MOST_PROOF_REFINEMENT
    if math.prod(frame.shape) * finer**3 > _MOST_PROOF_CELLS:
        finer = 1
    # Cells at the rim reach beyond the file.
    rim = [math.ceil(frame.spacing_mm / size) + 1 for size in volume.sizes_mm]
    padded = np.pad(meaning, [(count, count) for count in rim], constant_values=IS_OUTSIDE)
    nothing = np.zeros(padded.shape, np.uint8)

    def reached(bits: NDArray[np.bool_]) -> NDArray[np.bool_]:
        cells = _rasterized(volume, nothing, _not_grown(bits), frame, finer, np.array(rim))
        return np.asarray(cells == OBSTACLE)

    found = np.full([finer * count for count in frame.shape], OBSTACLE, np.uint8)
    found[reached((padded & (IS_OBSTACLE | IS_OUTSIDE)) == 0)] = FREE
    found[reached((padded & IS_TARGET) > 0)] = TARGET
    found[reached((padded & IS_ENTRY) > 0)] |= _ENTERED
    return found


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
