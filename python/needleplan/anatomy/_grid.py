"""An anatomy on the grid points of its lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._file import Sphere
from needleplan.anatomy._frame import frame_of, nearest_labels, signed_distances
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._anatomy import Anatomy
    from needleplan.anatomy._frame import SpaceFrame

__all__ = ["FREE", "OBSTACLE", "OUTSIDE", "TARGET", "AnatomyGrid", "grid_of"]

FREE, TARGET, OBSTACLE, OUTSIDE = 0, 1, 2, 3


@dataclass(frozen=True, eq=False)
class AnatomyGrid:
    """What is at the grid points of a frame; all arrays have its shape (nx, ny, nz).

    `codes`: 0 free, 1 target, 2 obstacle (with its margin), 3 outside of volume or body. `clearance_mm`: distance to
    the obstacles without margin, at most 30. `entry`: grid points of the entry region. `tissues`: index of the radius
    in `radii_mm`; index 0 is the radius of the needle.
    """

    frame: SpaceFrame
    codes: NDArray[np.uint8]
    clearance_mm: NDArray[np.float32]
    entry: NDArray[np.bool_]
    tissues: NDArray[np.uint8]
    radii_mm: tuple[float, ...]

    def entry_points(self) -> NDArray[np.int64]:
        """Return the indices of the entry points, shape (n, 3): of each line along the axis, the first free point."""
        first = self.entry.argmax(0)
        y, z = np.nonzero(self.entry.any(0))
        return np.stack([first[y, z], y, z], -1)


def grid_of(anatomy: Anatomy) -> AnatomyGrid:
    """Return an anatomy on the grid points of its lattice.

    Raises ScenarioError if target or entry region have no free grid point, or no tissue connects them.
    """
    regions, volume = anatomy.file.anatomy, anatomy.volume
    frame = frame_of(anatomy)
    obstacle = np.isin(volume.labels, anatomy.numbers(regions.obstacles))
    clearance = signed_distances(volume, obstacle, frame)
    # Bits of the meaning of each voxel, so that the volume is resampled once.
    meaning = obstacle * np.uint8(1) + np.isin(volume.labels, anatomy.numbers(regions.outside)) * np.uint8(2)
    meaning += anatomy.inside(regions.target) * np.uint8(4) + anatomy.inside(regions.entry) * np.uint8(8)
    found = nearest_labels(volume, meaning.astype(np.uint8), frame, 2)
    codes = np.full(frame.shape, FREE, np.uint8)
    codes[(found & 4) > 0] = TARGET
    closed = (found & 1) > 0
    if regions.margin_mm > 0:
        closed |= clearance <= regions.margin_mm
    codes[closed] = OBSTACLE
    codes[(found & 2) > 0] = OUTSIDE
    entry = ((found & 8) > 0) & (codes == FREE)
    grid = AnatomyGrid(frame, codes, clearance, entry, *_tissues(anatomy, frame))
    mistakes = _mistakes(anatomy, grid)
    if mistakes:
        raise ScenarioError(mistakes, anatomy.source)
    return grid


def _tissues(anatomy: Anatomy, frame: SpaceFrame) -> tuple[NDArray[np.uint8], tuple[float, ...]]:
    curvature = anatomy.file.anatomy.curvature
    radii = (anatomy.file.needle.curvature_radius_mm, *(each.radius_mm for each in curvature))
    numbers = np.zeros(65536, np.uint8)
    for place, each in enumerate(curvature, start=1):
        numbers[anatomy.numbers((each.label,))] = place
    tissues = nearest_labels(anatomy.volume, numbers[anatomy.volume.labels], frame, 0)
    return tissues, radii


def _mistakes(anatomy: Anatomy, grid: AnatomyGrid) -> list[Mistake]:
    """Return the mistakes that only the lattice shows."""
    from scipy import ndimage

    regions, spacing = anatomy.file.anatomy, anatomy.file.lattice.spacing_mm
    found = []
    if isinstance(regions.target, Sphere) and regions.target.radius_mm < spacing:
        shown, rule = f"{regions.target.radius_mm:g}", f"must be at least lattice.spacing_mm = {spacing:g}"
        found.append(Mistake("anatomy.target.radius_mm", shown, rule))
    hint = f"take a margin below {regions.margin_mm:g} mm, or a spacing below {spacing:g} mm"
    for key, there in (("target", grid.codes == TARGET), ("entry", grid.entry)):
        if not there.any() and not (key == "target" and found):
            rule = f"no grid point of the lattice lies in it, apart from obstacles, their margin and outside: {hint}"
            found.append(Mistake(f"anatomy.{key}", str(getattr(regions, key)), rule))
    if found:
        return found
    bodies, _ = ndimage.label(grid.codes != OUTSIDE, structure=np.ones((3, 3, 3)))
    if not {*np.unique(bodies[grid.entry])} & {*np.unique(bodies[grid.codes == TARGET])}:
        rule = "lies in another body than anatomy.target: labels in anatomy.outside separate them"
        found.append(Mistake("anatomy.entry", str(regions.entry), rule))
    return found
