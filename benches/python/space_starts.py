"""Random starts of 3D insertions."""

import math

import numpy as np

from needleplan.planning import SpaceTable

# Largest angle (rad) between the direction of a start and the line to the target.
TILT_RAD = math.radians(12.0)


def drawn(table: SpaceTable, random: np.random.Generator) -> tuple[float, ...]:
    """Return a random pose of entry: a place in the voxel of a random entry point, and a direction near the target's.

    Neither is on the grid of the table.
    """
    scenario, spacing = table.scenario, table.scenario.grid.frame.spacing_mm
    while True:
        point = random.choice(scenario.grid.entry_points_mm()) + spacing * (random.random(3) - 0.5)
        if scenario.codes(point) != 0:
            continue
        line = np.array(scenario.target_mm) - point
        line /= np.linalg.norm(line)
        aside = random.standard_normal(3)
        aside -= (aside @ line) * line
        tilt = TILT_RAD * math.sqrt(random.random())
        tangent = math.cos(tilt) * line + math.sin(tilt) * aside / np.linalg.norm(aside)
        if math.acos(tangent[0]) < scenario.cone_rad:
            return (*point.tolist(), *tangent.tolist())
