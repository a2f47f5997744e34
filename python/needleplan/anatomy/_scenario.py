"""What is planned in 3D: the settings of an anatomy file, and the anatomy on the grid points of its lattice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._drawing import Rectangle, draw_slice, target_slices
from needleplan.anatomy._file import AnatomyFile, SpaceNeedle, Sphere
from needleplan.anatomy._grid import AnatomyGrid, grid_of, grids_of
from needleplan.anatomy._voxels import FREE, OUTSIDE, TARGET
from needleplan.artifacts import ShortRepr, digest
from needleplan.errors import Mistake, ScenarioError
from needleplan.plotting import axes_or_new

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needleplan.anatomy._anatomy import Anatomy

__all__ = ["SpaceScenario"]

# Length (mm) after which the tip noise has its stated standard deviation.
_NOISE_LENGTH_MM = 10.0


@dataclass(frozen=True, eq=False)
class SpaceScenario(ShortRepr):
    """The counterpart of `Scenario` in 3D. It holds all that a plan needs, without the volume.

    Positions are in the frame of the lattice (mm): x along the insertion, y and z across.

    Parameters
    ----------
    file : AnatomyFile
        The settings.
    grid : AnatomyGrid
        The anatomy on the grid points.
    source : str, optional
        Path of the anatomy file, for messages.
    """

    file: AnatomyFile
    grid: AnatomyGrid
    source: str = field(default="", compare=False)

    @classmethod
    def of(cls, anatomy: Anatomy, target_name: str | None = None) -> SpaceScenario:
        """Return the scenario of an anatomy.

        Parameters
        ----------
        anatomy : Anatomy
            The anatomy.
        target_name : str, optional
            Name of one of several targets. Default: the only target.

        Returns
        -------
        SpaceScenario

        Raises
        ------
        ScenarioError
            As `grid_of`, or no target has this name.
        """
        names = [aim.name for aim in anatomy.file.anatomy.targets]
        if target_name is None:
            return cls(anatomy.file, grid_of(anatomy), anatomy.source)
        if target_name not in names:
            rule = f"must be the name of a target: {', '.join(names)}" if names else "is for several targets"
            raise ScenarioError(Mistake("target_name", str(target_name), rule), anatomy.source)
        return cls.of_targets(anatomy)[target_name]

    @classmethod
    def of_targets(cls, anatomy: Anatomy) -> dict[str, SpaceScenario]:
        """Return the scenario of each target of an anatomy by its name, all on one lattice.

        Each is a scenario with one target, and has the name of the target in its title. A single target has the name
        "target". Raises the ScenarioErrors of `grid_of`.
        """
        file, regions = anatomy.file, anatomy.file.anatomy
        scenarios = {}
        for aim, grid in zip(regions.aims, grids_of(anatomy), strict=True):
            of_target = replace(regions, target=aim.region, targets=())
            title = f"{file.title}: {aim.name}" if regions.targets else file.title
            scenarios[aim.name] = cls(replace(file, anatomy=of_target, title=title), grid, anatomy.source)
        return scenarios

    @property
    def title(self) -> str:
        """Title of the anatomy file."""
        return self.file.title

    @property
    def workspace(self) -> Rectangle:
        """Size of the lattice along x and y."""
        x, y, _ = (self.grid.frame.spacing_mm * (count - 1) for count in self.grid.frame.shape)
        return Rectangle(x, y)

    @property
    def needle(self) -> SpaceNeedle:
        """The needle of the anatomy file."""
        return self.file.needle

    @property
    def uniform(self) -> bool:
        """Whether the needle has the same radius everywhere."""
        return len({*self.grid.radii_mm}) == 1

    @property
    def noise_rad_sqrt_mm(self) -> float:
        """Standard deviation of each angle of the tangent after 1 mm; it grows with the square root of the length."""
        return math.radians(self.file.needle.tip_noise_deg) / math.sqrt(_NOISE_LENGTH_MM)

    @property
    def advance(self) -> int:
        """Number of slices that a step advances."""
        return round(self.step_mm / self.grid.frame.spacing_mm)

    @property
    def step_mm(self) -> float:
        """Advance of a step along the axis."""
        return self.file.lattice.step_of(self.grid.frame.spacing_mm)

    @property
    def cone_rad(self) -> float:
        """Half angle of the cone of directions."""
        return math.radians(self.file.lattice.cone_deg)

    @cached_property
    def target_mm(self) -> tuple[float, float, float]:
        """Centre of the target (mm): the centre of a ball, or the mean of the voxels of a label on the lattice."""
        if self.grid.target.ball is not None:
            return self.grid.target.ball[:3]
        x, y, z = self.grid.target_points_mm.mean(0).tolist()
        return x, y, z

    @cached_property
    def target_radius_mm(self) -> float:
        """Radius of the target (mm). A label counts as the ball that has the volume of its voxels on the lattice."""
        if isinstance(self.file.anatomy.target, Sphere):
            return self.file.anatomy.target.radius_mm
        volume_mm3 = len(self.grid.target_points_mm) * self.grid.voxel_mm**3
        return math.cbrt(3 * volume_mm3 / (4 * math.pi))

    @cached_property
    def target_reach_mm(self) -> float:
        """Distance of the centre of the farthest voxel of the target from its centroid, plus half a diagonal."""
        apart = np.linalg.norm(self.grid.target_points_mm - self.target_mm, axis=1)
        return float(apart.max() + math.sqrt(3) / 2 * self.grid.voxel_mm)

    @property
    def frame_axes(self) -> NDArray[np.float64]:
        """Unit vectors of the axes of the frame in RAS, shape (3, 3)."""
        return self.grid.frame.axes

    @property
    def frame_origin_mm(self) -> NDArray[np.float64]:
        """Origin of the frame in RAS (mm)."""
        return self.grid.frame.origin_mm

    def texts(self) -> dict[str, str]:
        """Return the text files that a recording keeps, by name: the anatomy, and axes and origin of the frame."""
        return {"anatomy.toml": self.to_toml(), "frame.json": self.grid.frame.to_json()}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the settings and of the arrays of the grid."""
        grid, frame = self.grid, self.grid.frame
        arrays = [frame.origin_mm, frame.axes, grid.voxels, grid.possible, grid.clearance_mm, grid.entry, grid.tissues]
        if grid.target.ball is None:
            arrays += [grid.target.rows, grid.target.inside]
        return digest("\n".join([self.to_toml(), *(digest(np.ascontiguousarray(array).data) for array in arrays)]))

    def to_toml(self) -> str:
        """Return the text of an anatomy file with these settings."""
        return self.file.to_toml()

    def curvature_per_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the planned curvature (1/mm) at points, shape (..., 3).

        A point beyond the grid has the curvature of the nearest grid point.
        """
        cells = tuple(np.moveaxis(self.grid.nearest_points(np.asarray(points_mm)), -1, 0))
        return np.asarray(1 / np.array(self.grid.radii_mm)[self.grid.tissues[cells]])

    def planned_per_mm(self, x_mm: float, y_mm: float, z_mm: float) -> float:
        """Return the planned curvature at one point.

        Parameters
        ----------
        x_mm, y_mm, z_mm : float
            Coordinates of the point in the frame of the lattice (mm).

        Returns
        -------
        float
            Curvature (1/mm).
        """
        return float(self.curvature_per_mm(np.array([x_mm, y_mm, z_mm])))

    def codes(self, points_mm: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the voxel codes of `AnatomyGrid` at points (mm), shape (..., 3); outside beyond the grid."""
        index = np.floor(np.asarray(points_mm) / self.grid.voxel_mm + 0.5)
        shape = np.array(self.grid.voxels.shape)
        within = ((index >= 0) & (index < shape)).all(-1)
        at = tuple(np.moveaxis(np.clip(index, 0, shape - 1).astype(np.int64), -1, 0))
        codes = np.where(within, self.grid.voxels[at], OUTSIDE).astype(np.uint8)
        passable = codes <= TARGET
        codes[passable] = np.where(self.grid.target.contains(np.asarray(points_mm)[passable]), TARGET, FREE)
        return codes

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the slice across z through the target, with obstacles and target, in the frame (mm).

        Without `ax`, the axes of a new pyplot figure are made.
        """
        axes = axes_or_new(ax, self.workspace)
        draw_slice(axes, self.grid, 2, dict(target_slices(self.grid))[2])
        return axes

    def rescaled(self, factor: float) -> SpaceScenario:
        """Return the scenario with all curvatures multiplied by `factor`. Raises ScenarioError for invalid radii."""
        return self.with_radii([radius_mm / factor for radius_mm in self.grid.radii_mm])

    def with_radii(self, radii_mm: Sequence[float]) -> SpaceScenario:
        """Return the scenario with other radii of the needle's arcs.

        Parameters
        ----------
        radii_mm : sequence of float
            Radii (mm) in the order of `AnatomyGrid.radii_mm`: of the needle, and of each `[[anatomy.curvature]]`.

        Returns
        -------
        SpaceScenario

        Raises
        ------
        ScenarioError
            A radius is out of range.
        """
        needle_mm, *tissues_mm = radii_mm
        regions = self.file.anatomy
        curvature = tuple(
            replace(tissue, radius_mm=radius) for tissue, radius in zip(regions.curvature, tissues_mm, strict=True)
        )
        file = replace(
            self.file,
            needle=replace(self.needle, curvature_radius_mm=needle_mm),
            anatomy=replace(regions, curvature=curvature),
        )
        return SpaceScenario(file, replace(self.grid, radii_mm=tuple(radii_mm)), self.source)
