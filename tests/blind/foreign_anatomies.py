"""Invented lung, liver and brain as a segmentation tool would export them, made from a seed.

Written from docs/reference/anatomy.md alone. All lengths are in mm. Shapes are drawn in a frame with the axes of RAS
and its origin in the middle of the volume; the voxels are unequal, oblique, and in any order of axes. Vessels and
bronchi are trees of tapered branches down to a diameter of 1 mm. A voxel has the label of the shape at its centre.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.blind.obstacle_volumes import Mask
from tests.blind.volume_files import Format, write_volume
from tests.blind.voxel_distance import Array
from tests.blind.voxel_tracer import Ball, Volume

OBSTACLES = ("vessel", "bronchus", "bone", "gallbladder", "ventricle", "sinus")
NAMES = {name: number for number, name in enumerate(("air", "wall", "organ", "entry", "target", *OBSTACLES))}
THINNEST_MM = 0.5  # radius of the thinnest branches
PIECE_MM = 3.0  # length of the straight pieces of a branch
ENTRY_DEPTH_MM = 2.5  # depth of the entry region below the skin
Inside = Callable[[Array], Array]  # whether points (n, 3) are inside


class Organ(StrEnum):
    """What is segmented."""

    LUNG = "lung"
    LIVER = "liver"
    BRAIN = "brain"


@dataclass(frozen=True)
class ForeignAnatomy:
    """A segmentation, the regions of the plan, and the needle; the entry is a label or a ball."""

    organ: Organ
    seed: int
    volume: Volume
    entry: int | Ball
    target: int
    target_radius_mm: float
    curvature_radius_mm: float
    organ_radius_mm: float

    def write(self, folder: Path, gauge: int | None = None) -> Path:
        """Writes volume, colour table and anatomy.toml into a folder; returns the file. gauge None: no thickness."""
        name = write_volume(self.volume, folder, list(Format)[self.seed % len(Format)])
        rows = [f"{number} {name} {40 + 20 * number} 90 120 255" for name, number in NAMES.items()]
        (folder / "labels.ctbl").write_text("\n".join([*rows, ""]))
        names = [name for name in OBSTACLES if NAMES[name] in self.volume.obstacles]
        entry = '"entry"'
        if isinstance(self.entry, Ball):
            entry = f"{{ center_mm = {list(self.entry.center_mm)}, radius_mm = {self.entry.radius_mm} }}"
        file = folder / "anatomy.toml"
        file.write_text(
            f'schema = "needleplan.anatomy/1"\ntitle = "Foreign {self.organ} {self.seed}"\n\n'
            f'[anatomy]\nfile = "{name}"\nlabels = "labels.ctbl"\ntarget = "target"\nentry = {entry}\n'
            f'obstacles = {names}\noutside = ["air"]\nmargin_mm = 0.0\n\n'
            f'[[anatomy.curvature]]\nlabel = "organ"\nradius_mm = {self.organ_radius_mm:.1f}\n\n'
            f"[needle]\ncurvature_radius_mm = {self.curvature_radius_mm:.1f}\n"
            + ("diameter_mm = 0.0\n" if gauge is None else f"gauge = {gauge}\n")
        )
        return file


@dataclass(frozen=True)
class _Scene:
    """Voxel centres (ni, nj, nk, 3) from the middle of the volume, affine of the same frame, and labels to paint."""

    centres: NDArray[np.float32]
    affine: Array
    labels: NDArray[np.uint8]

    def paint(self, mask: Mask, name: str) -> None:
        self.labels[mask] = NAMES[name]

    def mask(self, name: str) -> Mask:
        return self.labels == NAMES[name]

    def branches(self, pieces: list[tuple[Array, Array, float]], name: str) -> None:
        """Paints capsules, but only in the organ; a branch thinner than a voxel is as thick as a voxel."""
        spacing = np.linalg.norm(self.affine[:3, :3], axis=0)
        inverse = np.linalg.inv(self.affine)
        for start, end, radius in pieces:
            radius = max(radius, 0.5 * spacing.max())
            ends = np.stack([start, end]) @ inverse[:3, :3].T + inverse[:3, 3]
            low = np.maximum(np.floor(ends.min(0) - radius / spacing), 0).astype(int)
            high = np.maximum(np.ceil(ends.max(0) + radius / spacing) + 1, 0).astype(int)
            box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
            away, course = self.centres[box] - start, end - start
            place = np.clip(away @ course / (course @ course), 0.0, 1.0)
            near = np.linalg.norm(away - place[..., None] * course, axis=-1) <= radius
            self.labels[box][near & (self.labels[box] == NAMES["organ"])] = NAMES[name]


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _turned(rng: np.random.Generator, direction: Array, angle_deg: float) -> Array:
    aside, angle = _unit(np.cross(direction, rng.standard_normal(3))), np.deg2rad(angle_deg)
    return np.asarray(np.cos(angle) * direction + np.sin(angle) * aside)


def tree(
    rng: np.random.Generator, root: Array, direction: Array, radius_mm: float, inside: Inside
) -> list[tuple[Array, Array, float]]:
    """Start, end and radius of the pieces of a random tree, which ends outside of a region or when thin."""
    pieces, waiting = [], [(np.asarray(root, float), _unit(np.asarray(direction, float)), radius_mm)]
    while waiting:
        point, course, radius = waiting.pop()
        count = int(rng.integers(3, 7))
        for number in range(count):
            course = _turned(rng, course, abs(rng.normal(0.0, 8.0)))
            end = point + PIECE_MM * course
            pieces.append((point, end, radius * (1.0 - 0.15 * number / count)))
            point = end
        if inside(point[None])[0]:
            for share in rng.uniform([0.78, 0.62], [0.92, 0.82]):
                if radius * share >= THINNEST_MM:
                    waiting.append((point, _turned(rng, course, rng.uniform(20.0, 50.0)), radius * share))
    return pieces


# The functions below paint a body and its organ. They return the depths of voxels below the skin, the middle of the
# lesion, and the direction from it to the entry.


def _ellipsoid(centre: ArrayLike, radii: ArrayLike) -> Inside:
    return lambda points: (((points - np.asarray(centre)) / np.asarray(radii)) ** 2).sum(-1) <= 1.0


def _trunk(rng: np.random.Generator, scene: _Scene, rib_deg: float) -> tuple[Array, Array]:
    """Paints wall and ribs of a right side; returns the depths of voxels below the skin, and heights along the ribs."""
    x, y, z = np.moveaxis(scene.centres, -1, 0)
    wide, deep = rng.uniform(105.0, 115.0), rng.uniform(75.0, 85.0)  # half axes of the trunk, middle at x = -55
    ring = np.sqrt(((x + 55.0) / wide) ** 2 + (y / deep) ** 2)
    slope = np.hypot((x + 55.0) / wide**2, y / deep**2) / np.maximum(ring, 1e-6)
    depth = (1.0 - ring) / slope  # distance to the ellipse, to the first order
    scene.paint(depth > 0.0, "wall")
    height = z + np.tan(np.deg2rad(rib_deg)) * y
    phase = (height + rng.uniform(0.0, 24.0)) % 24.0 - 12.0  # a rib every 24 mm
    scene.paint(((depth - 12.0) / 3.5) ** 2 + (phase / 5.5) ** 2 <= 1.0, "bone")
    return depth, height


def _lung(rng: np.random.Generator, scene: _Scene) -> tuple[Array, Array, Array]:
    depth, _ = _trunk(rng, scene, 25.0)
    x = scene.centres[..., 0]
    scene.paint((depth > 17.0) & (x > -50.0) & (scene.centres[..., 2] > -52.0), "organ")
    lung = _ellipsoid((0.0, 0.0, 0.0), (62.0, 62.0, 65.0))
    hilum = np.array([-50.0, 0.0, rng.uniform(-10.0, 10.0)])
    for name, offset, radius in (("bronchus", 0.0, 4.5), ("vessel", 9.0, 4.5), ("vessel", -10.0, 4.0)):
        for tilt in (35.0, -30.0):
            course = np.array([1.0, rng.normal(0.0, 0.3), np.tan(np.deg2rad(tilt))])
            scene.branches(tree(rng, hilum + np.array([0.0, offset, 0.15 * tilt]), course, radius, lung), name)
    lesion = rng.uniform([-15.0, -15.0, -15.0], [5.0, 15.0, 15.0])
    return depth, lesion, _unit(rng.uniform([1.0, -0.4, 0.0], [1.0, 0.4, 0.0]))


def _liver(rng: np.random.Generator, scene: _Scene) -> tuple[Array, Array, Array]:
    depth, height = _trunk(rng, scene, 15.0)
    scene.paint(scene.mask("bone") & (height < -18.0), "wall")  # the costal arch: no rib below
    liver = _ellipsoid((-8.0, 0.0, 8.0), (58.0, 55.0, 52.0))
    scene.paint((depth > 17.0) & liver(scene.centres), "organ")
    hilum = np.array([-40.0, 5.0, -8.0])
    for place, course, radius in (
        (hilum, [1.0, 0.1, 0.3], 5.5),
        (hilum + np.array([0.0, -6.0, 4.0]), [0.8, -0.4, 0.5], 3.0),
        (np.array([-42.0, -25.0, 45.0]), [1.0, 0.3, -0.4], 5.0),
        (np.array([-42.0, -20.0, 45.0]), [0.7, 0.8, -0.5], 4.0),
    ):
        scene.branches(tree(rng, place, np.array(course) + rng.normal(0.0, 0.1, 3), radius, liver), "vessel")
    scene.paint(_ellipsoid((-18.0, 30.0, -35.0), (10.0, 12.0, 18.0))(scene.centres), "gallbladder")
    lesion = rng.uniform([-25.0, -20.0, -10.0], [0.0, 20.0, 20.0])
    return depth, lesion, _unit(rng.uniform([1.0, -0.3, -0.5], [1.0, 0.5, 0.0]))


def _brain(rng: np.random.Generator, scene: _Scene) -> tuple[Array, Array, Array]:
    middle, radii = np.array([-25.0, -15.0, -25.0]), np.array([72.0, 88.0, 80.0])  # the right front of a head
    away = scene.centres - middle
    ring = np.linalg.norm(away / radii, axis=-1)
    depth = (1.0 - ring) * ring / np.maximum(np.linalg.norm(away / radii**2, axis=-1), 1e-6)
    for least, name in ((0.0, "wall"), (5.0, "bone"), (11.0, "organ")):
        scene.paint(depth > least, name)
    brain = _ellipsoid(middle, radii - 11.0)
    for _ in range(6):
        place = np.array([rng.uniform(-25.0, 10.0), rng.uniform(-30.0, 20.0), -50.0])
        scene.branches(tree(rng, place, np.array([*rng.normal(0.2, 0.3, 2), 1.0]), 2.2, brain), "vessel")
    for _ in range(10):  # from the surface inwards
        course = _unit(np.array([rng.uniform(0.2, 1.0), rng.uniform(-0.5, 1.0), rng.uniform(0.2, 1.0)]))
        place = middle + course / np.linalg.norm(course / (radii - 12.0))
        scene.branches(tree(rng, place, _turned(rng, -course, 40.0), 1.5, brain), "vessel")
    scene.paint(_ellipsoid((-14.0, -22.0, -8.0), (6.0, 30.0, 9.0))(scene.centres), "ventricle")
    x, _, z = np.moveaxis(scene.centres, -1, 0)
    scene.paint((np.abs(x + 25.0) < 4.0) & (depth > 8.0) & (depth < 18.0) & (z > -20.0), "sinus")
    lesion = rng.uniform([-5.0, -25.0, -25.0], [12.0, 10.0, -5.0])
    return depth, lesion, _unit(rng.uniform([0.1, 0.2, 1.0], [0.4, 0.6, 1.0]))


def _voxels(rng: np.random.Generator) -> tuple[tuple[int, ...], Array]:
    """Shape and affine of a volume about the origin: oblique by up to 20 degrees, in any order of axes."""
    spacing, size = rng.uniform(0.8, 1.2, 3), rng.uniform(122.0, 140.0, 3)
    axis, angle = _unit(rng.standard_normal(3)), np.deg2rad(rng.uniform(5.0, 20.0))
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    order = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    shape = np.round(size / spacing).astype(int)
    affine = np.eye(4)
    affine[:3, :3] = (turn @ order * spacing).astype(np.float32)  # as NIfTI holds it
    affine[:3, 3] = -affine[:3, :3] @ (0.5 * (shape - 1))
    return tuple(shape.tolist()), affine


def foreign_anatomy(organ: str, seed: int) -> ForeignAnatomy:
    """The anatomy of an organ, "lung", "liver" or "brain", and a seed."""
    organ = Organ(organ)
    rng = np.random.default_rng([seed, list(Organ).index(organ)])
    shape, affine = _voxels(rng)
    indices = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    centres = (indices @ affine[:3, :3].T + affine[:3, 3]).astype(np.float32)
    scene = _Scene(centres, affine, np.zeros(shape, np.uint8))
    depth, lesion, course = {Organ.LUNG: _lung, Organ.LIVER: _liver, Organ.BRAIN: _brain}[organ](rng, scene)
    radius = float(rng.uniform(4.0, 8.0))
    scene.paint((np.linalg.norm(centres - lesion, axis=-1) <= radius) & scene.mask("organ"), "target")
    away = centres - lesion
    ahead = away @ course
    aside = np.linalg.norm(away - ahead[..., None] * course, axis=-1)
    shift = rng.uniform(-80.0, 80.0, 3).astype(np.float32).astype(float)
    entry: int | Ball = NAMES["entry"]
    if organ is Organ.BRAIN:  # a burr hole, and a ball at its bottom
        hole = (ahead > 0.0) & (aside <= 8.0) & (scene.mask("wall") | scene.mask("bone"))
        scene.paint(hole, "wall")
        entry = Ball(tuple((centres[hole & (depth > 9.0)].mean(0) + shift).tolist()), 6.0)
    else:
        skin = scene.mask("wall") & (depth <= ENTRY_DEPTH_MM)
        scene.paint(skin & (ahead > 0.0) & (aside <= 22.0), "entry")
    affine[:3, 3] = (affine[:3, 3] + shift).astype(np.float32)
    volume = Volume(scene.labels, affine, tuple(NAMES[name] for name in OBSTACLES if scene.mask(name).any()))
    return ForeignAnatomy(
        organ, seed, volume, entry, NAMES["target"], radius, *rng.uniform([80.0, 60.0], [100.0, 90.0]).tolist()
    )
