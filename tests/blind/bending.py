"""Hidden effects of needle and tissue on the tip's path."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import expit

from tests.blind.curve import Course, Steered
from tests.blind.hidden import REACH, within
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, side


@dataclass(frozen=True)
class CurvatureLayer(
    PathEffect, name=PathName.CURVATURE_LAYER, unit="1", largest=0.95, first=0.2, signed=True, linear=False
):
    """Beyond depth_mm the needle bends more, or less, by a share of size; over a soft edge."""

    depth_mm: float = within(0.2, 0.65, of=REACH)
    edge_mm: float = within(0.2, 0.6)

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array:
        return self.size * expit((steered.depth_mm - self.depth_mm) / self.edge_mm) * toward_1_mm


@dataclass(frozen=True)
class CurvatureSpeed(
    PathEffect, name=PathName.CURVATURE_SPEED, unit="1", largest=0.9, first=0.1, signed=True, linear=False
):
    """The needle bends more the faster it goes: by a share of size from 5 to 10 mm/s, nearly in proportion."""

    power: float = within(0.8, 1.0)

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array:
        faster = (np.maximum(steered.velocity_mm_s, 0.0) / 5.0) ** self.power - 1.0
        return self.size * faster / (2.0**self.power - 1.0) * toward_1_mm


@dataclass(frozen=True)
class TorsionalLag(PathEffect, name=PathName.TORSIONAL_LAG, unit="rad", largest=1.5, first=0.1, linear=False):
    """Friction about the axis holds the tip back: by size at 80 mm, by the shaft's twist over the depth before."""

    shaft_mm: float = within(180.0, 220.0)

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
class PreBend(PathEffect, name=PathName.PRE_BEND, unit="1/mm", largest=1 / 200, first=2e-4, linear=False):
    """The needle itself is bent, out of the plane of its bevel, and turns with it."""

    ahead_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, float(np.radians(rng.uniform(60, 120)) * rng.choice([-1.0, 1.0])))

    def bend_1_mm(self, steered: Steered) -> Array:
        return self.size * side(steered.tip_rad + self.ahead_rad)[..., 1:]


@dataclass(frozen=True)
class EntryRupture(PathEffect, name=PathName.ENTRY_RUPTURE, unit="1/mm", largest=0.05, first=0.003, linear=False):
    """The skin pushes on the bevel until it has burst: more bending over the first millimetres."""

    fading_mm: float = within(2.0, 4.0)

    def bevel_1_mm(self, steered: Steered, toward_1_mm: Array) -> Array:
        del toward_1_mm
        return self.size * np.exp(-((steered.depth_mm / self.fading_mm) ** 2))


@dataclass(frozen=True)
class Misalignment(PathEffect, name=PathName.MISALIGNMENT, unit="rad", largest=0.12, first=0.01, linear=False):
    """The needle enters at an angle to the tracker's axis, the same in all trials."""

    toward_rad: float = within(0, 2 * np.pi)

    def tilt_rad(self) -> Array:
        return self.size * np.array([np.cos(self.toward_rad), np.sin(self.toward_rad)])


@dataclass(frozen=True)
class Gravity(PathEffect, name=PathName.GRAVITY, unit="1/mm", largest=0.004, first=1e-4, linear=False):
    """The needle sags toward -z, less as the tissue carries it."""

    fading_mm: float = within(60.0, 120.0)

    def bend_1_mm(self, steered: Steered) -> Array:
        down = -self.size * np.exp(-steered.depth_mm / self.fading_mm)
        return np.stack([np.zeros_like(down), down], axis=-1)


@dataclass(frozen=True)
class TissueDrift(PathEffect, name=PathName.TISSUE_DRIFT, unit="mm/s", largest=0.3, first=0.01):
    """The whole tissue creeps sideways with the time of the trial, and the needle in it."""

    toward_rad: float = within(0, 2 * np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        return self.size * steered.time_s[:, None, None] * side(self.toward_rad) + np.zeros_like(course.position_mm)


@dataclass(frozen=True)
class PathRespiration(PathEffect, name=PathName.RESPIRATION, unit="mm", largest=10.0, first=0.5):
    """The tissue moves sideways with the breath: long rests, short breaths. size: peak to peak."""

    toward_rad: float = within(0, 2 * np.pi)
    period_s: float = within(3.0, 5.0)
    phase_rad: float = within(0, np.pi)

    def shift_mm(self, steered: Steered, course: Course) -> Array:
        breath = np.cos(np.pi * steered.time_s / self.period_s + self.phase_rad) ** 4
        return self.size * breath[:, None, None] * side(self.toward_rad) + np.zeros_like(course.position_mm)
