"""A labelled volume and its place in the body.

World coordinates are RAS mm: x to the right, y to the front, z to the head of the patient. Voxel (i, j, k) has its
centre at

    p = A (i, j, k, 1),

where A is the affine matrix, 4 x 4. Its three first columns are perpendicular, and their lengths are the voxel sizes.

Bytes of volume files, read within the limits that the header and the memory set.

A header states the number of bytes of the voxels. They are compared with three limits before anything is allocated: the
memory, the size of the file, and, if it is compressed, 1032 times its size, the largest ratio of deflate.
"""

from __future__ import annotations

import gzip
import os
import zlib
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "LabelVolume",
    "counted_bytes",
    "exact_bytes",
    "is_label",
    "labels_present",
    "largest_bytes",
    "orientation_mistakes",
    "require_size",
    "whole_labels",
]


# Largest |cosine| of the angle between two axes of a volume that count as perpendicular.
_PERPENDICULAR = 1e-3
# Accepted range of the voxel size (mm); other sizes are in another unit.
_SIZES_MM = (0.01, 100.0)
# Largest label: labels are stored as 16-bit numbers.
_LARGEST_LABEL = 65535
# Largest number of digits of a label; Python refuses to convert more than some thousand.
_MOST_DIGITS = 10
# Number of voxels that are counted at once.
_COUNTED = 2**20
# Memory (bytes) that is assumed if the system does not tell it.
_ASSUMED_MEMORY = 8 * 2**30


@dataclass(frozen=True, eq=False)
class LabelVolume(ShortRepr):
    """A volume of labels.

    Parameters
    ----------
    labels : numpy.ndarray
        Label of each voxel, uint16, shape (ni, nj, nk).
    affine : numpy.ndarray
        Matrix A from voxel indices to RAS mm, shape (4, 4).
    names : dict, optional
        Labels by name, as far as the file contains names. Default: none.
    source : str, optional
        Name of the file in messages. Default: no name.

    Raises
    ------
    ScenarioError
        If the affine is not finite or singular, or its axes are not perpendicular.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.anatomy import LabelVolume
    >>> volume = LabelVolume(np.zeros((4, 5, 6), np.uint16), np.diag([2.0, 2.0, 3.0, 1.0]))
    >>> volume.sizes_mm.tolist()
    [2.0, 2.0, 3.0]
    >>> volume.world([[1, 1, 1]]).tolist()
    [[2.0, 2.0, 3.0]]
    """

    labels: NDArray[np.uint16]
    affine: NDArray[np.float64]
    names: dict[str, int] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        mistakes = orientation_mistakes(np.asarray(self.affine))
        if mistakes:
            raise ScenarioError(mistakes, self.source)

    @property
    def sizes_mm(self) -> NDArray[np.float64]:
        """Size of a voxel along i, j and k (mm)."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    def world(self, voxels: ArrayLike) -> NDArray[np.float64]:
        """Return the RAS positions (mm) of voxel indices, which need not be whole; shape (..., 3)."""
        return np.asarray(np.asarray(voxels, np.float64) @ self.affine[:3, :3].T + self.affine[:3, 3])

    def voxels(self, world_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the voxel indices, not rounded, of RAS positions (mm); shape (..., 3)."""
        inverse = np.linalg.inv(self.affine[:3, :3])
        return np.asarray((np.asarray(world_mm, np.float64) - self.affine[:3, 3]) @ inverse.T)

    def near(self, points_mm: NDArray[np.float64], more_mm: float) -> tuple[NDArray[np.int64], tuple[slice, ...]]:
        """Return the box of voxels that contains points with a margin `more_mm` on each side.

        Parameters
        ----------
        points_mm : numpy.ndarray
            Points in RAS (mm), shape (n, 3).
        more_mm : float
            Length (mm).

        Returns
        -------
        tuple
            Index of the first voxel, shape (3,), and a slice along each axis; within the volume.
        """
        reach, more = self.voxels(points_mm), more_mm / self.sizes_mm + 1
        low = np.clip(np.floor(reach.min(0) - more), 0, self.labels.shape).astype(np.int64)
        high = np.clip(np.ceil(reach.max(0) + more) + 1, 0, self.labels.shape).astype(np.int64)
        return low, tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))


def orientation_mistakes(affine: NDArray[np.float64]) -> list[Mistake]:
    """Return the mistakes of an affine matrix; an empty list if it is the matrix of a volume."""
    shown = " ".join(f"{number:.4g}" for number in np.asarray(affine, np.float64)[:3].ravel())
    if affine.shape != (4, 4) or not np.isfinite(affine).all():
        return [Mistake("affine", shown, "must be finite: the file does not say where its voxels are")]
    axes = affine[:3, :3].astype(np.float64)
    sizes = np.linalg.norm(axes, axis=0)
    if not ((sizes >= _SIZES_MM[0]) & (sizes <= _SIZES_MM[1])).all():
        rule = f"voxel sizes must be from {_SIZES_MM[0]:g} to {_SIZES_MM[1]:g} mm; is the file in another unit?"
        return [Mistake("affine", " x ".join(f"{size:.4g}" for size in sizes), rule)]
    cosines = (axes / sizes).T @ (axes / sizes) - np.eye(3)
    if abs(cosines).max() > _PERPENDICULAR:
        rule = "the axes must be perpendicular; resample the volume (a tilted CT gantry, or a singular matrix)"
        return [Mistake("affine", shown, rule)]
    return []


