"""Exact events of arcs: where an arc first touches the target, an inflated obstacle, or the rim of the workspace.

Intersections of circles with segments and with a circle are solved in closed form; no arc is sampled. The module is a
simulation of its own and uses nothing of needleplan.
"""

from enum import IntEnum

import numpy as np
import shapely
from numpy.typing import NDArray
from rrt_scenes import GOAL_TOLERANCE_MM, RADIUS_MM, SIDE_MM, Scene

Array = NDArray[np.float64]
# Lengths below this (mm) are the start of an arc and not an intersection.
_START_MM = 1e-7
# Spacing of the grid of clearances (mm), and the largest distance of a place from the nearest grid point.
CELL_MM = 1.0
CELL_REACH_MM = CELL_MM * np.sqrt(0.5)


class Event(IntEnum):
    """What ends an execution; `NONE` if it goes on."""

    NONE = 0
    TARGET = 1
    COLLISION = 2
    EXIT = 3


class Space:
    """The workspace of a scene, with its first events along arcs."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        axis = np.arange(0, SIDE_MM + CELL_MM / 2, CELL_MM)
        points = shapely.points(*np.meshgrid(axis, axis, indexing="ij"))
        shapely.prepare(scene.blocked)
        distance = shapely.distance(points, scene.blocked)
        # A lower bound of the distance to the obstacles, for all places whose nearest grid point this is.
        self.clearance = distance - CELL_REACH_MM

    def events(self, poses: Array, bevel: Array, length: Array | float) -> tuple[NDArray[np.int64], Array]:
        """Return the first event of every arc and its distance along the arc.

        Parameters
        ----------
        poses : ndarray, shape (n, 3)
            x, y and heading at which the arcs start, inside the workspace.
        bevel : ndarray, shape (n,)
            Signs of the curvatures, -1 or +1.
        length : ndarray, shape (n,), or float
            Lengths of the arcs in mm, below half a circle.

        Returns
        -------
        event : ndarray of int, shape (n,)
            Values of `Event`.
        distance : ndarray, shape (n,)
            Distance of the event along the arc, or the length of the arc.
        """
        length = np.broadcast_to(np.asarray(length, dtype=float), bevel.shape)
        first = np.stack(
            [self._target(poses, bevel), self._collision(poses, bevel, length), self._exit(poses, bevel, length)]
        )
        which = np.argmin(first, axis=0)
        distance = np.take_along_axis(first, which[None], axis=0)[0]
        event = np.where(distance <= length, which + 1, Event.NONE)
        return event, np.minimum(distance, length)

    def _target(self, poses: Array, bevel: Array) -> Array:
        target = np.array(self.scene.target)
        center = centers(poses, bevel)
        away = target - center
        apart = np.hypot(*away.T)
        cosine = (RADIUS_MM**2 + apart**2 - GOAL_TOLERANCE_MM**2) / (2 * RADIUS_MM * np.maximum(apart, 1e-12))
        half = np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan))
        middle = np.arctan2(away[:, 1], away[:, 0])
        hits = np.stack([_along(poses, bevel, middle + half), _along(poses, bevel, middle - half)])
        first = np.where(np.isnan(hits), np.inf, hits).min(axis=0)
        inside = np.hypot(*(poses[:, :2] - target).T) <= GOAL_TOLERANCE_MM
        return np.where(inside, 0.0, first)

    def _collision(self, poses: Array, bevel: Array, length: Array) -> Array:
        first = np.full(len(poses), np.inf)
        near = self.clearance[tuple(np.rint(poses[:, :2] / CELL_MM).astype(int).T)] <= length
        if near.any():
            first[near] = _segments(poses[near], bevel[near], self.scene.edges)
        return first

    def _exit(self, poses: Array, bevel: Array, length: Array) -> Array:
        first = np.full(len(poses), np.inf)
        x, y = poses[:, 0], poses[:, 1]
        near = np.minimum(np.minimum(x, SIDE_MM - x), np.minimum(y, SIDE_MM - y)) <= length
        if near.any():
            first[near] = _segments(poses[near], bevel[near], RIM, after=_START_MM)
            end = advance(poses[near], bevel[near], length[near])
            outside = ((end[:, :2] < 0) | (end[:, :2] > SIDE_MM)).any(axis=1)
            first[near] = np.where(outside, np.minimum(first[near], length[near]), first[near])
        return first


_CORNERS = np.array([[0, 0], [SIDE_MM, 0], [SIDE_MM, SIDE_MM], [0, SIDE_MM]])
RIM = np.hstack([_CORNERS, np.roll(_CORNERS, -1, axis=0)])


def centers(poses: Array, bevel: Array) -> Array:
    """Return the centres of the circles on which the arcs lie, [n, 2]."""
    x, y, heading = poses.T
    return np.column_stack([x - bevel * RADIUS_MM * np.sin(heading), y + bevel * RADIUS_MM * np.cos(heading)])


def advance(poses: Array, bevel: Array, length: Array | float) -> Array:
    """Return the poses at the ends of arcs, [n, 3]; headings are not wrapped."""
    x, y, heading = poses.T
    turned = heading + bevel * length / RADIUS_MM
    signed = bevel * RADIUS_MM
    x = x + signed * (np.sin(turned) - np.sin(heading))
    y = y - signed * (np.cos(turned) - np.cos(heading))
    return np.column_stack([x, y, turned])


def _segments(poses: Array, bevel: Array, edges: Array, after: float = -1.0) -> Array:
    """Return the distances along full circles at which they first meet one of the edges, infinite if they do not."""
    center = centers(poses, bevel)
    tail, way = edges[:, :2], edges[:, 2:] - edges[:, :2]
    from_center = tail[None] - center[:, None]
    a = (way**2).sum(axis=1)
    b = (from_center * way).sum(axis=2)
    c = (from_center**2).sum(axis=2) - RADIUS_MM**2
    root = b**2 - a * c
    arc, edge = np.nonzero(root >= 0)
    first = np.full(len(poses), np.inf)
    for sign in (-1.0, 1.0):
        t = (-b[arc, edge] + sign * np.sqrt(root[arc, edge])) / a[edge]
        on = (t >= 0) & (t <= 1)
        place = from_center[arc[on], edge[on]] + t[on, None] * way[edge[on]]
        along = _along(poses[arc[on]], bevel[arc[on]], np.arctan2(place[:, 1], place[:, 0]))
        counts = along > after
        np.minimum.at(first, arc[on][counts], along[counts])
    return first


def _along(poses: Array, bevel: Array, angle: Array) -> Array:
    """Return the distance along the circle from the pose to the place at an angle seen from the centre."""
    turned = bevel * (angle + bevel * np.pi / 2 - poses[:, 2])
    distance = RADIUS_MM * np.mod(turned, 2 * np.pi)
    return np.where(distance > 2 * np.pi * RADIUS_MM - _START_MM, 0.0, distance)
