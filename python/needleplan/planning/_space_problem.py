"""The compiled steering problem of a scenario in 3D."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from needleplan import _ppvi
from needleplan.errors import ScenarioError
from needleplan.planning._lattice import compiled_call

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario

__all__ = ["space_of"]


def space_of(scenario: SpaceScenario) -> _ppvi.Space:
    """Compile the steering problem of a scenario. Raises ScenarioError."""
    file, grid = scenario.file, scenario.grid
    lattice, objective = file.lattice, file.objective
    prices = None
    if objective.clearance_mm > 0 and objective.clearance_per_mm > 0:
        shortfall = np.clip(1 - grid.clearance_mm / objective.clearance_mm, 0, 1)
        prices = (objective.clearance_per_mm * shortfall).astype(np.float32)
    body = grid.target
    return compiled_call(
        ScenarioError,
        _ppvi.Space,
        voxels=grid.voxels,
        refinement=grid.refinement,
        spacing_mm=[grid.frame.spacing_mm] * 3,
        curvature_radii_mm=list(grid.radii_mm),
        advance=scenario.advance,
        rolls=lattice.rolls,
        cone_rad=scenario.cone_rad,
        direction_spacing_rad=math.radians(lattice.directions_deg),
        noise_rad_per_sqrt_mm=scenario.noise_rad_sqrt_mm,
        insertion_per_mm=objective.insertion_per_mm,
        rotation=objective.rotation,
        collision=objective.collision,
        exit=objective.exit,
        tissues=grid.tissues if len(grid.radii_mm) > 1 else None,
        prices=prices,
        target_ball=body.ball,
        target_voxels=(body.rows.tolist(), body.inside) if body.ball is None else None,
        straight=(0.0, objective.insertion_per_mm) if file.needle.straight_steps else None,
    )
