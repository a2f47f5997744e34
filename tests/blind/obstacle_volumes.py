"""Random segmented volumes whose answer is known: closed to every path, or open along a straight line.

plate: a wall across the whole volume between entry and target. slit: the same with a slit on the straight line.
tube: a capsule of obstacle about entry and target, with a lumen, and perhaps with a plug in it.
cage: a closed box of obstacle about the target, perhaps with a window towards the entry.

Walls are conservative: every voxel that a wall touches is obstacle. A continuous path must cross the middle of the
wall, and every voxel that contains the point where it does is obstacle: nothing slips between diagonal voxels.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from tests.blind.voxel_distance import Array, box_distances, segment_box_distances, surface
from tests.blind.voxel_tracer import Ball, Volume

BODY, ENTRY, TARGET, OTHER_TISSUE = 1, 2, 3, 4
LARGEST_VOXELS = 3_000_000
SMALLEST_OPEN_MM = 0.5  # free width of an open case in the file
PAD_MM = 9.0  # from the centres of the regions to the sides of the volume
Mask = NDArray[np.bool_]


class Kind(StrEnum):
    """What is between entry and target."""

    PLATE = "plate"
    SLIT = "slit"
    TUBE = "tube"
    CAGE = "cage"


@dataclass(frozen=True)
class Case:
    """A volume, its regions and needle, and the truth about it."""

    seed: int
    kind: Kind
    volume: Volume
    names: dict[str, int]  # of the obstacles
    entry: Ball
    target: Ball
    by_label: bool  # the regions of the file are labels: the free voxels whose centres are in the balls
    curvature_radius_mm: float
    tip_noise_deg: float
    closed: bool  # no continuous path within the volume leads from the entry to the target
    nominal_mm: float  # thickness of the wall or plug of a closed case, width of the passage of an open one
    width_mm: float  # diameter of the largest free ball on the whole straight line between the centres; 0 if closed


@dataclass(frozen=True)
class _Scene:
    """Voxel centres (m, 3) in mm along the volume's axes, from the middle between entry and target."""

    centres: Array
    spacing: Array
    line: Array  # unit vector from entry to target
    half_mm: float  # from the middle to either of them
    radius_mm: float  # the larger of the two regions

    def extent(self, direction: Array) -> float:
        """Half of the extent of a voxel along a direction."""
        return float(0.5 * np.abs(direction) @ self.spacing)

    def slab(self, normal: Array, place_mm: float, thickness_mm: float) -> Mask:
        """Voxels that touch a slab across the normal, at a place on the line."""
        height = self.centres @ normal - place_mm * self.line @ normal
        return np.abs(height) <= 0.5 * thickness_mm + self.extent(normal)

    def off_axis(self, tail_mm: float) -> Array:
        """Distances of the centres from the segment between entry and target, made longer by a tail at both ends."""
        place = np.clip(self.centres @ self.line, -self.half_mm - tail_mm, self.half_mm + tail_mm)
        return np.linalg.norm(self.centres - place[:, None] * self.line, axis=1)


def _across(rng: np.random.Generator, direction: Array) -> Array:
    vector = np.cross(direction, rng.standard_normal(3))
    return vector / np.linalg.norm(vector)


def _tilted(rng: np.random.Generator, direction: Array, largest_deg: float) -> Array:
    angle = np.deg2rad(rng.uniform(0.0, largest_deg))
    return np.cos(angle) * direction + np.sin(angle) * _across(rng, direction)


def _wall(scene: _Scene, rng: np.random.Generator, thickness_mm: float, slit_mm: float) -> Mask:
    solid = scene.slab(_tilted(rng, scene.line, 40.0), rng.uniform(-0.4, 0.4) * scene.half_mm, thickness_mm)
    if slit_mm > 0.0:
        across = _across(rng, scene.line)
        lengthwise = np.cross(scene.line, across)
        length = slit_mm * rng.uniform(1.0, 4.0)
        solid &= (np.abs(scene.centres @ across) > 0.5 * slit_mm) | (np.abs(scene.centres @ lengthwise) > 0.5 * length)
    return solid


def _tube(scene: _Scene, rng: np.random.Generator, lumen_mm: float, plug_mm: float) -> Mask:
    distance = scene.off_axis(2.0)
    # The middle of the wall encloses both regions, and all voxels that contain a point of it are in the wall.
    wall = max(3.0, np.linalg.norm(scene.spacing), 2.0 * scene.radius_mm - lumen_mm) + 0.1
    within = distance <= 0.5 * lumen_mm + wall
    solid = within & (distance > 0.5 * lumen_mm)
    if plug_mm > 0.0:
        place = rng.uniform(-0.4, 0.4) * scene.half_mm
        solid |= within & scene.slab(_tilted(rng, scene.line, 30.0), place, plug_mm)
    return solid


