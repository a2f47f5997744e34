"""Published numbers of chapter 5, and insertions with assumed forces: paths, radii, and required forces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from needleplan.identification import fit_circle
from needleplan.models import NeedleShaft
from needleplan.models.deflection import AxialTerms, Beam, ElasticTissue, Foundation, march, solve_uniform
from needleplan.signals import Array

__all__ = [
    "AREA_M2",
    "CASES",
    "CHANGES",
    "COIL_MM",
    "END_MM",
    "MEMORY",
    "NEEDLE",
    "NO_FORCE",
    "PRINTED",
    "SECOND_MOMENT_M4",
    "SENSITIVITY",
    "DeflectionCase",
    "ForceProfile",
    "ParameterChange",
    "Reading",
    "coil_path",
    "depths_mm",
    "radius_mm",
    "required_force_n",
    "tip_force_n",
]

# The 22-gauge needle: outer and inner diameter and length (mm), bevel angle.
NEEDLE = NeedleShaft(0.718, 0.413, 203.0, math.radians(24.8))
# Printed second moment of area (m^4) and cross-sectional area (m^2) of the needle.
SECOND_MOMENT_M4, AREA_M2 = 1.162e-14, 2.709e-7
# Distance of the tracker coil behind the tip, and final depth of an insertion (mm).
COIL_MM = 9.3
END_MM = 80.0

NO_FORCE = "the cutting force by depth, which drives the model, was not published"


@dataclass(frozen=True)
class DeflectionCase:
    """A column of Table 5.2: tissue, velocity, errors of the path, and measured and estimated radius of the path.

    `greatest_n` is the largest axial force (N), published for 15 mm/s only.
    """

    name: str
    tissue: ElasticTissue
    velocity_mm_s: float
    mean_error_mm: float
    max_error_mm: float
    measured_mm: float
    estimated_mm: float
    greatest_n: float | None

    @property
    def error_percent(self) -> float:
        """Error of the estimated radius, |estimated - measured|/measured, in percent."""
        return 100 * abs(self.estimated_mm - self.measured_mm) / self.measured_mm


# Tissues A and B: stiffness kf (N/mm^2) and density of friction vf (N s/mm^2).
_A, _B = ElasticTissue(3.87e-3, 123.9e-6), ElasticTissue(7.65e-3, 166.7e-6)

# The columns of Table 5.2.
CASES = (
    DeflectionCase("A, 10 mm/s", _A, 10.0, 0.108, 0.374, 1357.6, 1165.5, None),
    DeflectionCase("B, 10 mm/s", _B, 10.0, 0.091, 0.201, 1495.9, 1292.7, None),
    DeflectionCase("A, 15 mm/s", _A, 15.0, 0.121, 0.351, 1247.8, 1139.2, 0.232),
    DeflectionCase("B, 15 mm/s", _B, 15.0, 0.094, 0.236, 1441.5, 1171.7, 0.276),
)


@dataclass(frozen=True)
class ParameterChange:
    """A row of Table 5.3: the factors by which kf (`stiffness`) and vf (`friction`) are multiplied."""

    name: str
    stiffness: float
    friction: float

    def of(self, tissue: ElasticTissue) -> ElasticTissue:
        """Return a tissue with changed parameters."""
        return ElasticTissue(self.stiffness * tissue.stiffness_n_mm2, self.friction * tissue.friction_n_s_mm2)


# The rows of Table 5.3.
CHANGES = (
    ParameterChange("kf +20 %", 1.2, 1.0),
    ParameterChange("kf -20 %", 0.8, 1.0),
    ParameterChange("vf +20 %", 1.0, 1.2),
    ParameterChange("vf -20 %", 1.0, 0.8),
)

SENSITIVITY = (
    (12.29, 8.60, 9.01, 11.58),
    (24.61, 19.22, 12.75, 27.84),
    (15.07, 14.39, 12.51, 21.76),
    (13.80, 8.85, 8.97, 16.53),
)
"""Table 5.3 in percent: a row per element of CHANGES, a column per element of CASES."""


# Depth (mm) from which a circle is fitted to a path.
_FROM_MM = 10.0


@dataclass(frozen=True)
class Reading:
    """An interpretation of the chapter's model: kind of foundation and of axial terms."""

    name: str
    foundation: Foundation
    terms: AxialTerms


