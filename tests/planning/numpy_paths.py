"""Executions of a policy in 3D in NumPy: the slow twin of those in Rust.

It shares the decisions (`decide`) and the formula of an arc with the product. It has its own loop and noise, and asks
for what is at many points of each chord, where the product computes which faces a chord crosses.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needleplan.anatomy import FREE, SpaceScenario
from needleplan.planning import SpaceTable

# Pieces of a step for each spacing, and points at which what is there is asked for, for each piece.
PIECES, POINTS = 6, 48


@dataclass(frozen=True)
class TwinPath:
    """An execution: code of what ended it (free: it has left the cone), length (mm), rotations, and its last point."""

    end: int
    length_mm: float
    rotations: int
    point_mm: NDArray[np.float64]


def twin_path(table: SpaceTable, pose: NDArray[np.float64], random: np.random.Generator | None = None) -> TwinPath:
    """Return the execution from a pose, position (mm) and tangent; with noise if there are random numbers."""
    scenario, lattice, spacing = table.scenario, table.scenario.file.lattice, table.scenario.grid.frame.spacing_mm
    point, tangent = np.array(pose[:3]), np.array(pose[3:])
    end, length, rotations, last = int(scenario.codes(point)), 0.0, 0, -1
    while end == FREE and math.atan2(math.hypot(tangent[1], tangent[2]), tangent[0]) <= scenario.cone_rad:
        action = int(table.solved.decide(np.concatenate([point, tangent])[None])["action"][0])
        is_curved = action < lattice.rolls
        rotations += is_curved and last >= 0 and action != last
        last = action if is_curved else last
        normal = bend(tangent, 2 * math.pi * action / lattice.rolls)
        plane = (math.floor(point[0] / spacing + 1e-6) + scenario.advance) * spacing
        while end == FREE and point[0] < plane - 1e-9 and tangent[0] > 0.05:
            curvature = scenario.planned_per_mm(*point) if is_curved else 0.0
            piece = min(spacing / PIECES, (plane - point[0]) / tangent[0])
            if random is not None:
                tangent, normal = disturbed(tangent, normal, scenario, piece / 2, random)
            arcs = np.linspace(0, piece, POINTS + 1)[:, None]
            turn, bent = curvature * arcs, curvature or 1.0
            sideways = (1 - np.cos(turn)) / bent if curvature else 0 * arcs
            along = np.sin(turn) / bent if curvature else arcs
            places = point + tangent * along + normal * sideways
            codes = scenario.codes(places[1:])
            met = int((codes != FREE).argmax()) if (codes != FREE).any() else POINTS - 1
            end, point, length = int(codes[met]), places[met + 1], length + float(arcs[met + 1, 0])
            cosine, sine = math.cos(curvature * piece), math.sin(curvature * piece)
            tangent, normal = tangent * cosine + normal * sine, normal * cosine - tangent * sine
            if random is not None:
                tangent, normal = disturbed(tangent, normal, scenario, piece / 2, random)
        if tangent[0] <= 0.05:
            break
    return TwinPath(end, length, rotations, point)


def bend(tangent: NDArray[np.float64], roll: float) -> NDArray[np.float64]:
    """Return the unit vector across a tangent that y cos(roll) + z sin(roll) becomes on the shortest way from x."""
    across = np.array([0.0, math.cos(roll), math.sin(roll)])
    axis = np.cross([1.0, 0.0, 0.0], tangent)
    # Rodrigues' formula with the sine |axis| and the cosine of the angle.
    return across + np.cross(axis, across) + np.cross(axis, np.cross(axis, across)) / (1 + tangent[0])


def disturbed(
    tangent: NDArray[np.float64],
    normal: NDArray[np.float64],
    scenario: SpaceScenario,
    length_mm: float,
    random: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return tangent and normal after the noise of a length: a rotation vector across the tangent."""
    sigma = scenario.noise_rad_sqrt_mm * math.sqrt(length_mm)
    second = np.cross(tangent, normal)
    turn = sigma * (random.standard_normal() * normal + random.standard_normal() * second)
    angle = float(np.linalg.norm(turn))
    axis = turn / angle

    def rotated(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        along = axis * (axis @ vector)
        return along + math.cos(angle) * (vector - along) + math.sin(angle) * np.cross(axis, vector)

    return rotated(tangent), rotated(normal)