def is_label(word: str) -> bool:
    """Return whether a word is the number of a label."""
    return word.isdecimal() and len(word) <= _MOST_DIGITS


def whole_labels(values: NDArray[np.generic], source: str) -> NDArray[np.uint16]:
    """Return voxel values as labels. Raises ScenarioError if they are not whole numbers from 0 to 65535."""
    if values.dtype == np.uint8 or values.dtype == np.uint16:
        return values.astype(np.uint16, copy=False)
    if values.dtype.kind not in "iufb":
        raise ScenarioError(Mistake("voxels", str(values.dtype), "must be numbers"), source)
    low, high = values.min(), values.max()
    if not (low >= 0 and high <= _LARGEST_LABEL):  # also false for NaN
        rule = f"must be labels, whole numbers from 0 to {_LARGEST_LABEL}; is this an image and no segmentation?"
        raise ScenarioError(Mistake("voxels", f"{low:g} to {high:g}", rule), source)
    labels = values.astype(np.uint16)
    if values.dtype.kind == "f" and (wrong := labels != values).any():
        rule = "must be labels, whole numbers; resample segmentations with the nearest neighbour"
        raise ScenarioError(Mistake("voxels", f"{values[wrong][0]:g}", rule), source)
    return labels


def labels_present(labels: NDArray[np.uint16]) -> NDArray[np.int64]:
    """Return the labels of a volume, sorted; by counting, which takes a tenth of the time of a sort."""
    flat, counts = labels.ravel(order="K"), np.zeros(_LARGEST_LABEL + 1, np.int64)
    for start in range(0, flat.size, _COUNTED):
        counts += np.bincount(flat[start : start + _COUNTED], minlength=counts.size)
    return np.flatnonzero(counts)


def largest_bytes() -> int:
    """Return the largest number of bytes of the voxels of a file: a quarter of the memory of the machine."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
    except (AttributeError, ValueError, OSError):
        return _ASSUMED_MEMORY // 4


# Bytes that planning needs for each voxel beside those of the file: labels (2), a sorted copy (2), meanings, obstacles,
# codes and their copies (8).
_PLANNING_BYTES = 12
# Largest ratio of the sizes of a text and its deflate stream.
_DEFLATE_RATIO = 1032


def counted_bytes(shape: Sequence[int], itemsize: int, key: str, source: str) -> int:
    """Return the number of bytes of the voxels of a volume.

    Raises ScenarioError if the volume is not 3-D, is empty, or planning in it needs more than half of the memory. `key`
    names the shape in messages.
    """
    sizes = [int(size) for size in shape]
    shown = " x ".join(map(str, sizes))
    if len(sizes) > 3 and all(size == 1 for size in sizes[3:]):
        sizes = sizes[:3]
    if len(sizes) != 3:
        rule = f"must be a volume of 3 dimensions, not {len(sizes)}; extract one volume, or export one layer"
        raise ScenarioError(Mistake(key, shown, rule), source)
    if min(sizes) < 1:
        raise ScenarioError(Mistake(key, shown, "must be positive"), source)
    voxels = sizes[0] * sizes[1] * sizes[2]
    needed, most = voxels * (itemsize + _PLANNING_BYTES), 2 * largest_bytes()
    if needed > most:
        rule = (
            f"needs {needed / 2**30:.1f} GiB to plan in; at most {most / 2**30:.1f} GiB fit here: crop or resample it"
        )
        raise ScenarioError(Mistake(key, shown, rule), source)
    return voxels * itemsize


def require_size(count: int, stored: int, compressed: bool, key: str, source: str) -> None:
    """Raise ScenarioError if a file of `stored` bytes cannot contain `count` bytes."""
    most = stored * _DEFLATE_RATIO if compressed else stored
    if count > most:
        rule = f"needs {count:,} bytes, but the file holds at most {most:,}: it is truncated, or its header is damaged"
        raise ScenarioError(Mistake(key, "", rule), source)


def exact_bytes(stream: IO[bytes], count: int, source: str, *, compressed: bool) -> bytes:
    """Read the rest of a stream, which must have exactly `count` bytes after decompression if `compressed`.

    Reads at most `count` + 1 bytes. Raises ScenarioError if the stream is shorter or longer, or is damaged.
    """
    reader: IO[bytes] = gzip.GzipFile(fileobj=stream) if compressed else stream  # type: ignore[assignment]
    try:
        data = reader.read(count)
        more = reader.read(1)  # at the end, gzip compares the checksum
    except (EOFError, OSError, zlib.error) as error:
        raise ScenarioError(f"is damaged or truncated: {error}", source) from None
    if len(data) < count:
        raise ScenarioError(f"is truncated: {len(data):,} bytes where its header says {count:,}", source)
    if more:
        raise ScenarioError(f"holds more than the {count:,} bytes that its header says", source)
    return data
