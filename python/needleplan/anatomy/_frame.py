"""The frame of the lattice, and the resampling of a volume into it.

The axis x leads from the centroid of the entry region to the centroid of the target, or of all targets; y and z are
across it. A point q
of the frame has the RAS position p = o + q E, where the rows of E are the axes.

**Extent.** Along x: from the first voxel of the entry region to the last of the target. Across: a path with tangents
within the cone (half angle t) and a curvature of at most 1/R leaves the convex hull of entry region and target by at
most

    min(L tan(t) / 2,  R - sqrt(R^2 - L^2 / 4)),

where L bounds the chord; the second is the sagitta of an arc over the chord (Schur's theorem), for L < 2 R. So no path
of the model, without noise, is cut off.

**Resampling.** Tissues and the entry region: those of the nearest voxel at a grid point; `_voxels` has the rest.
Distances to obstacles: scipy's Euclidean distance transform of the
volume with its voxel sizes, trilinear between voxels. The transform measures between centres of voxels, so half of the
smallest voxel size is taken off on both sides of the surface.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._volume import largest_bytes
from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from needleplan.anatomy._anatomy import Anatomy
    from needleplan.anatomy._file import SpaceLattice
    from needleplan.anatomy._volume import LabelVolume

__all__ = [
    "FileDistances",
    "SpaceFrame",
    "file_distances",
    "frame_of",
    "nearest_labels",
    "refinement_of",
]

# Anatomical directions against and along R, A and S.
_LETTERS = (("L", "R"), ("P", "A"), ("I", "S"))
# Largest |cosine| of the angle between the insertion axis and S; beyond, z is made from A instead.
_STEEP = 0.9
# Largest number of states of a spacing that is chosen: some ten seconds of a solve with two processors.
_MOST_STATES = 150_000_000
# Bytes of a state in the tables: value, action and success.
_BYTES_OF_TABLE = 7
# Bytes of a voxel of the file in the distance transform of scipy: indices of the nearest voxel, differences, distances.
_BYTES_OF_DISTANCES = 60
# Bytes of memory for each grid point of the lattice, for each of its voxels, and for each state of the slices of a
# step, which a solve keeps.
_BYTES_A_POINT, _BYTES_A_VOXEL, _BYTES_A_STATE = 16, 4, 16
# Range of the size (mm) of voxels of the lattice, which otherwise is that of the file. Coarser ones close passages of
# the file, finer ones take more time and are below the accuracy of a segmentation.
_FINEST_MM, _COARSEST_MM = 0.25, 0.5
# Largest number of voxels between two grid points along an axis.
_MOST_REFINEMENT = 8
# Largest distance (mm); larger ones are set to it.
_FARTHEST_MM = 30.0


@dataclass(frozen=True, eq=False)
class SpaceFrame(ShortRepr):
    """Axes and grid of a lattice.

    - `origin_mm`: grid point 0 in RAS mm, shape (3,).
    - `axes`: rows are the unit vectors of x, y and z in RAS, shape (3, 3).
    - `spacing_mm`: distance of grid points.
    - `shape`: number of grid points along x, y and z.

    `local` moves positions from RAS to the lattice, and `world` back. A direction d in RAS is `axes @ d` in the
    lattice; a direction t of the lattice is `t @ axes` in RAS.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.anatomy import SpaceFrame
    >>> axes = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x leads to P, y to R, z to S
    >>> frame = SpaceFrame(np.array([10.0, 80.0, -5.0]), axes, 2.0, (30, 20, 20))
    >>> frame.local([14.0, 70.0, 5.0]).tolist()  # from RAS
    [10.0, 4.0, 10.0]
    >>> frame.world([10.0, 4.0, 10.0]).tolist()  # to RAS
    [14.0, 70.0, 5.0]
    >>> (frame.axes @ [0.0, -1.0, 0.0]).tolist()  # the direction P is that of x
    [1.0, 0.0, 0.0]
    >>> frame.letters(0)  # x leads from A to P
    ('A', 'P')
    """

    origin_mm: NDArray[np.float64]
    axes: NDArray[np.float64]
    spacing_mm: float
    shape: tuple[int, int, int]

    def world(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the RAS positions (mm) of points of the frame (mm), shape (..., 3)."""
        return np.asarray(np.asarray(points_mm, np.float64) @ self.axes + self.origin_mm)

    def local(self, world_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the points of the frame (mm) of RAS positions (mm), shape (..., 3)."""
        return np.asarray((np.asarray(world_mm, np.float64) - self.origin_mm) @ self.axes.T)

    @property
    def corners_mm(self) -> NDArray[np.float64]:
        """Corners of a box in RAS (mm) that contains the lattice, shape (8, 3)."""
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        return self.world(corners * self.shape * self.spacing_mm)

    def letters(self, axis: int) -> tuple[str, str]:
        """Return the anatomical directions of the low and of the high end of an axis (0 x, 1 y, 2 z).

        They are R or L, A or P, S or I; two empty texts if the axis is at least 45 degrees from all of them.
        """
        along = self.axes[axis]
        nearest = int(abs(along).argmax())
        if abs(along[nearest]) <= math.cos(math.pi / 4):
            return "", ""
        low, high = _LETTERS[nearest]
        return (low, high) if along[nearest] > 0 else (high, low)

    def to_json(self) -> str:
        """Return the frame as a JSON object; a recording keeps it, because its positions are in the frame."""
        arrays = {"origin_mm": self.origin_mm.tolist(), "axes": self.axes.tolist()}
        return json.dumps({**arrays, "spacing_mm": self.spacing_mm, "shape": list(self.shape)}, indent=1)

    def slice_points(self, number: int) -> NDArray[np.float64]:
        """Return the RAS positions (mm) of the grid points of a slice, shape (ny, nz, 3)."""
        _, ny, nz = self.shape
        y, z = np.meshgrid(np.arange(ny) * self.spacing_mm, np.arange(nz) * self.spacing_mm, indexing="ij")
        return self.world(np.stack([np.full(y.shape, number * self.spacing_mm), y, z], -1))


def frame_of(anatomy: Anatomy) -> SpaceFrame:
    """Return the frame of an anatomy.

    Without `lattice.spacing_mm`, the spacing is the finest with at most 150 million states whose grid, slices and table
    need at most half of the memory.

    Raises ScenarioError if entry region and target are too close for an axis, or the grid and the slices of a step need
    more than half of the memory.
    """
    *finer, last = anatomy.file.lattice.spacings_mm
    for spacing_mm in finer:
        frame = _frame_with(anatomy, spacing_mm)
        states = math.prod(frame.shape) * _directions(anatomy.file.lattice)
        needed = _needed_bytes(anatomy, frame) + states * _BYTES_OF_TABLE
        if states <= _MOST_STATES and needed <= 2 * largest_bytes():
            return frame
    frame = _frame_with(anatomy, last)
    needed, points = _needed_bytes(anatomy, frame), math.prod(frame.shape)
    if needed > 2 * largest_bytes():
        rule = (
            f"a solve of {points * _directions(anatomy.file.lattice):,} states needs {needed / 1e9:.1f} GB, more than "
            "half of the memory: take a larger spacing, or fewer directions"
        )
        raise ScenarioError(Mistake("lattice.spacing_mm", f"{last:g}", rule), anatomy.source)
    return frame


def _needed_bytes(anatomy: Anatomy, frame: SpaceFrame) -> int:
    """Return the memory of a solve, without the table."""
    points, lattice = math.prod(frame.shape), anatomy.file.lattice
    slices = round(lattice.step_of(frame.spacing_mm) / frame.spacing_mm) + 1
    kept = points // frame.shape[0] * _directions(lattice) * slices
    voxels = points * refinement_of(anatomy.volume.sizes_mm, frame.spacing_mm) ** 3
    return points * _BYTES_A_POINT + voxels * _BYTES_A_VOXEL + kept * _BYTES_A_STATE


def _frame_with(anatomy: Anatomy, spacing_mm: float) -> SpaceFrame:
    """Return the frame of an anatomy with a spacing. Raises ScenarioError if entry region and target are too close."""
    regions, lattice = anatomy.regions, anatomy.file.lattice
    entry = np.concatenate([anatomy.points(entrance.region) for entrance in regions.entrances.values()])
    target = np.concatenate([anatomy.points(aim.region) for aim in regions.aims])
    along = target.mean(0) - entry.mean(0)
    if np.linalg.norm(along) < 2 * spacing_mm:
        rule = "its centroid must be at least two lattice.spacing_mm from the centroid of the target"
        raise ScenarioError(Mistake("anatomy.entry", regions.entry_text, rule), anatomy.source)
    x = along / np.linalg.norm(along)
    up = np.array([0.0, 1.0, 0.0] if abs(x[2]) > _STEEP else [0.0, 0.0, 1.0])
    z = up - (up @ x) * x
    z /= np.linalg.norm(z)
    axes = np.stack([x, np.cross(z, x), z])
    starts, ends = entry @ axes.T, target @ axes.T
    ends_at = np.concatenate([starts, ends])
    low, high = ends_at.min(0), ends_at.max(0)
    low[0], high[0] = starts[:, 0].min(), max(ends[:, 0].max(), starts[:, 0].min())
    radius = min([anatomy.file.needle.curvature_radius_mm, *(tissue.radius_mm for tissue in regions.curvature)])
    chord = float(np.linalg.norm(high - low))
    bulge = math.tan(math.radians(lattice.cone_deg)) * (high[0] - low[0]) / 2
    if chord < 2 * radius:
        bulge = min(bulge, radius - math.sqrt(radius**2 - chord**2 / 4))
    low[1:] -= bulge + spacing_mm
    high[1:] += bulge + spacing_mm
    nx, ny, nz = (np.ceil((high - low) / spacing_mm - 1e-6).astype(int) + 1).tolist()
    return SpaceFrame(low @ axes, axes, spacing_mm, (nx, ny, nz))


def _directions(lattice: SpaceLattice) -> int:
    """Return the number of directions of the cone: grid points of a disc."""
    reach = lattice.cone_deg / lattice.directions_deg
    rows = np.arange(-math.floor(reach), math.floor(reach) + 1)
    return int((np.hypot(rows[:, None], rows) <= reach + 1e-9).sum())


def refinement_of(sizes_mm: NDArray[np.float64], spacing_mm: float) -> int:
    """Return the number of voxels of the lattice between two grid points along an axis, from 1 to 8.

    `sizes_mm`: size of a voxel of the file along its axes. Voxels of the lattice are at most as large as the smallest.
    """
    wanted_mm = min(max(float(sizes_mm.min()), _FINEST_MM), _COARSEST_MM)
    return min(math.ceil(spacing_mm / wanted_mm - 1e-9), _MOST_REFINEMENT)


def nearest_labels(volume: LabelVolume, values: NDArray[np.uint8], frame: SpaceFrame, beyond: int) -> NDArray[np.uint8]:
    """Return the values of the nearest voxels at the grid points.

    Parameters
    ----------
    volume : LabelVolume
        Volume with the position of the voxels.
    values : numpy.ndarray
        Value of each voxel, of the shape of the volume.
    frame : SpaceFrame
        Frame with the grid points.
    beyond : int
        Value of grid points outside the volume.

    Returns
    -------
    numpy.ndarray
        Values (uint8), of the shape of the frame.
    """
    sampled = np.full(frame.shape, beyond, np.uint8)
    for number in range(frame.shape[0]):
        index = np.floor(volume.voxels(frame.slice_points(number)) + 0.5).astype(np.int64)
        within = ((index >= 0) & (index < values.shape)).all(-1)
        sampled[number][within] = values[tuple(index[within].T)]
    return sampled


@dataclass(frozen=True, eq=False)
class FileDistances:
    """Distances (mm) of voxels of a file to its obstacles, negative inside, for a box of voxels from `first` on."""

    first: NDArray[np.int64]
    distances_mm: NDArray[np.float32]

    def at(self, index: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the distances (mm, at most 30), shape (n,), of voxels with the indices `index`, shape (n, 3)."""
        if not self.distances_mm.size:
            return np.full(len(index), _FARTHEST_MM, np.float32)
        inside = np.clip(index - self.first, 0, np.array(self.distances_mm.shape) - 1)
        return np.asarray(self.distances_mm[tuple(inside.T)])

    def at_points(self, volume: LabelVolume, frame: SpaceFrame) -> NDArray[np.float32]:
        """Return the distances of the grid points of a frame, at most 30 mm."""
        from scipy import ndimage

        distances = np.full(frame.shape, _FARTHEST_MM, np.float32)
        if self.distances_mm.size:
            for number in range(frame.shape[0]):
                index = np.moveaxis(volume.voxels(frame.slice_points(number)) - self.first, -1, 0)
                distances[number] = ndimage.map_coordinates(self.distances_mm, index, order=1, mode="nearest")
        return distances


def file_distances(volume: LabelVolume, obstacle: NDArray[np.bool_], frame: SpaceFrame) -> FileDistances:
    """Return the distances from the voxels near a frame to the voxels of `obstacle`; empty without such voxels."""
    from scipy import ndimage

    low, box = volume.near(frame.corners_mm, _FARTHEST_MM)
    part = obstacle[box]
    if part.size * _BYTES_OF_DISTANCES > 2 * largest_bytes():
        shown, needed = " x ".join(map(str, part.shape)), part.size * _BYTES_OF_DISTANCES / 2**30
        rule = f"distances to obstacles in {shown} voxels need {needed:.1f} GiB, more than half of the memory: crop it"
        raise ScenarioError(Mistake("anatomy.file", "", rule), volume.source)
    if not part.any():
        return FileDistances(low, np.empty((0, 0, 0), np.float32))
    half = volume.sizes_mm.min() / 2
    sizes = tuple(float(size) for size in volume.sizes_mm)
    outward = np.asarray(ndimage.distance_transform_edt(~part, sampling=sizes), np.float32)
    inward = np.asarray(ndimage.distance_transform_edt(np.pad(part, 1), sampling=sizes), np.float32)[1:-1, 1:-1, 1:-1]
    distances = np.where(part, half - inward, np.minimum(outward - half, _FARTHEST_MM))
    return FileDistances(low, distances.astype(np.float32))
