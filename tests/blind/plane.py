"""Executions of needle plans in the plane, from the scenario file and the documentation alone.

Events are found by marching: the tip cannot meet a boundary sooner than its distance from it, so each arc advances
by the distance to the nearest boundary until it has crossed one. Actions come from the caller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Act = Callable[[Array], NDArray[np.integer]]

ON, TARGET, COLLISION, EXIT = range(4)  # outcomes of an execution; ON: not ended
INSERT, ROTATE, STRAIGHT = range(3)  # actions
LEAST_ADVANCE_MM = 1e-6  # by which a march goes on where a boundary is at hand
PIECES = 4  # of an arc, each with the radius near its middle
LONGEST = 2000  # steps of an execution


def polygon_mm(points: Array, ring: Array) -> Array:
    """Signed distances of points (n, 2) to a closed ring (m, 2), negative inside, (n,)."""
    x, y = points.T[:, None] - ring.T[:, :, None]  # from the corners to the points, (m, n)
    u, v = (np.roll(ring, -1, axis=0) - ring).T[:, :, None]
    share = np.clip((x * u + y * v) / (u * u + v * v), 0.0, 1.0)
    nearest = ((x - share * u) ** 2 + (y - share * v) ** 2).min(0)
    # A ray toward +x leaves the polygon through an odd number of edges.
    up = (y >= 0.0) & (y < v), v * x - u * y < 0.0
    down = (y < 0.0) & (y >= v), v * x - u * y > 0.0
    crossings = (up[0] & up[1]).sum(0) + (down[0] & down[1]).sum(0)
    return np.sqrt(nearest) * np.where(crossings % 2 == 1, -1.0, 1.0)


def shape_mm(points: Array, shape: Mapping[str, Any], grown_mm: float = 0.0) -> Array:
    """Signed distances of points (n, 2) to the shape of an obstacle or a tissue, grown by a margin, (n,).

    Inside a shape with holes, and inside a margin, only the sign is right.
    """
    if "polygon_mm" in shape:
        distance = polygon_mm(points, np.array(shape["polygon_mm"], float))
        for hole in shape.get("holes_mm", []):
            distance = np.maximum(distance, -polygon_mm(points, np.array(hole, float)))
    else:
        a, b = (np.array(end, float) for end in shape.get("ends_mm", [shape.get("center_mm")] * 2))
        length = max(float(((b - a) ** 2).sum()), 1e-300)
        share = np.clip((points - a) @ (b - a) / length, 0.0, 1.0)
        distance = np.linalg.norm(points - a - share[:, None] * (b - a), axis=-1) - shape["radius_mm"]
    return distance - grown_mm


@dataclass(frozen=True)
class Scene:
    """What a scenario file says, with the defaults of docs/reference/scenario.md."""

    file: Mapping[str, Any]

    @property
    def size_mm(self) -> tuple[float, float]:
        return self.file["workspace"]["width_mm"], self.file["workspace"]["height_mm"]

    @property
    def motion(self) -> Mapping[str, Any]:
        return self.file.get("motion", {})

    @property
    def heading_rad(self) -> float:
        """Distance of two headings."""
        return 2.0 * math.pi / self.motion.get("headings", 60)

    def target_mm(self, points: Array) -> Array:
        """Signed distances to the target, (n,)."""
        target = self.file["target"]
        return np.hypot(*(points - np.array(target["center_mm"], float)).T) - target["radius_mm"]

    def obstacle_mm(self, points: Array) -> Array:
        """Signed distances to the nearest obstacle with its margin and half of the needle, (n,)."""
        nearest = np.full(len(points), math.inf)
        needle = self.file["needle"].get("diameter_mm", 0.0) / 2.0
        for shape in self.file.get("obstacle", []):
            nearest = np.minimum(nearest, shape_mm(points, shape, shape.get("margin_mm", 0.0) + needle))
        return nearest

    def inside_mm(self, points: Array) -> Array:
        """Distances to the border of the workspace, negative outside, (n,)."""
        return np.minimum(points, np.array(self.size_mm) - points).min(1)

    def radius_mm(self, points: Array) -> Array:
        """Radii of the tissue at points, (n,)."""
        radius = np.full(len(points), float(self.file["needle"]["curvature_radius_mm"]))
        for layer in self.file["needle"].get("layer", []):
            radius[points[:, 0] >= layer["from_mm"]] = layer["curvature_radius_mm"]
        for tissue in self.file.get("tissue", []):
            radius[shape_mm(points, tissue) <= 0.0] = tissue["curvature_radius_mm"]
        return radius

    def distances_mm(self, points: Array) -> Array:
        """Signed distances to what lies outside the workspace, to the obstacles and to the target, (3, n)."""
        return np.stack([self.inside_mm(points), self.obstacle_mm(points), self.target_mm(points)])


def met(distances_mm: Array) -> NDArray[np.integer]:
    """Outcomes of tips at distances (3, n); the border of the workspace belongs to it, (n,)."""
    outside, obstacle, target = distances_mm
    return np.select([outside < 0.0, obstacle <= 0.0, target <= 0.0], [EXIT, COLLISION, TARGET], ON)


def forward(points: Array, heading: Array, curvature: Array, length: Array) -> Array:
    """Points after a length along arcs, (n, 2)."""
    half = 0.5 * curvature * length
    chord = length * np.sinc(half / math.pi)
    return points + chord[:, None] * np.stack([np.cos(heading + half), np.sin(heading + half)], axis=-1)


def march(scene: Scene, points: Array, heading: Array, curvature: Array, length: Array) -> NDArray[np.integer]:
    """First events along arcs, (n,)."""
    outcome, gone = np.full(len(points), ON), np.zeros(len(points))
    going = np.arange(len(points))
    while len(going):
        at = forward(points[going], heading[going], curvature[going], gone[going])
        distances = scene.distances_mm(at)
        outcome[going] = met(distances)
        on = (outcome[going] == ON) & (gone[going] < length[going])
        going, advance = going[on], np.maximum(distances.min(0)[on], LEAST_ADVANCE_MM)
        gone[going] = np.minimum(gone[going] + advance, length[going])
    return outcome


def step(scene: Scene, poses: Array, action: NDArray[np.integer]) -> tuple[NDArray[np.integer], Array]:
    """Events of steps from poses (n, 4) of x, y in mm, heading in rad, bevel, and the poses before the noise."""
    points, heading = poses[:, :2], poses[:, 2]
    bevel = np.where(action == ROTATE, -poses[:, 3], poses[:, 3])
    side = bevel * np.where(action == STRAIGHT, scene.motion.get("straight_curvature_share", 1.0), 1.0)
    length = np.full(len(poses), scene.motion.get("step_mm", math.nan))
    length = np.where(np.isnan(length), scene.heading_rad * scene.radius_mm(points), length)
    samples = scene.motion.get("arc_samples")
    part = length / (samples or PIECES)
    outcome = np.full(len(poses), ON)
    for _ in range(samples or PIECES):
        curvature = side / scene.radius_mm(points)
        if samples is None:
            curvature = side / scene.radius_mm(forward(points, heading, curvature, part / 2.0))
            event = march(scene, points, heading, curvature, part)
        else:
            event = met(scene.distances_mm(forward(points, heading, curvature, part)))
        points, heading = forward(points, heading, curvature, part), heading + curvature * part
        outcome = np.where(outcome == ON, event, outcome)
    return outcome, np.column_stack([points, heading, bevel])


def execute(scene: Scene, act: Act, poses: Array, rng: np.random.Generator) -> NDArray[np.integer]:
    """Outcomes of one execution from each pose, (n,). `act` says the action at poses (n, 4), headings within a turn."""
    half = np.array(scene.motion.get("tip_noise", [0.466, 0.24, 0.027]), float)
    chance = np.concatenate([half[:0:-1], half])
    noise_rad = math.radians(scene.motion.get("tip_noise_step_deg", math.degrees(scene.heading_rad)))
    turns = noise_rad * np.arange(1 - len(half), len(half))
    outcome, poses, going = np.full(len(poses), ON), np.array(poses, float), np.arange(len(poses))
    for _ in range(LONGEST):
        outcome[going], poses[going] = step(scene, poses[going], act(poses[going]))
        going = going[outcome[going] == ON]
        if not len(going):
            break
        turned = poses[going, 2] + rng.choice(turns, len(going), p=chance / chance.sum())
        poses[going, 2] = np.remainder(turned, 2.0 * math.pi)
    return outcome
