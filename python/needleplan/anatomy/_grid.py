"""An anatomy on the grid points of its lattice.

The target as the user gave it, in the frame of a lattice: a ball, or voxels of the file.

Executions end in it, and not in voxels of the lattice: those lie in the target only in part at its rim, and may be
blocked where an obstacle is beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._file import Region, Sphere
from needleplan.anatomy._frame import file_distances, frame_of, nearest_labels, refinement_of
from needleplan.anatomy._loss import LatticeLoss, lattice_loss
from needleplan.anatomy._voxels import (
    FREE,
    IS_ENTRY,
    IS_OBSTACLE,
    IS_OUTSIDE,
    OBSTACLE,
    OUTSIDE,
    TARGET,
    Growths,
    lattice_voxels,
    possible_cells,
)
from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._anatomy import Anatomy
    from needleplan.anatomy._frame import FileDistances, SpaceFrame
    from needleplan.anatomy._volume import LabelVolume

__all__ = ["FREE", "OBSTACLE", "OUTSIDE", "TARGET", "AnatomyGrid", "TargetBody", "grid_of", "grids_of"]


@dataclass(frozen=True, eq=False)
class TargetBody(ShortRepr):
    """The volume of a target in a frame.

    `ball`: centre and radius (mm), shape (4,); None if the target is a label. For a label, `inside`, shape (a, b, c),
    is 1 in the voxels of the target, and `rows`, shape (3, 4), leads from a point p (mm) to the indices floor(`rows`
    (p, 1)) of its voxel.
    """

    ball: tuple[float, float, float, float] | None
    rows: NDArray[np.float64]
    inside: NDArray[np.uint8]

    @classmethod
    def of_ball(cls, frame: SpaceFrame, ball: Sphere) -> TargetBody:
        """Return the target that is a ball.

        Parameters
        ----------
        frame : SpaceFrame
            Frame of the result.
        ball : Sphere
            Ball in the coordinates of the volume (mm).

        Returns
        -------
        TargetBody
        """
        x, y, z = frame.local(ball.center_mm).tolist()
        return cls((x, y, z, ball.radius_mm), np.zeros((3, 4)), np.zeros((0, 0, 0), np.uint8))

    @classmethod
    def of_anatomy(cls, anatomy: Anatomy, frame: SpaceFrame, region: Region) -> TargetBody:
        """Return a target of an anatomy.

        Parameters
        ----------
        anatomy : Anatomy
            The anatomy.
        frame : SpaceFrame
            Frame of the result.
        region : str, int or Sphere
            The target: a label or a ball.

        Returns
        -------
        TargetBody
        """
        volume = anatomy.volume
        if isinstance(region, Sphere):
            return cls.of_ball(frame, region)
        inside = anatomy.inside(region)
        places = np.argwhere(inside)
        first, last = places.min(0), places.max(0) + 1
        # Place in the volume of a point p of the frame: inverse of (affine), applied to o + p E; the centre of voxel
        # (0, 0, 0) has the place 0, so that 1/2 is added.
        linear = np.linalg.inv(volume.affine[:3, :3]) @ frame.axes.T
        offset = volume.voxels(frame.origin_mm) + 0.5 - first
        cropped = inside[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        return cls(None, np.column_stack([linear, offset]), np.ascontiguousarray(cropped, np.uint8))

    def moved(self, corner_mm: NDArray[np.float64]) -> TargetBody:
        """Return the target in a frame with its origin at the point `corner_mm` of this frame."""
        if self.ball is not None:
            x, y, z = (np.array(self.ball[:3]) - corner_mm).tolist()
            return replace(self, ball=(x, y, z, self.ball[3]))
        rows = self.rows.copy()
        rows[:, 3] += rows[:, :3] @ corner_mm
        return replace(self, rows=rows)

    def contains(self, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points of the frame (mm), shape (..., 3), lie in the target."""
        if self.ball is not None:
            return np.asarray(((points_mm - self.ball[:3]) ** 2).sum(-1) <= self.ball[3] ** 2)
        return self._is_inside(np.floor(self._places(points_mm)).astype(np.int64))

    def _places(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(points_mm @ self.rows[:, :3].T + self.rows[:, 3])

    def _is_inside(self, voxels: NDArray[np.int64]) -> NDArray[np.bool_]:
        shape = np.array(self.inside.shape)
        within = ((voxels >= 0) & (voxels < shape)).all(-1)
        at = tuple(np.moveaxis(np.clip(voxels, 0, shape - 1), -1, 0))
        return np.asarray(within & (self.inside[at] > 0))


@dataclass(frozen=True, eq=False)
class AnatomyGrid(ShortRepr):
    """Obstacles, target, entry points and tissues on a lattice of the shape (nx, ny, nz).

    - `voxels`: 0 free, 1 target, 2 obstacle (grown by margin and needle), 3 outside of volume or body, in r^3 voxels
      for each grid point, shape (r nx, r ny, r nz). The centre of voxel (r i, r j, r k) is the grid point (i, j, k).
    - `possible`: codes of the cells of the reachability proof (`possible_cells`).
    - `clearance_mm`: distance to the obstacles without margin, at most 30, shape (nx, ny, nz).
    - `entry`: 0 at grid points without an entry, else the number of the voxel in which the needle enters: 1 is the
      grid point itself, and the other voxels of the grid point follow in the order [x][y][z]; shape (nx, ny, nz).
    - `tissues`: index of the radius in `radii_mm`, shape (nx, ny, nz); index 0 is the radius of the needle.
    - `target`: the target as the user gave it, in which executions end.
    - `loss`: differences between lattice and file; None for a grid from a table file.
    """

    frame: SpaceFrame
    voxels: NDArray[np.uint8]
    possible: NDArray[np.uint8]
    clearance_mm: NDArray[np.float32]
    entry: NDArray[np.uint16]
    tissues: NDArray[np.uint8]
    radii_mm: tuple[float, ...]
    target: TargetBody
    loss: LatticeLoss | None = None

    @property
    def refinement(self) -> int:
        """Number of voxels between two grid points along an axis."""
        return int(self.voxels.shape[0] // self.frame.shape[0])

    @property
    def voxel_mm(self) -> float:
        """Size of a voxel (mm)."""
        return self.frame.spacing_mm / self.refinement

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        """Voxel codes at the grid points, for drawings; a target between grid points is drawn at the nearest ones."""
        every = slice(None, None, self.refinement)
        codes = np.ascontiguousarray(self.voxels[every, every, every])
        if not (codes == TARGET).any():
            nearest = np.floor(np.argwhere(self.voxels == TARGET) / self.refinement + 0.5).astype(np.int64)
            codes[tuple(np.minimum(nearest, np.array(codes.shape) - 1).T)] = TARGET
        return codes

    @cached_property
    def target_points_mm(self) -> NDArray[np.float64]:
        """Centres of the voxels of the target in the frame (mm), shape (n, 3)."""
        return np.asarray(np.argwhere(self.voxels == TARGET) * self.voxel_mm, np.float64)

    def nearest_points(self, points_mm: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the indices of the grid points nearest to points of the frame, (n, 3), moved into the grid."""
        index = np.floor(points_mm / self.frame.spacing_mm + 0.5).astype(np.int64)
        return np.clip(index, 0, np.array(self.frame.shape) - 1)

    def clearance_at(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (mm) of points of the frame, (n, 3), to the obstacles: trilinear between grid points."""
        from scipy import ndimage

        index = points_mm.T / self.frame.spacing_mm
        return np.asarray(ndimage.map_coordinates(self.clearance_mm, index, np.float64, order=1, mode="nearest"))

    def entry_points_mm(self) -> NDArray[np.float64]:
        """Return the first entry point of each run of entry points along x, in the frame (mm), shape (n, 3)."""
        is_entry, r = self.entry > 0, self.refinement
        is_entry[1:] &= self.entry[:-1] == 0
        points = np.argwhere(is_entry.transpose(1, 2, 0))[:, [2, 0, 1]]
        within = np.stack(np.unravel_index(self.entry[tuple(points.T)] - 1, (r, r, r)), -1)
        return np.asarray((points * r + within) * self.voxel_mm, np.float64)


def grid_of(anatomy: Anatomy) -> AnatomyGrid:
    """Return an anatomy with one target on the grid points of its lattice.

    Raises ScenarioError if target or entry region have no free grid point, no tissue connects them, or there are
    several targets (`grids_of`).
    """
    if several := anatomy.regions.targets:
        names = ", ".join(aim.name for aim in several)
        rule = (
            f"has several targets: name one ({names}) by `target_name` in Python or `plan --target-name`, whose table "
            "`view` and `insert` take, or rank entries for all by `needleplan entry`"
        )
        raise ScenarioError(Mistake("anatomy.targets", f"{len(several)} tables", rule), anatomy.source)
    return grids_of(anatomy)[0]


def grids_of(anatomy: Anatomy, within: SpaceFrame | None = None) -> list[AnatomyGrid]:
    """Return an anatomy on the grid points of its lattice, for each target.

    Parameters
    ----------
    anatomy : Anatomy
        The anatomy.
    within : SpaceFrame, optional
        Frame of grids for executions, which need no entry and no target. Default: that of the anatomy.

    Returns
    -------
    list of AnatomyGrid
        They share their frame and all arrays but `voxels`, `possible` and `target`.

    Raises
    ------
    ScenarioError
        As `grid_of`.
    """
    regions, volume = anatomy.regions, anatomy.volume
    aims = [aim.region for aim in regions.aims]
    frame = within or frame_of(anatomy)
    obstacle = np.isin(volume.labels, anatomy.numbers(regions.obstacles))
    distances = file_distances(volume, obstacle, frame)
    outside = np.isin(volume.labels, anatomy.numbers(regions.outside))
    meaning = obstacle * np.uint8(IS_OBSTACLE) + outside * np.uint8(IS_OUTSIDE)
    meaning += anatomy.inside_entries() * np.uint8(IS_ENTRY)
    growths = _growths(anatomy)
    refinement = refinement_of(volume.sizes_mm, frame.spacing_mm)
    targets = [aim if isinstance(aim, Sphere) else anatomy.numbers((aim,))[0] for aim in aims]
    voxels = lattice_voxels(volume, meaning, frame, growths, refinement, targets)
    # Free for all targets, so that all have the same entry points.
    codes = voxels[0] if len(voxels) == 1 else np.maximum.reduce(voxels)
    every = slice(None, None, refinement)
    is_entry = nearest_labels(volume, meaning, frame, IS_OUTSIDE) & IS_ENTRY > 0
    at_points = is_entry & (codes[every, every, every] == FREE)
    entry = _with_entries_between(at_points, volume, (meaning & IS_ENTRY) > 0, frame, codes, distances)
    meaning_of_centres = meaning.copy()
    # The proof holds for the whole of a ball.
    meaning |= anatomy.inside_entries(touched=True) * np.uint8(IS_ENTRY)
    possible = possible_cells(volume, meaning, frame, (anatomy.inside(aim, touched=True) for aim in aims))
    clearance = distances.at_points(volume, frame)
    farthest_mm = max(growths.growths_mm) + math.sqrt(3) * frame.spacing_mm / refinement
    loss = lattice_loss(volume, meaning_of_centres, frame, codes, distances, farthest_mm)
    tissues, radii = _tissues(anatomy, frame)
    grids = [
        AnatomyGrid(
            frame, own, cells, clearance, entry, tissues, radii, TargetBody.of_anatomy(anatomy, frame, aim), loss
        )
        for aim, own, cells in zip(aims, voxels, possible, strict=True)
    ]
    mistakes = [] if within else _mistakes(anatomy, grids)
    if mistakes:
        raise ScenarioError(mistakes, anatomy.source)
    return grids


def _with_entries_between(
    at_points: NDArray[np.bool_],
    volume: LabelVolume,
    region: NDArray[np.bool_],
    frame: SpaceFrame,
    voxels: NDArray[np.uint8],
    distances: FileDistances,
) -> NDArray[np.uint16]:
    """Return `AnatomyGrid.entry`: entries at grid points, and between them where no column beside has a grid point.

    There, the voxel of the entry region of the file with the largest distance to obstacles is taken for each column, so
    that lumens narrower than the spacing have an entry.
    """
    from scipy import ndimage

    entry, r = at_points.astype(np.uint16), voxels.shape[0] // frame.shape[0]
    index = np.argwhere(region)
    places = np.floor(frame.local(volume.world(index)) * (r / frame.spacing_mm) + 0.5).astype(np.int64)
    within = ((places >= 0) & (places < voxels.shape)).all(-1)
    index, places = index[within], places[within]
    points = places // r
    near = ndimage.binary_dilation(np.asarray(at_points.any(0)), np.ones((3, 3), bool))
    chosen = (voxels[tuple(places.T)] == FREE) & ~near[tuple(points[:, 1:].T)]
    index, places, points = index[chosen], places[chosen], points[chosen]
    order = np.argsort(-distances.at(index), kind="stable")
    _, first = np.unique(points[order][:, 1:], axis=0, return_index=True)
    best = order[first]
    a, b, c = (places[best] % r).T
    entry[tuple(points[best].T)] = 1 + (a * r + b) * r + c
    return entry


def _growths(anatomy: Anatomy) -> Growths:
    """Return by how much the obstacles are grown: by their margin and half of the needle."""
    regions, half_mm = anatomy.regions, (anatomy.file.needle.thickness_mm or 0.0) / 2
    margins = [float(regions.margins_mm.get(str(label), regions.margin_mm)) for label in regions.obstacles]
    different = sorted({*margins, regions.margin_mm})
    kinds = np.zeros(65536, np.uint8)
    for number, margin in zip(anatomy.numbers(regions.obstacles), margins, strict=True):
        # A label that is listed twice, by name and number, has the larger margin.
        kinds[number] = max(int(kinds[number]), different.index(margin) + 1)
    return Growths(kinds[anatomy.volume.labels], tuple(margin + half_mm for margin in different))


def _tissues(anatomy: Anatomy, frame: SpaceFrame) -> tuple[NDArray[np.uint8], tuple[float, ...]]:
    curvature = anatomy.regions.curvature
    radii = (anatomy.file.needle.curvature_radius_mm, *(tissue.radius_mm for tissue in curvature))
    numbers = np.zeros(65536, np.uint8)
    for place, tissue in enumerate(curvature, start=1):
        numbers[anatomy.numbers((tissue.label,))] = place
    tissues = nearest_labels(anatomy.volume, numbers[anatomy.volume.labels], frame, 0)
    return tissues, radii


def _mistakes(anatomy: Anatomy, grids: list[AnatomyGrid]) -> list[Mistake]:
    """Return the mistakes that only the lattice shows."""
    from scipy import ndimage

    regions, frame, entry = anatomy.regions, grids[0].frame, grids[0].entry
    mistakes = []
    smaller = [f"a margin below {regions.largest_margin_mm:g} mm"] if regions.largest_margin_mm > 0 else []
    hint = f"take {' or '.join([*smaller, f'a spacing below {frame.spacing_mm:g} mm'])}"
    aims = list(zip(regions.aim_keys, (aim.region for aim in regions.aims), grids, strict=True))
    places = [(key, region, grid.voxels == TARGET) for key, region, grid in aims]
    for key, region, there in (*places, ("entry", regions.entry_text, entry)):
        if not there.any():
            rule = f"no voxel of the lattice lies in it, apart from obstacles, their margin and outside: {hint}"
            mistakes.append(Mistake(f"anatomy.{key}", str(region), rule))
    if mistakes:
        return mistakes
    bodies, _ = ndimage.label(grids[0].codes != OUTSIDE, structure=np.ones((3, 3, 3)))
    for key, region, grid in aims:
        if not {*np.unique(bodies[entry > 0])} & {*np.unique(bodies[grid.codes == TARGET])}:
            if regions.targets:
                rule = "lies in another body than anatomy.entry: labels in anatomy.outside separate them"
                mistakes.append(Mistake(f"anatomy.{key}", str(region), rule))
            else:
                rule = "lies in another body than anatomy.target: labels in anatomy.outside separate them"
                mistakes.append(Mistake("anatomy.entry", regions.entry_text, rule))
    return mistakes
