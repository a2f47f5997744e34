"""The common grid of the structures of a case: the voxels of the finest file, extended to all structures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._volume import counted_bytes
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._masks import Structure

__all__ = ["CommonGrid", "TargetVoxels"]

# Largest difference, in voxels, between grids that count as the same.
_SAME_VOXELS = 1e-2


@dataclass(frozen=True, eq=False)
class CommonGrid:
    """A grid of voxels: matrix from voxels to RAS mm, and shape."""

    affine: NDArray[np.float64]
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, structures: Sequence[Structure]) -> CommonGrid:
        """Return the grid of structures. Raises ScenarioError if grids do not overlap or the memory is too small."""
        finest = min(structures, key=lambda each: each.voxel_mm3)
        grid, mistakes, boxes, files = cls(finest.affine, finest.shape), [], [], []
        for structure in structures:
            low, high = grid._box(structure, np.zeros(3), np.array(structure.shape))
            if (high <= 0).any() or (low >= grid.shape).any():
                rule = f"its grid does not overlap with that of {finest.source}"
                mistakes.append(Mistake(structure.source, "", rule))
            files.append((low, high))
            boxes.append(grid._box(structure, structure.corner, structure.corner + structure.inside.shape))
        if mistakes := list(dict.fromkeys(mistakes)):
            sources = {structure.source for structure in structures}
            if len(mistakes) == len(sources) - 1 > 1:
                mistakes = [Mistake(finest.source, "", "its grid does not overlap with that of any other file")]
            raise ScenarioError(mistakes)
        # One voxel around the structures, but none that no file has: there, the body is cut and has no skin.
        (start, end), (first, last) = _whole_voxels(boxes), _whole_voxels(files)
        start, end = np.maximum(start - 1, first), np.minimum(end + 1, last)
        affine = finest.affine.copy()
        affine[:3, 3] += affine[:3, :3] @ start
        ni, nj, nk = (int(number) for number in end - start)
        counted_bytes((ni, nj, nk), 2, "voxels of the case", finest.source)
        return cls(affine, (ni, nj, nk))

    def voxels(self, world_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the voxel indices, not rounded, of RAS positions (mm), shape (..., 3)."""
        return np.asarray((world_mm - self.affine[:3, 3]) @ np.linalg.inv(self.affine[:3, :3]).T)

    def world(self, voxels: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return the RAS positions (mm) of voxel indices, shape (..., 3)."""
        return np.asarray(np.asarray(voxels, np.float64) @ self.affine[:3, :3].T + self.affine[:3, 3])

    def contains(self, world_mm: Sequence[float]) -> bool:
        """Return whether a position lies in a voxel."""
        place = np.floor(self.voxels(np.array(world_mm)) + 0.5)
        return bool(((place >= 0) & (place < self.shape)).all())

    def same(self, structure: Structure) -> bool:
        """Return whether the volume of a structure has the voxel size and axes of this grid, and is aligned with it."""
        step = np.linalg.inv(self.affine[:3, :3]) @ structure.affine[:3, :3]
        offset = self.voxels(structure.affine[:3, 3])
        reach = abs(step - np.eye(3)) @ np.array(structure.shape)
        return bool(reach.max() < _SAME_VOXELS and abs(offset - np.round(offset)).max() < _SAME_VOXELS)

    def box(self, structure: Structure) -> tuple[tuple[slice, slice, slice], NDArray[np.bool_]]:
        """Return the box of the grid around a structure (slices), and the mask of its voxels with a centre in it."""
        low, high = self._box(structure, structure.corner, structure.corner + structure.inside.shape)
        first = np.maximum(np.floor(low + 0.5), 0).astype(np.int64)
        last = np.minimum(np.ceil(high + 0.5), self.shape).astype(np.int64)
        if self.same(structure):
            start = np.round(self.voxels(structure.affine[:3, 3])).astype(np.int64) + structure.corner
            return _slices(start, start + structure.inside.shape), structure.inside
        j, k = (np.arange(a, b) for a, b in zip(first[1:], last[1:], strict=True))
        mask = np.zeros(tuple(last - first), bool)
        inverse = np.linalg.inv(structure.affine[:3, :3]).T
        for number, i in enumerate(range(int(first[0]), int(last[0]))):
            centres = self.world(np.stack(np.meshgrid([i], j, k, indexing="ij"), -1)[0])
            place = np.floor((centres - structure.affine[:3, 3]) @ inverse + 0.5).astype(np.int64) - structure.corner
            within = ((place >= 0) & (place < structure.inside.shape)).all(-1)
            mask[number][within] = structure.inside[tuple(place[within].T)]
        return _slices(first, last), mask

    def _box(
        self, structure: Structure, first: NDArray[np.generic], last: NDArray[np.generic]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the box, in the voxels of this grid, around the voxels of a structure from `first` to `last`."""
        corners = np.stack(np.meshgrid(*np.stack([first, last], -1).astype(np.float64), indexing="ij"), -1) - 0.5
        world = corners.reshape(-1, 3) @ structure.affine[:3, :3].T + structure.affine[:3, 3]
        places = self.voxels(world) + 0.5
        return places.min(0), places.max(0)


def _whole_voxels(boxes: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> tuple[NDArray[np.int64], ...]:
    """Return the first voxels and the ends of the box around boxes."""
    low = np.floor(np.min([box[0] for box in boxes], axis=0) + _SAME_VOXELS)
    high = np.ceil(np.max([box[1] for box in boxes], axis=0) - _SAME_VOXELS)
    return low.astype(np.int64), high.astype(np.int64)


def _slices(first: NDArray[np.int64], last: NDArray[np.int64]) -> tuple[slice, slice, slice]:
    i, j, k = (slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
    return i, j, k


@dataclass(frozen=True, eq=False)
class TargetVoxels:
    """Positions (RAS mm) in the target and next to it, shape (n, 3), which an organ may hold."""

    points_mm: NDArray[np.float64]

    def is_in(self, structure: Structure) -> bool:
        """Return whether a structure holds one of the positions."""
        inverse = np.linalg.inv(structure.affine[:3, :3]).T
        place = np.floor((self.points_mm - structure.affine[:3, 3]) @ inverse + 0.5).astype(np.int64) - structure.corner
        within = ((place >= 0) & (place < structure.inside.shape)).all(-1)
        return bool(structure.inside[tuple(place[within].T)].any())
