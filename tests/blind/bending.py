"""Hidden effects of needle and tissue on the tip's path."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from scipy.special import expit

from tests.blind.curve import Course, Steered
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, side


@dataclass(frozen=True)
class CurvatureLayer(PathEffect):
    """Beyond depth_mm the needle bends more, or less, by a share of size; over a soft edge."""

    NAME: ClassVar = PathName.CURVATURE_LAYER
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 0.95
    FIRST: ClassVar = 0.2
    SIGNED: ClassVar = True
    LINEAR: ClassVar = False
    depth_mm: float
    edge_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        return cls(0.0, reach_mm * rng.uniform(0.2, 0.65), rng.uniform(0.2, 0.6))

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array:
        return self.size * expit((steered.depth_mm - self.depth_mm) / self.edge_mm) * toward_1_mm


@dataclass(frozen=True)
class CurvatureSpeed(PathEffect):
    """The needle bends more the faster it goes: by a share of size from 5 to 10 mm/s, nearly in proportion."""

    NAME: ClassVar = PathName.CURVATURE_SPEED
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 0.9
    FIRST: ClassVar = 0.1
    SIGNED: ClassVar = True
    LINEAR: ClassVar = False
    power: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0.8, 1.0))

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array:
        faster = (np.maximum(steered.velocity_mm_s, 0.0) / 5.0) ** self.power - 1.0
        return self.size * faster / (2.0**self.power - 1.0) * toward_1_mm


@dataclass(frozen=True)
class TorsionalLag(PathEffect):
    """Friction about the axis holds the tip back: by size at 80 mm, by the shaft's twist over the depth before."""

    NAME: ClassVar = PathName.TORSIONAL_LAG
    UNIT: ClassVar = "rad"
    LARGEST: ClassVar = 1.5
    FIRST: ClassVar = 0.1
    LINEAR: ClassVar = False
    shaft_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(180.0, 220.0))

    def tip_rad(self, base_rad: Array, depth_mm: Array) -> Array:
        if self.size == 0.0:
            return base_rad

        def twist(depth: Array | float) -> Array | float:
            return depth * (self.shaft_mm - 0.5 * depth)

        free = self.size * twist(depth_mm) / twist(80.0)
        tip = base_rad.copy()
        for k in range(1, len(tip)):
            tip[k] = np.clip(tip[k - 1], base_rad[k] - free[k], base_rad[k] + free[k])
        return tip


@dataclass(frozen=True)
class PreBend(PathEffect):
    """The needle itself is bent, out of the plane of its bevel, and turns with it."""

    NAME: ClassVar = PathName.PRE_BEND
    UNIT: ClassVar = "1/mm"
    LARGEST: ClassVar = 1 / 200
    FIRST: ClassVar = 2e-4
    LINEAR: ClassVar = False
    ahead_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, float(np.radians(rng.uniform(60, 120)) * rng.choice([-1.0, 1.0])))

    def bend_1_mm(self, steered: Steered) -> Array:
        return self.size * side(steered.tip_rad + self.ahead_rad)[..., 1:]


@dataclass(frozen=True)
class EntryRupture(PathEffect):
    """The skin pushes on the bevel until it has burst: more bending over the first millimetres."""

    NAME: ClassVar = PathName.ENTRY_RUPTURE
    UNIT: ClassVar = "1/mm"
    LARGEST: ClassVar = 0.05
    FIRST: ClassVar = 0.003
    LINEAR: ClassVar = False
    fading_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(2.0, 4.0))

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array:
        del toward_1_mm
        return self.size * np.exp(-((steered.depth_mm / self.fading_mm) ** 2))


@dataclass(frozen=True)
class Misalignment(PathEffect):
    """The needle enters at an angle to the tracker's axis, the same in all trials."""

    NAME: ClassVar = PathName.MISALIGNMENT
    UNIT: ClassVar = "rad"
    LARGEST: ClassVar = 0.12
    FIRST: ClassVar = 0.01
    LINEAR: ClassVar = False
    toward_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def tilt_rad(self) -> Array:
        return self.size * np.array([np.cos(self.toward_rad), np.sin(self.toward_rad)])


@dataclass(frozen=True)
class Gravity(PathEffect):
    """The needle sags toward -z, less as the tissue carries it."""

    NAME: ClassVar = PathName.GRAVITY
    UNIT: ClassVar = "1/mm"
    LARGEST: ClassVar = 0.004
    FIRST: ClassVar = 1e-4
    LINEAR: ClassVar = False
    fading_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(60.0, 120.0))

    def bend_1_mm(self, steered: Steered) -> Array:
        down = -self.size * np.exp(-steered.depth_mm / self.fading_mm)
        return np.stack([np.zeros_like(down), down], axis=-1)


@dataclass(frozen=True)
class TissueDrift(PathEffect):
    """The whole tissue creeps sideways with the time of the trial, and the needle in it."""

    NAME: ClassVar = PathName.TISSUE_DRIFT
    UNIT: ClassVar = "mm/s"
    LARGEST: ClassVar = 0.3
    FIRST: ClassVar = 0.01
    toward_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        return self.size * steered.time_s[:, None, None] * side(self.toward_rad) + np.zeros_like(course.position_mm)


@dataclass(frozen=True)
class PathRespiration(PathEffect):
    """The tissue moves sideways with the breath: long rests, short breaths. size: peak to peak."""

    NAME: ClassVar = PathName.RESPIRATION
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 10.0
    FIRST: ClassVar = 0.5
    toward_rad: float
    period_s: float
    phase_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0, 2 * np.pi), rng.uniform(3.0, 5.0), rng.uniform(0, np.pi))

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        breath = np.cos(np.pi * steered.time_s / self.period_s + self.phase_rad) ** 4
        return self.size * breath[:, None, None] * side(self.toward_rad) + np.zeros_like(course.position_mm)
