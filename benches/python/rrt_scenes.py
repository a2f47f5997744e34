"""Planar scenes for planners of a bevel-tip needle: thirty random ones and three made by hand.

This module knows nothing of needleplan, so that the scenes are not chosen for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

SIDE_MM = 150.0
RADIUS_MM = 50.0
MARGIN_MM = 2.0
GOAL_TOLERANCE_MM = 3.0
# Seed of all random scenes; the generator of scene i is numpy's PCG64 with the seed [SEED, i].
SEED = 20100
# Arcs per quarter circle at the corners of an inflated obstacle.
CORNER_ARCS = 6
# Distance of the inflated edges (mm): larger than the margin, so that the chords at the corners stay outside of it.
# GEOS rounds the number of chords of a corner; the angle of a chord is up to 1.5 times that of an arc.
_INFLATION_MM = MARGIN_MM / np.cos(1.5 * np.pi / (4 * CORNER_ARCS))

Polygon = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Scene:
    """Obstacles without their margin, the centre of the target, and the start: x, y in mm and heading in rad."""

    name: str
    obstacles: tuple[Polygon, ...]
    target: tuple[float, float]
    start: tuple[float, float, float]

    @cached_property
    def anatomy(self) -> BaseGeometry:
        """The union of the obstacles without their margin."""
        return shapely.union_all([shapely.Polygon(each) for each in self.obstacles])

    @cached_property
    def inflated(self) -> tuple[Polygon, ...]:
        """Simple polygons that contain every place closer to an obstacle than the margin; holes are filled."""
        grown = shapely.buffer(self.anatomy, _INFLATION_MM, quad_segs=CORNER_ARCS)
        parts = getattr(grown, "geoms", [grown])
        return tuple(tuple((float(x), float(y)) for x, y in part.exterior.coords[:-1]) for part in parts)

    @cached_property
    def blocked(self) -> BaseGeometry:
        """The union of `inflated`: the tip must not touch it."""
        return shapely.union_all([shapely.Polygon(each) for each in self.inflated])

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        """Edges of `inflated`, [n, 4]: x, y of one end and of the other."""
        loops = [np.array(each) for each in self.inflated]
        return np.concatenate([np.hstack([loop, np.roll(loop, -1, axis=0)]) for loop in loops])

    def to_json(self) -> dict[str, Any]:
        """Return the scene as JSON values."""
        return {"name": self.name, "obstacles": self.obstacles, "target": self.target, "start": self.start}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Scene:
        """Return the scene that `to_json` wrote."""
        obstacles = tuple(tuple((x, y) for x, y in polygon) for polygon in values["obstacles"])
        return cls(values["name"], obstacles, tuple(values["target"]), tuple(values["start"]))


def scenes(random: int = 30) -> list[Scene]:
    """Return the scenes made by hand, then the first random ones."""
    return [*hand_made(), *(random_scene(index) for index in range(random))]


def random_scene(index: int) -> Scene:
    """Return a scene with 6 to 14 convex obstacles, clear of the start and of the target.

    The start is on the left edge with y of 30 to 120 mm and a heading of -30 to 30 degrees. The target has x of 90 to
    140 mm and y of 15 to 135 mm.
    """
    random = np.random.default_rng([SEED, index])
    start = (0.0, float(random.uniform(30, 120)), float(np.radians(random.uniform(-30, 30))))
    target = (float(random.uniform(90, 140)), float(random.uniform(15, 135)))
    keep_clear = shapely.union_all(
        [
            shapely.Point(start[:2]).buffer(8 + MARGIN_MM),
            shapely.Point(target).buffer(GOAL_TOLERANCE_MM + MARGIN_MM + 1),
        ]
    )
    count = int(random.integers(6, 15))
    obstacles: list[Polygon] = []
    while len(obstacles) < count:
        center = random.uniform([12, 5], [SIDE_MM - 5, SIDE_MM - 5])
        size = random.uniform(6, 15)
        angles = random.uniform(0, 2 * np.pi, 8)
        points = center + size * np.column_stack([np.cos(angles), np.sin(angles)])
        hull = shapely.convex_hull(shapely.MultiPoint(np.round(points, 3)))
        if hull.area > size**2 and not hull.intersects(keep_clear):
            obstacles.append(tuple((float(x), float(y)) for x, y in hull.exterior.coords[:-1]))
    return Scene(f"random {index}", tuple(obstacles), target, start)


def hand_made() -> list[Scene]:
    """Return a target behind an obstacle, a constrained passage, and clutter."""
    behind = Scene(
        "target behind an obstacle",
        (((50, 60), (66, 56), (74, 64), (74, 86), (66, 94), (50, 90)),),
        (125.0, 75.0),
        (0.0, 75.0, 0.0),
    )
    walls = (
        ((50, 0), (65, 0), (65, 85), (50, 85)),
        ((50, 96), (65, 96), (65, 150), (50, 150)),
        ((95, 0), (108, 0), (108, 60), (95, 60)),
        ((95, 72), (108, 72), (108, 150), (95, 150)),
    )
    passage = Scene("constrained passage", walls, (135.0, 65.0), (0.0, 70.0, float(np.radians(15))))
    rows = []
    for column, x in enumerate((32, 56, 80, 104)):
        for y in range(12 + 12 * (column % 2), 150, 24):
            rows.append(((x - 5, y - 4), (x + 4, y - 5), (x + 6, y + 3), (x - 3, y + 5)))
    clutter = Scene("clutter", tuple(rows), (132.0, 96.0), (0.0, 60.0, 0.0))
    return [behind, passage, clutter]