PRINTED = Reading("as printed (anchored)", Foundation.ANCHORED, AxialTerms.PRINTED)
MEMORY = Reading("memory, all axial terms", Foundation.MEMORY, AxialTerms.CONSISTENT)


class ForceProfile(StrEnum):
    """Assumed growth of the cutting force with depth; all profiles have the same force at 80 mm."""

    QUADRATIC = "quadratic"
    LINEAR = "linear"
    SATURATING = "saturating"
    """1 - exp(-l/20 mm)."""

    CONSTANT = "constant"
    """Constant from 5 mm on."""

    def of(self, depth_mm: Array) -> Array:
        """Return the cutting force at each depth, divided by the force at 80 mm, in the shape of `depth_mm`."""
        if self is ForceProfile.QUADRATIC:
            return (depth_mm / END_MM) ** 2
        if self is ForceProfile.LINEAR:
            return depth_mm / END_MM
        if self is ForceProfile.SATURATING:
            return np.asarray((1 - np.exp(-depth_mm / 20)) / (1 - math.exp(-END_MM / 20)))
        return np.where(depth_mm >= 5.0, 1.0, 0.0)


def depths_mm(step_mm: float) -> Array:
    """Return the depths of a simulated insertion, 0 to 80 mm."""
    return np.asarray(step_mm * np.arange(round(END_MM / step_mm) + 1), float)


def tip_force_n(axial_n: float, tissue: ElasticTissue, velocity_mm_s: float, offset_n: float) -> float:
    """Return the cutting force Fc = (F - F0 - vf v l)/sin a (N) at 80 mm, with F = `axial_n` and F0 = `offset_n`."""
    friction = tissue.friction_n_s_mm2 * velocity_mm_s * END_MM
    return (axial_n - offset_n - friction) / math.sin(NEEDLE.bevel_angle_rad)


def coil_path(
    reading: Reading, tissue: ElasticTissue, velocity_mm_s: float, force_n: Array, step_mm: float
) -> tuple[Array, Array]:
    """Return depth (mm), shape (steps + 1,), and deflection of the coil (mm), shape (..., steps + 1).

    `force_n` holds the cutting force at every step, in the shape of the deflection.
    """
    path = march(
        NEEDLE, tissue, force_n, step_mm, velocity_mm_s, terms=reading.terms, foundation=reading.foundation,
        behind_tip_mm=COIL_MM,
    )  # fmt: skip
    return path.depth_mm, path.tracked_mm


def radius_mm(depth_mm: Array, lateral_mm: Array) -> float:
    """Return the radius (mm) of the circle fitted to a path from a depth of 10 mm on.

    The radius is negative if the path bends against the force on the bevel.
    """
    used = depth_mm >= _FROM_MM
    return 1 / fit_circle(np.column_stack([depth_mm, lateral_mm])[used]).curvature_per_mm


@lru_cache
def required_force_n(
    reading: Reading,
    tissue: ElasticTissue,
    velocity_mm_s: float,
    radius: float,
    step_mm: float,
    *,
    behind_mm: float = 0.0,
) -> tuple[Array, Array]:
    """Return depths (mm, without 0), and the cutting forces (N) there that keep a point of the needle on a circle.

    The point is `behind_mm` behind the tip. The circle has the given radius (mm) and is tangent at the entry. With
    `Foundation.MEMORY`, the cut path is the same circle. The force has an axial part, so the equation for the force is
    nonlinear and is solved by the secant method.
    """
    depth = depths_mm(step_mm)[1:]
    steps = depth.size
    circle = np.concatenate([[0.0], radius - np.sqrt(radius**2 - depth**2)])
    force = np.zeros(steps)
    for k in range(1, steps + 1):
        path = circle[None, : k + 1] if reading.foundation is Foundation.MEMORY else None

        def off(trial: float, k: int = k, path: Array | None = path) -> float:
            beam = Beam.of(NEEDLE, tissue, float(depth[k - 1]), trial, velocity_mm_s, terms=reading.terms)
            return float(solve_uniform(beam, k, path).at(behind_mm)[0] - circle[k])

        low, high = 0.0, 0.01
        at_low, at_high = off(low), off(high)
        for _ in range(6):
            if abs(at_high) < 1e-9 or at_high == at_low:
                break
            low, high, at_low = high, high - at_high * (high - low) / (at_high - at_low), at_high
            at_high = off(high)
        force[k - 1] = high
    return depth, force
