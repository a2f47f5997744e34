"""Executions whose decisions know the needle only up to a coil behind the tip, in NumPy: twins of those in Rust.

They share the decisions with the product. The believed tip is replayed from the stored pose of the coil along arcs
without noise; the noise acts at many points of a step.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from needleplan.anatomy import OBSTACLE, OUTSIDE, TARGET
from needleplan.planning import PolicyTable, SpaceTable
from tests.planning.numpy_paths import bend

# Pieces of a step; tip noise turns the tip between them.
PIECES = 12
_MOST_STEPS = 60


def late_in_plane(table: PolicyTable, start: tuple[float, ...], coil_mm: float, runs: int, seed: int) -> float:
    """Return the share of executions in the plane that reach the target, of a needle without layers."""
    scenario, random = table.scenario, np.random.default_rng(seed)
    blocked = shapely.union_all([each.region() for each in scenario.obstacles])
    target, radius = np.array(scenario.target.center_mm), scenario.target.radius_mm
    size = np.array([scenario.workspace.width_mm, scenario.workspace.height_mm])
    squares = sum(2 * p * m * m for m, p in enumerate(scenario.motion.tip_noise))
    sd = 2 * math.pi / scenario.motion.headings * math.sqrt(squares / PIECES)
    piece, curvature = scenario.step_mm / PIECES, 1 / scenario.needle.curvature_radius_mm

    def arc(poses: NDArray[np.float64], bevels: NDArray[np.int64]) -> NDArray[np.float64]:
        turn = bevels * curvature * piece
        middle = poses[:, 2] + turn / 2
        return poses + np.stack([piece * np.cos(middle), piece * np.sin(middle), turn], 1)

    def hits(poses: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(shapely.intersects_xy(blocked, poses[:, 0], poses[:, 1]))

    tips = np.repeat(np.array(start[:3])[None], runs, 0)
    bevels = np.full(runs, int(start[3]))
    believed, past, sides = tips, [tips], []
    alive, reached = np.ones(runs, bool), np.zeros(runs, bool)
    for number in range(_MOST_STEPS * PIECES):
        if number % PIECES == 0:
            bevels = bevels.copy()
            for run in np.flatnonzero(alive):
                x, y, heading = believed[run].tolist()
                bevels[run] *= -1 if table.lookup(x, y, heading, int(bevels[run])).action.code == 1 else 1
        tips = arc(tips, bevels)
        tips[:, 2] += sd * random.standard_normal(runs)
        past.append(tips)
        sides.append(bevels)
        behind = max(len(past) - 1 - round(coil_mm / piece), 0)
        believed = past[behind]
        for side in sides[behind:]:
            believed = arc(believed, side)
        alive &= ~hits(tips)
        ways = target - believed[:, :2]
        met = alive & (np.linalg.norm(ways, axis=1) <= radius)
        ahead = np.maximum(ways[:, 0] * np.cos(believed[:, 2]) + ways[:, 1] * np.sin(believed[:, 2]), 0.0)
        ends = tips[:, :2] + ahead[:, None] * np.stack([np.cos(tips[:, 2]), np.sin(tips[:, 2])], 1)
        reached |= met & (np.linalg.norm(ends - target, axis=1) <= radius)
        alive &= ~(met | hits(believed) | (believed[:, :2] < 0).any(1) | (believed[:, :2] > size).any(1))
        if not alive.any():
            break
    return float(reached.mean())


def late_in_3d(table: SpaceTable, start: NDArray[np.float64], coil_mm: float, runs: int, seed: int) -> float:
    """Return the share of executions in 3D that reach the target, of a needle with one curvature."""
    scenario, random = table.scenario, np.random.default_rng(seed)
    rolls, spacing = scenario.file.lattice.rolls, scenario.grid.frame.spacing_mm
    target, piece = np.array(scenario.target_mm), spacing * scenario.advance / PIECES
    turn = scenario.planned_per_mm(*start[:3]) * piece
    sd = scenario.noise_rad_sqrt_mm * math.sqrt(piece)

    def arc(tips: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points, tangents and normals, (runs, 3, 3), after a rotation and an arc."""
        point, tangent, normal = np.moveaxis(tips, 1, 0)
        cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
        normal = cosine * normal + sine * np.cross(tangent, normal)
        middle = math.cos(turn / 2) * tangent + math.sin(turn / 2) * normal
        ahead = math.cos(turn) * tangent + math.sin(turn) * normal
        return np.stack([point + piece * middle, ahead, math.cos(turn) * normal - math.sin(turn) * tangent], 1)

    def dot(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
        return (first * second).sum(-1)

    tips = np.repeat(np.array([start[:3], start[3:], bend(start[3:], 0.0)])[None], runs, 0)
    believed, past, turns = tips, [tips], []
    planes = np.full(runs, -math.inf)
    alive, reached = np.ones(runs, bool), np.zeros(runs, bool)
    while alive.any():
        angles = np.zeros(runs)
        for run in np.flatnonzero(alive & (tips[:, 0, 0] >= planes - 1e-9)):
            point, tangent, normal = believed[run]
            action = int(table.solved.decide(np.concatenate([point, tangent])[None])["action"][0])
            wanted = bend(tangent, 2 * math.pi * action / rolls)
            angles[run] = math.atan2(np.cross(normal, wanted) @ tangent, normal @ wanted)
            planes[run] = (math.floor(tips[run, 0, 0] / spacing + 1e-6) + scenario.advance) * spacing
        tips = arc(tips, angles)
        noise = sd * random.standard_normal((2, runs, 1))
        tangents = tips[:, 1] + noise[0] * tips[:, 2] + noise[1] * np.cross(tips[:, 1], tips[:, 2])
        tangents /= np.linalg.norm(tangents, axis=1)[:, None]
        normals = tips[:, 2] - dot(tips[:, 2], tangents)[:, None] * tangents
        tips = np.stack([tips[:, 0], tangents, normals / np.linalg.norm(normals, axis=1)[:, None]], 1)
        past.append(tips)
        turns.append(angles)
        behind = max(len(past) - 1 - round(coil_mm / piece), 0)
        believed = past[behind]
        for each in turns[behind:]:
            believed = arc(believed, each)
        seen, true = scenario.codes(believed[:, 0]), scenario.codes(tips[:, 0])
        alive &= ~np.isin(true, (OBSTACLE, OUTSIDE))
        met = alive & (seen == TARGET)
        for run in np.flatnonzero(met):
            point, tangent, _ = believed[run]
            way = np.linspace(0, max(float((target - point) @ tangent), 0.0), 50)[:, None]
            left = scenario.codes(point + way * tangent) != TARGET
            way = way[: int(left.argmax())] if left.any() else way
            reached[run] = scenario.codes(tips[run, 0] + way[-1] * tips[run, 1]) == TARGET
        angle = np.arctan2(np.hypot(believed[:, 1, 1], believed[:, 1, 2]), believed[:, 1, 0])
        alive &= ~(met | np.isin(seen, (OBSTACLE, OUTSIDE)) | (angle > scenario.cone_rad))
    return float(reached.mean())
