"""The table of a table set for the curvature nearest to an identified one, as a start until a new plan is ready.

Tables of a table set in 3D that hold for the anatomy of a plan.

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
from needleplan.config import raw_of
from needleplan.errors import ScenarioError
from needleplan.planning import Table
from needleplan.scenario import Scenario
from needleplan.sweep._table_set import TableSet, TableSetEntry

__all__ = ["CurvatureLookup", "same_curvature_ratios", "space_scenarios"]


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


_Planned = Scenario | SpaceScenario


class CurvatureLookup:
    """Finds the table of a table set whose needle has the curvature nearest to that of a scenario.

    The scenario of the table must be equal to the given scenario, apart from the curvature, the title and the solver.
    If the scenario has layers or tissues, all their radii must differ by the same factor.

    Parameters
    ----------
    table_set : TableSet
        The table set; its scenarios are made now, which takes 0.5 ms each. In 3D, the volumes of the sweep are read.
    like : Scenario or SpaceScenario, optional
        Only tables that differ from this scenario in nothing but the curvature are kept, which makes every look-up in
        a large table set short. Default: all are. In 3D it is required, since tables are read in its frame.

    Raises
    ------
    ScenarioError
        If the scenario or anatomy of the table set cannot be read any more.
    """

    def __init__(self, table_set: TableSet, like: _Planned | None = None) -> None:
        self._known: list[tuple[_Planned, TableSetEntry]] = []
        if table_set.keeps_records_only:
            return
        if isinstance(like, SpaceScenario):
            self._known += space_scenarios(table_set, like)
            return
        for made, entry in zip(table_set.scenarios(), table_set, strict=True):
            if isinstance(made, Scenario) and entry.record and (like is None or _same_but_curvature(made, like)):
                self._known.append((made, entry))

    def nearest(self, wanted: _Planned, nearer_than: _Planned | None = None) -> TableSetEntry | None:
        """Return the entry with the curvature nearest to a wanted one.

        Parameters
        ----------
        wanted : Scenario or SpaceScenario
            Scenario with the wanted curvature.
        nearer_than : Scenario or SpaceScenario, optional
            Scenario that the result must be nearer than.

        Returns
        -------
        TableSetEntry or None
            None if no table fits, or if the curvature of `nearer_than` is at least as near.
        """
        fitting = self._nearest_first(wanted)
        if not fitting:
            return None
        made, entry = fitting[0]
        near = nearer_than is None or _gap_per_mm(made, wanted) < _gap_per_mm(nearer_than, wanted)
        return entry if near else None

    def nearest_first(self, wanted: _Planned) -> list[TableSetEntry]:
        """Return the entries of all tables that fit, the nearest in curvature first."""
        return [entry for _, entry in self._nearest_first(wanted)]

    def read(self, entry: TableSetEntry) -> Table:
        """Read the table of an entry of this look-up; one in 3D is moved to the frame of `like`.

        Raises SweepError or TableError if there is no whole table.
        """
        (scenario,) = (made for made, known in self._known if known is entry)
        return entry.table().moved_to(scenario)

    def _nearest_first(self, wanted: _Planned) -> list[tuple[_Planned, TableSetEntry]]:
        fitting = [pair for pair in self._known if _same_but_curvature(pair[0], wanted)]
        return sorted(fitting, key=lambda pair: _gap_per_mm(pair[0], wanted))

    def __len__(self) -> int:
        return len(self._known)


def _gap_per_mm(one: _Planned, other: _Planned) -> float:
    """Return the difference between the curvatures of two scenarios' needles (1/mm)."""
    return abs(1 / one.needle.curvature_radius_mm - 1 / other.needle.curvature_radius_mm)


def _same_but_curvature(one: _Planned, other: _Planned) -> bool:
    if isinstance(one, SpaceScenario) and isinstance(other, SpaceScenario):
        # Scenarios of a look-up share the grid of `like`, as do plans that are made on the way.
        same = one.grid.voxels is other.grid.voxels
        return same and same_curvature_ratios(one.grid.radii_mm, other.grid.radii_mm)
    if isinstance(one, SpaceScenario) or isinstance(other, SpaceScenario):
        return False
    parts = ("workspace", "obstacles", "target", "motion", "grid", "objective")
    if any(getattr(one, name) != getattr(other, name) for name in parts):
        return False
    return _places(one) == _places(other) and same_curvature_ratios(_radii(one), _radii(other))


def _radii(scenario: Scenario) -> tuple[float, ...]:
    layers = [layer.curvature_radius_mm for layer in scenario.needle.layers]
    return (scenario.needle.curvature_radius_mm, *layers, *(tissue.curvature_radius_mm for tissue in scenario.tissues))


def _places(scenario: Scenario) -> list[object]:
    """Return where layers and tissues are, without their radii of curvature."""
    layers: list[object] = [layer.from_mm for layer in scenario.needle.layers]
    return layers + [raw_of(tissue) | {"curvature_radius_mm": None} for tissue in scenario.tissues]