def _cage(scene: _Scene, rng: np.random.Generator, thickness_mm: float, window_mm: float) -> Mask:
    axes = [_tilted(rng, scene.line, 25.0)]
    axes.append(_across(rng, axes[0]))
    axes.append(np.cross(axes[0], axes[1]))
    within, inner = np.ones(len(scene.centres), bool), np.ones(len(scene.centres), bool)
    for axis in axes:
        height = np.abs(scene.centres @ axis - scene.half_mm * scene.line @ axis)
        size = rng.uniform(7.0, 9.5)
        within &= height - scene.extent(axis) <= size + 0.5 * thickness_mm
        inner &= height + scene.extent(axis) < size - 0.5 * thickness_mm
    solid = within & ~inner
    if window_mm > 0.0:
        solid &= scene.off_axis(0.0) > 0.5 * window_mm
    return solid


def _local_boxes(volume: Volume) -> tuple[Array, Array]:
    """Corners in local mm of the obstacle voxels at the surface of the obstacles."""
    centres = np.argwhere(surface(volume.solid)) * volume.spacing
    return centres - 0.5 * volume.spacing, centres + 0.5 * volume.spacing


def straight_width_mm(volume: Volume, start: Array, end: Array) -> float:
    """Diameter of the largest ball that moves straight from start to end (RAS mm), clear of obstacle voxels."""
    low, high = _local_boxes(volume)
    ends = [np.broadcast_to(volume.local(point[None]), low.shape) for point in (start, end)]
    return 2.0 * float(segment_box_distances(*ends, low, high)[0].min())


def _is_free(volume: Volume, ball: Ball) -> bool:
    distance = box_distances(volume.local(np.array([ball.center_mm])), *_local_boxes(volume))
    return bool(distance.min() > ball.radius_mm)


def _draw(rng: np.random.Generator, seed: int, kind: Kind) -> Case | None:
    """One attempt; None if the draw is too large or is not what the kind promises."""
    closed = kind is Kind.PLATE or (kind is not Kind.SLIT and bool(rng.random() < 0.5))
    passage = float(np.exp(rng.uniform(np.log(0.8), np.log(8.0))))
    thickness = float(rng.uniform(0.2, 2.0))
    coarsest = 3.0 if closed else np.clip(passage, 0.6, 3.0)
    spacing = np.exp(rng.uniform(np.log(0.3), np.log(coarsest), 3))
    line, half = _across(rng, rng.standard_normal(3)), rng.uniform(12.5, 25.0)
    radii = rng.uniform(2.0, 4.0), rng.uniform(2.0, 3.0)
    pad = PAD_MM if kind is not Kind.TUBE else PAD_MM + 0.5 * passage
    shape = np.ceil((2.0 * half * np.abs(line) + 2.0 * pad) / spacing).astype(int)
    if shape.prod() > LARGEST_VOXELS:
        return None
    middle = (0.5 * (shape - 1) + rng.uniform(-0.5, 0.5, 3)) * spacing
    indices = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3)
    scene = _Scene(indices * spacing - middle, spacing, line, half, max(radii))
    if kind is Kind.TUBE:
        solid = _tube(scene, rng, passage, thickness if closed else 0.0)
    else:
        build = _cage if kind is Kind.CAGE else _wall
        solid = build(scene, rng, thickness, 0.0 if closed else passage)
    numbers = rng.choice(np.arange(5, 250 if rng.random() < 0.5 else 60_000), 2, replace=False)
    labels = np.where(scene.centres @ rng.standard_normal(3) < 5.0, BODY, OTHER_TISSUE)
    place = scene.centres[solid] @ rng.standard_normal(3)
    labels[solid] = np.where(place < place.mean(), *numbers)
    by_label = bool(rng.random() < 0.3)
    affine = np.eye(4)
    affine[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0] * rng.choice([-1.0, 1.0], 3) * spacing
    affine[:3, 3] = rng.uniform(-100.0, 100.0, 3)
    affine = affine.astype(np.float32).astype(float)  # as NIfTI holds it
    balls = []
    for sign, radius, label in zip((-1.0, 1.0), radii, (ENTRY, TARGET), strict=True):
        center = affine[:3, :3] @ ((middle + sign * half * line) / spacing) + affine[:3, 3]
        balls.append(Ball(tuple(center.tolist()), float(radius)))
        region = ~solid & (np.linalg.norm(scene.centres - sign * half * line, axis=1) <= radius)
        if not region.any():
            return None
        if by_label:
            labels[region] = label
    kept = labels.astype(np.uint8 if labels.max() < 256 else np.uint16).reshape(shape)
    volume = Volume(kept, affine, tuple(int(number) for number in numbers))
    width = straight_width_mm(volume, *(np.array(ball.center_mm) for ball in balls))
    if width > 0.0 if closed else width < SMALLEST_OPEN_MM:
        return None
    if kind is not Kind.TUBE and not all(_is_free(volume, ball) for ball in balls):
        return None
    return Case(
        seed, kind, volume, dict(zip(("vessel", "bone"), volume.obstacles, strict=True)), *balls, by_label,
        float(rng.uniform(60.0, 120.0)), float(rng.uniform(0.5, 4.0)), closed, thickness if closed else passage, width,
    )  # fmt: skip


def random_case(seed: int, kind: str) -> Case:
    """A case of a kind: "plate", "slit", "tube" or "cage"; the same for the same seed."""
    rng = np.random.default_rng([seed, list(Kind).index(Kind(kind))])
    while True:
        case = _draw(rng, seed, Kind(kind))
        if case is not None:
            return case
