"""Diagnosis of insertions through an anatomy: the planned model of the path, and the anatomy with what was diagnosed.

The given model is a `SpatialBicycle` with the curvature that was planned along the recorded paths: a step of the
curvature, where paths enter another tissue, is the effect `curvature_layer` of the given model. The anatomy gets the
curvature of the diagnosed model: the radius of a tissue is multiplied by the mean of given over diagnosed curvature at
the depths at which paths were in the tissue.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import write_whole
from needleplan.diagnosis import Diagnosis
from needleplan.models import Model, ModelFile, Parent, SpatialBicycle, in_plane
from needleplan.models.effects import AddedEffect, AugmentedModel
from needleplan.reports.diagnosis.corrected_plan import RobotCorrection, said_of, torsion_of
from needleplan.scenario import pieces_of
from needleplan.signals import Array

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario
    from needleplan.identification.insertion_path import InsertionPath

__all__ = ["CorrectedAnatomy", "corrected_anatomy_lines", "planned_path_model", "write_anatomy"]

# Distance (mm) of the depths at which planned and diagnosed curvature are compared.
_SPACING_MM = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class CorrectedAnatomy(RobotCorrection):
    """The scenario of the diagnosed needle, and what the robot needs.

    `ratios` are the diagnosed curvature over the planned one by tissue, as `AnatomyGrid.radii_mm`; `passed` says
    through which of them the needle went. The other tissues have the mean ratio.
    """

    scenario: SpaceScenario
    ratios: tuple[float, ...]
    passed: tuple[bool, ...]


def planned_path_model(scenario: SpaceScenario, paths: Sequence[InsertionPath]) -> ModelFile:
    """Return the model of the path that was planned, with the mean curvature over the paths at each depth.

    Parameters
    ----------
    scenario : SpaceScenario
        The plan.
    paths : sequence of InsertionPath
        Recorded insertions.

    Returns
    -------
    ModelFile
    """
    depth = _depths(paths)
    planned = [np.interp(depth, path.depth_mm, scenario.curvature_per_mm(path.points_mm)) for path in paths]
    pieces = pieces_of(depth, np.mean(planned, axis=0))
    layers = tuple(
        AddedEffect(
            "curvature_layer", {"size": after.curvature_per_mm / before.curvature_per_mm - 1, "depth_mm": after.low_mm}
        )
        for before, after in pairwise(pieces)
    )
    base = SpatialBicycle(pieces[0].curvature_per_mm)
    model: Model = AugmentedModel(base, layers) if layers else base
    return ModelFile(model, {}, (Parent("anatomy", scenario.digest),), ("planned for these paths",), scenario.title)


def write_anatomy(
    found: Diagnosis, scenario: SpaceScenario, paths: Sequence[InsertionPath], folder: str, velocity_mm_s: float
) -> tuple[str, CorrectedAnatomy]:
    """Write `anatomy.toml` with the diagnosed curvature into a folder.

    Parameters
    ----------
    found : Diagnosis
        Diagnosis of the model of `planned_path_model`.
    scenario : SpaceScenario
        The plan.
    paths : sequence of InsertionPath
        The training trials.
    folder : str
        The folder.
    velocity_mm_s : float
        Speed of the next insertion.

    Returns
    -------
    tuple
        Path of the file, and what it holds.

    Raises
    ------
    ModelError
        If the diagnosed path cannot bend to both sides.
    ScenarioError
        If a radius is not permitted.
    OutputError
        If the file cannot be written.
    """
    what = _corrected(found, scenario, paths, velocity_mm_s)
    here, file = Path(folder), what.scenario.file
    old = Path(scenario.source).parent
    regions, breathing = file.anatomy, file.breathing

    def moved(name: str) -> str:
        return os.path.relpath(old / name, here)

    regions = replace(regions, file=moved(regions.file), labels=regions.labels and moved(regions.labels))
    if breathing is not None:
        breathing = replace(breathing, field=tuple(moved(name) for name in breathing.field))
    text = replace(file, anatomy=regions, breathing=breathing).to_toml()
    place = here / "anatomy.toml"
    write_whole(place, f"# {said_of(found)} Diagnosis {found.digest}.\n{text}".encode())
    return str(place), what


def corrected_anatomy_lines(found: Diagnosis, what: CorrectedAnatomy) -> Iterator[str]:
    """Yield lines of text about the anatomy and the corrections that the robot needs."""
    yield f"  plan: {said_of(found)}"
    regions = what.scenario.file.anatomy
    names = ("other tissue", *(str(tissue.label) for tissue in regions.curvature))
    for name, radius_mm, ratio, was_in in zip(
        names, what.scenario.grid.radii_mm, what.ratios, what.passed, strict=True
    ):
        source = "" if was_in else ", the mean: no training trial was in it"
        yield f"  plan: {name}: radius {radius_mm:.4g} mm, curvature {ratio:.3f} times the planned one{source}"
    yield from what.lines()


def _corrected(
    found: Diagnosis, scenario: SpaceScenario, paths: Sequence[InsertionPath], velocity_mm_s: float
) -> CorrectedAnatomy:
    depth, grid = _depths(paths), scenario.grid
    given, new = (in_plane(model, float(depth[-1]), velocity_mm_s) for model in (found.given, found.model))
    ratio = np.interp(depth, new.depth_mm, new.curvature_per_mm / given.curvature_per_mm)
    within = []
    for path in paths:
        points = np.stack([np.interp(depth, path.depth_mm, axis) for axis in path.points_mm.T], -1)
        within.append(grid.tissues[tuple(grid.nearest_points(points).T)])
    tissues, repeated = np.concatenate(within), np.tile(ratio, len(paths))
    passed = tuple(bool((tissues == number).any()) for number in range(len(grid.radii_mm)))
    ratios = tuple(
        float(repeated[tissues == number].mean() if was_in else repeated.mean()) for number, was_in in enumerate(passed)
    )
    radii = tuple(radius_mm / ratio for radius_mm, ratio in zip(grid.radii_mm, ratios, strict=True))
    return CorrectedAnatomy(
        scenario=scenario.with_radii(radii), ratios=ratios, passed=passed, bends=new, torsion=torsion_of(new)
    )


def _depths(paths: Sequence[InsertionPath]) -> Array:
    """Return the depths (mm) from the entry to the end of the shallowest path."""
    return np.arange(_SPACING_MM / 2, min(float(path.depth_mm[-1]) for path in paths), _SPACING_MM)
