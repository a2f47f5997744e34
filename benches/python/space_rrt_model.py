"""The needle of an anatomy for space_rrt.py: motion, what it meets, and executions with noise, all in NumPy.

Positions are those of the frame of the lattice. A roll angle is measured as in the policy: from y and z after the
shortest rotation of the x axis to the tangent. A piece of a motion is an arc of at most 1 mm with the curvature at its
start; what it meets is the voxel at its end. The noise turns the tip after every step of the plan's length, for all
planners.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needleplan.anatomy import FREE, TARGET, SpaceScenario

Array = NDArray[np.float64]

# Length (mm) of a piece.
PIECE_MM = 1.0


@dataclass(frozen=True)
class RrtPath:
    """A path: start (position and tangent), and roll angle (rad) and share of the curvature for each piece."""

    start: tuple[float, ...]
    controls: list[tuple[float, float]]


def bent(tangents: Array, roll: Array) -> Array:
    """Return the unit vectors to which tangents, (n, 3), bend at roll angles, (n,)."""
    x, y, z = tangents.T
    share = 1 / (1 + x)
    first = np.stack([-y, 1 - y * y * share, -y * z * share], -1)
    second = np.stack([-z, -y * z * share, 1 - z * z * share], -1)
    return np.asarray(np.cos(roll)[:, None] * first + np.sin(roll)[:, None] * second)


def moved(poses: Array, roll: Array, curvature: Array, length_mm: float) -> Array:
    """Return poses, (n, 6), after arcs."""
    turn = curvature * length_mm
    ahead, aside = length_mm * np.sinc(turn / math.pi), length_mm * np.sinc(turn / (2 * math.pi)) * np.sin(turn / 2)
    tangents, normal = poses[:, 3:], bent(poses[:, 3:], roll)
    position = poses[:, :3] + ahead[:, None] * tangents + aside[:, None] * normal
    return np.hstack([position, np.cos(turn)[:, None] * tangents + np.sin(turn)[:, None] * normal])


def disturbed(poses: Array, deviation: float, random: np.random.Generator) -> Array:
    """Return poses whose tangents are turned by two normal angles across them with this standard deviation (rad)."""
    angles = deviation * random.standard_normal((len(poses), 2))
    size = np.hypot(*angles.T)[:, None]
    across = bent(poses[:, 3:], np.arctan2(angles[:, 1], angles[:, 0]))
    return np.hstack([poses[:, :3], np.cos(size) * poses[:, 3:] + np.sin(size) * across])


def after_pieces(
    scenario: SpaceScenario, poses: Array, roll: Array, share: Array, pieces: int
) -> tuple[Array, NDArray[np.uint8]]:
    """Return the poses after some pieces and what they have met first; a pose that has met something stays there."""
    now, code = poses.copy(), np.full(len(poses), FREE, np.uint8)
    for _ in range(pieces):
        going = np.flatnonzero(code == FREE)
        curvature = share[going] * scenario.curvature_per_mm(now[going, :3])
        now[going] = moved(now[going], roll[going], curvature, PIECE_MM)
        code[going] = scenario.codes(now[going, :3])
    return now, code


def points_of(scenario: SpaceScenario, path: RrtPath) -> tuple[Array, bool]:
    """Return the poses along a path, (m, 6), and whether it reaches the target and meets nothing else before."""
    poses, code = [np.array([path.start], np.float64)], np.array([FREE])
    for roll, share in path.controls:
        if code[0] != FREE:
            break
        pose, code = after_pieces(scenario, poses[-1], np.array([roll]), np.array([share]), 1)
        poses.append(pose)
    return np.vstack(poses), bool(code[0] == TARGET)


def open_loop(scenario: SpaceScenario, path: RrtPath, runs: int, seed: int) -> float:
    """Return the share of executions of the controls of a path, without feedback, that reach the target."""
    random, each = np.random.default_rng(seed), round(scenario.file.lattice.step_mm / PIECE_MM)
    now, code = np.repeat(np.array([path.start], np.float64), runs, 0), np.full(runs, FREE, np.uint8)
    for number, (roll, share) in enumerate(path.controls):
        going = np.flatnonzero(code == FREE)
        if not len(going):
            break
        rolls, shares = np.full(len(going), roll), np.full(len(going), share)
        now[going], code[going] = after_pieces(scenario, now[going], rolls, shares, 1)
        if (number + 1) % each == 0:
            now[going] = disturbed(now[going], scenario.noise_rad_sqrt_mm * math.sqrt(each * PIECE_MM), random)
    return float((code == TARGET).mean())


def following(scenario: SpaceScenario, path: RrtPath, runs: int, seed: int) -> float:
    """Return the share of executions that reach the target if every step goes back to the path.

    Each step takes, of the actions of the policy, the one whose end is nearest to the place of the path at that length.
    """
    random, each = np.random.default_rng(seed), round(scenario.file.lattice.step_mm / PIECE_MM)
    points, _ = points_of(scenario, path)
    rolls = scenario.file.lattice.rolls
    actions = [(2 * math.pi * number / rolls, 1.0) for number in range(rolls)]
    actions += [(0.0, 0.0)] if scenario.file.needle.straight_steps else []
    now, code = np.repeat(np.array([path.start], np.float64), runs, 0), np.full(runs, FREE, np.uint8)
    # A follower may lag behind the path: two further steps.
    for step in range(math.ceil(len(path.controls) / each) + 2):
        going = np.flatnonzero(code == FREE)
        if not len(going):
            break
        goal = points[min((step + 1) * each, len(points) - 1), :3]
        best, gap = (now[going], code[going]), np.full(len(going), np.inf)
        for roll, share in actions:
            ends = after_pieces(scenario, now[going], np.full(len(going), roll), np.full(len(going), share), each)
            away = np.linalg.norm(ends[0][:, :3] - goal, axis=1)
            # A step that ends in the target is taken before all others, one that fails after all others.
            away = np.where(ends[1] == TARGET, -1.0, np.where(ends[1] == FREE, away, away + 1e6))
            better = away < gap
            best = np.where(better[:, None], ends[0], best[0]), np.where(better, ends[1], best[1])
            gap = np.minimum(gap, away)
        now[going], code[going] = best
        now[going] = disturbed(now[going], scenario.noise_rad_sqrt_mm * math.sqrt(each * PIECE_MM), random)
    return float((code == TARGET).mean())
