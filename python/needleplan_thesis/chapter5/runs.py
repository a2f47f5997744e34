"""Insertions of chapter 5 with forces of our own choice, their radii, and the forces that radii need."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from needleplan.estimation import fit_circle
from needleplan.models.deflection import AxialTerms, Beam, ElasticTissue, Foundation, march, solve_uniform
from needleplan.signals import Array
from needleplan_thesis.chapter5.published import COIL_MM, END_MM, NEEDLE

__all__ = [
    "MEMORY",
    "PRINTED",
    "Course",
    "Reading",
    "coil_path",
    "depths_mm",
    "radius_mm",
    "required_force_n",
    "tip_force_n",
]

_FROM_MM = 10.0


@dataclass(frozen=True)
class Reading:
    """How the chapter is read: its foundation and its axial terms."""

    name: str
    foundation: Foundation
    terms: AxialTerms


PRINTED = Reading("as printed (anchored)", Foundation.ANCHORED, AxialTerms.PRINTED)
MEMORY = Reading("memory, all axial terms", Foundation.MEMORY, AxialTerms.CONSISTENT)


class Course(StrEnum):
    """How the cutting force comes up; all end at the same force at 80 mm."""

    QUADRATIC = "quadratic"
    LINEAR = "linear"
    SATURATING = "saturating"
    """1 - exp(-l/20 mm)."""

    CONSTANT = "constant"
    """From 5 mm on."""

    def of(self, depth_mm: Array) -> Array:
        """Return the force over that at 80 mm."""
        if self is Course.QUADRATIC:
            return (depth_mm / END_MM) ** 2
        if self is Course.LINEAR:
            return depth_mm / END_MM
        if self is Course.SATURATING:
            return np.asarray((1 - np.exp(-depth_mm / 20)) / (1 - math.exp(-END_MM / 20)))
        return np.where(depth_mm >= 5.0, 1.0, 0.0)


def depths_mm(step_mm: float) -> Array:
    """Return the depths from 0 to 80 mm."""
    return np.asarray(step_mm * np.arange(round(END_MM / step_mm) + 1), float)


def tip_force_n(axial_n: float, tissue: ElasticTissue, velocity_mm_s: float, offset_n: float) -> float:
    """Return Fc at 80 mm, (F - F0 - vf v l)/sin a."""
    friction = tissue.friction_n_s_mm2 * velocity_mm_s * END_MM
    return (axial_n - offset_n - friction) / math.sin(NEEDLE.bevel_angle_rad)


def coil_path(
    reading: Reading, tissue: ElasticTissue, velocity_mm_s: float, force_n: Array, step_mm: float
) -> tuple[Array, Array]:
    """Return depth and deflection of the coil for forces at every step, (..., steps + 1)."""
    path = march(
        NEEDLE, tissue, force_n, step_mm, velocity_mm_s, terms=reading.terms, foundation=reading.foundation,
        behind_tip_mm=COIL_MM,
    )  # fmt: skip
    return path.depth_mm, path.tracked_mm


def radius_mm(depth_mm: Array, lateral_mm: Array) -> float:
    """Return the radius of the circle through a path from 10 mm of depth on, by distances.

    Negative where the path bends away from the push of the bevel.
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
    """Return depths (0 excluded) and the cutting force that keeps a point of the needle on a circle from the entry.

    With memory the path that was cut is the circle. The force acts also by its axial part: solved by secants.
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
