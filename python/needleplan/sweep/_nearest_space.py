"""Tables of a table set in 3D that hold for the anatomy of a plan.

The lattice depends on the curvature: a needle that bends more needs a wider one. So the grids of two tables of one
anatomy differ, and cannot be compared. The volume of the sweep is therefore put on the grid of the plan; if this is the
grid of the plan, the anatomy is the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from needleplan.anatomy import Anatomy, AnatomyFile, AnatomyGrid, SpaceScenario, grid_of
from needleplan.errors import ScenarioError
from needleplan.sweep._table_set import TableSet, TableSetEntry

__all__ = ["same_curvature_ratios", "space_scenarios"]

# Relative difference up to which two ratios of radii are equal.
_SAME_RATIO = 1e-6
# Largest difference (mm, or of unit vectors) between equal grids.
_SAME_GRID = 1e-6


def space_scenarios(table_set: TableSet, like: SpaceScenario) -> Iterator[tuple[SpaceScenario, TableSetEntry]]:
    """Yield the tables that differ from a scenario in nothing but the curvature, each with its scenario.

    The scenarios have the frame of `like` and the curvatures of the tables. Titles and names of files do not matter.
    """
    same_volume: dict[tuple[str, str | None], bool] = {}
    for made, entry in zip(table_set.scenarios(), table_set, strict=True):
        if not (isinstance(made, AnatomyFile) and entry.record) or not _same_settings(made, like.file):
            continue
        files = made.anatomy.file, made.anatomy.labels
        if files not in same_volume:
            same_volume[files] = _same_anatomy(made, like)
        radii = (made.needle.curvature_radius_mm, *(region.radius_mm for region in made.anatomy.curvature))
        if same_volume[files] and same_curvature_ratios(radii, like.grid.radii_mm):
            yield SpaceScenario(made, replace(like.grid, radii_mm=radii)), entry


def same_curvature_ratios(radii: tuple[float, ...], its: tuple[float, ...]) -> bool:
    """Return whether the radii of all tissues differ from others by one factor."""
    factor = radii[0] / its[0]
    return len(radii) == len(its) and all(
        math.isclose(a, factor * b, rel_tol=_SAME_RATIO) for a, b in zip(radii, its, strict=True)
    )


def _same_settings(one: AnatomyFile, other: AnatomyFile) -> bool:
    """Return whether two anatomy files have the same settings but for radii, title and names of files."""
    return _without_radii(one) == _without_radii(other)


def _without_radii(file: AnatomyFile) -> AnatomyFile:
    same_mm = max(1.0, *file.lattice.spacings_mm)  # a radius must not be smaller than a voxel
    tissues = tuple(replace(region, radius_mm=same_mm) for region in file.anatomy.curvature)
    regions = replace(file.anatomy, file="-", labels=None, curvature=tissues)
    return replace(file, title="", anatomy=regions, needle=replace(file.needle, curvature_radius_mm=same_mm))


def _same_anatomy(made: AnatomyFile, like: SpaceScenario) -> bool:
    """Return whether the volume of a file of the sweep gives the grid of a scenario."""
    regions = replace(like.file.anatomy, file=made.anatomy.file, labels=made.anatomy.labels)
    try:
        grid = grid_of(Anatomy.of(replace(like.file, anatomy=regions)))
    except ScenarioError:  # another volume, in which the regions of the plan do not exist
        return False
    return _same_grid(grid, like.grid)


def _same_grid(one: AnatomyGrid, other: AnatomyGrid) -> bool:
    frames = [(grid.frame.origin_mm, grid.frame.axes, grid.clearance_mm) for grid in (one, other)]
    return (
        one.frame.shape == other.frame.shape
        and all(np.allclose(a, b, rtol=0, atol=_SAME_GRID) for a, b in zip(*frames, strict=True))
        and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("voxels", "entry", "tissues"))
    )
