"""Executions where the plan is wrong, in NumPy: the slow twins of those in Rust. The tip has no noise.

They share the decisions with the product. They have their own geometry: many points of each arc, which are moved to the
anatomy one by one.
"""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from needleplan.anatomy import FREE, OBSTACLE, OUTSIDE, TARGET
from needleplan.planning import PolicyTable, SpaceTable
from tests.planning.numpy_paths import bend

# Points of a step, and of the way from the rim of the target on.
POINTS = 300
_MOST_STEPS = 60


def plane_twin(table: PolicyTable, starts: NDArray[np.float64], truths: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which executions in the plane reach the target: turn, shift along x, y and z, and ratio a row."""
    return np.array([_one_in_plane(table, *each) for each in zip(starts, truths, strict=True)])


def _one_in_plane(table: PolicyTable, pose: NDArray[np.float64], truth: NDArray[np.float64]) -> bool:
    scenario, (turn, dx, dy, aside, ratio) = table.scenario, truth.tolist()
    blocked = shapely.union_all([each.region() for each in scenario.obstacles])
    target, radius = np.array(scenario.target.center_mm), scenario.target.radius_mm
    size = np.array([scenario.workspace.width_mm, scenario.workspace.height_mm])
    matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])

    def true(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(points @ matrix.T + [dx, dy])

    def hits(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(shapely.intersects_xy(blocked, *points.T))

    point, heading, bevel = pose[:2], float(pose[2]), int(pose[3])
    for _ in range(_MOST_STEPS):
        bevel *= -1 if table.lookup(*point, heading, bevel).action.code == 1 else 1
        path = [point]
        for _ in range(POINTS):  # each tiny piece has the curvature at its true start
            x = float(true(path[-1])[0])
            radii = [each.curvature_radius_mm for each in scenario.needle.layers if each.from_mm <= x]
            curvature = ratio * bevel / (radii[-1] if radii else scenario.needle.curvature_radius_mm)
            length = scenario.step_mm / POINTS
            middle = heading + curvature * length / 2
            path.append(path[-1] + length * np.array([math.cos(middle), math.sin(middle)]))
            heading += curvature * length
        points = np.array(path[1:])
        reached = np.linalg.norm(points - target, axis=1) <= radius
        stops = reached | hits(points) | ((points < 0) | (points > size)).any(1)
        end = int(stops.argmax()) if stops.any() else POINTS
        if hits(true(points[: end + 1])).any():
            return False
        if end < POINTS:
            if not reached[end]:
                return False
            tangent = points[end] - points[end - 1]
            tangent /= np.linalg.norm(tangent)
            way = points[end] + np.linspace(0, max((target - points[end]) @ tangent, 0), POINTS)[:, None] * tangent
            return not hits(true(way)).any() and math.hypot(*(true(way[-1]) - target), aside) <= radius
        point = points[-1]
    return False


def space_twin(table: SpaceTable, starts: NDArray[np.float64], truths: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which executions in 3D reach the target: the rows of a rigid motion, and the ratio a row."""
    return np.array([_one_in_space(table, *each) for each in zip(starts, truths, strict=True)])


def _one_in_space(table: SpaceTable, pose: NDArray[np.float64], truth: NDArray[np.float64]) -> bool:
    scenario, rolls, spacing = table.scenario, table.scenario.file.lattice.rolls, table.scenario.grid.frame.spacing_mm
    motion, ratio = truth[:12].reshape(3, 4), truth[12]
    point, tangent, inside = pose[:3].copy(), pose[3:].copy(), False

    def true(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(points @ motion[:, :3].T + motion[:, 3])

    def fails(points: NDArray[np.float64]) -> bool:
        """Return whether the tip touches an obstacle, or leaves the body after it has been in it."""
        nonlocal inside
        for code in scenario.codes(true(points)):
            if code == OBSTACLE or (inside and code == OUTSIDE):
                return True
            inside |= code != OUTSIDE
        return False

    while scenario.codes(point) == FREE:
        if fails(point[None]):
            return False
        action = int(table.solved.decide(np.concatenate([point, tangent])[None])["action"][0])
        normal = bend(tangent, 2 * math.pi * action / rolls)
        plane = (math.floor(point[0] / spacing + 1e-6) + scenario.advance) * spacing
        points = [point]
        length = 2 * (plane - point[0]) / POINTS
        while points[-1][0] < plane and tangent[0] > 0.05:
            curvature = ratio * scenario.planned_per_mm(*true(points[-1])) if action < rolls else 0.0
            length = min(length, (plane - points[-1][0]) / tangent[0] + 1e-12)
            points.append(points[-1] + length * tangent + 0.5 * curvature * length**2 * normal)
            turn = curvature * length
            cosine, sine = math.cos(turn), math.sin(turn)
            tangent, normal = cosine * tangent + sine * normal, cosine * normal - sine * tangent
        places = np.array(points[1:])
        codes = scenario.codes(places)
        end = int((codes != FREE).argmax()) if (codes != FREE).any() else len(places) - 1
        if fails(places[: end + 1]):
            return False
        point = places[end]
        beyond = math.atan2(math.hypot(tangent[1], tangent[2]), tangent[0]) > scenario.cone_rad
        if codes[end] == FREE and beyond:
            return False
    if scenario.codes(point) != TARGET:
        return False
    ahead = max(float((np.array(scenario.target_mm) - point) @ tangent), 0.0)
    way = point + np.linspace(0, ahead, POINTS)[:, None] * tangent
    left = scenario.codes(way) != TARGET
    way = way[: int(left.argmax())] if left.any() else way
    return not fails(way) and bool(scenario.codes(true(way[-1])) == TARGET)
