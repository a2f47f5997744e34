"""Tip force and radius of curvature from the axial force at the base.

The axial force is F = F0 + vf v l + Fc sin a: an offset F0 (Coulomb friction, which the viscous term leaves out, what
is left of the rupture, the zero of the sensor), viscous friction along the inserted length, and the force Fc on the
bevel face. The steady radius is EI lam/(Fc cos a), so that

    R = EI^(3/4) kf^(1/4) tan(a) / (sqrt(2) (F - F0 - vf v l)) g

where g, about one beyond lam l = 1, is the effect of the base, which a needle just inserted still feels.

Fc is a small difference of large numbers. The thesis has no F0: with F0 = 0 its forces give a quarter of its radii. It
has to be identified, and its standard deviation belongs to the answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection.beam import Tissue
from needleplan.models.deflection.choices import AxialTerms
from needleplan.models.deflection.march import march
from needleplan.models.needle import Needle
from needleplan.signals import Array

__all__ = ["AxialOffset", "cutting_force_n", "finite_depth_factor", "radius_from_axial_mm"]


@dataclass(frozen=True)
class AxialOffset:
    """F0 with its standard deviation, N."""

    value_n: float
    sd_n: float


def cutting_force_n(
    needle: Needle,
    tissue: Tissue,
    axial_force_n: ArrayLike,
    depth_mm: ArrayLike,
    velocity_mm_s: ArrayLike,
    offset: AxialOffset,
) -> tuple[Array, Array]:
    """Return Fc = (F - F0 - vf v l)/sin a and its standard deviation from that of F0, N; the arguments broadcast.

    Negative where the record and F0 disagree: nothing is clipped.
    """
    friction = tissue.friction_n_s_mm2 * np.asarray(velocity_mm_s, float) * np.asarray(depth_mm, float)
    sine = math.sin(needle.bevel_angle_rad)
    force = (np.asarray(axial_force_n, float) - offset.value_n - friction) / sine
    return force, np.full_like(force, offset.sd_n / sine)


def radius_from_axial_mm(
    needle: Needle,
    tissue: Tissue,
    axial_force_n: ArrayLike,
    depth_mm: ArrayLike,
    velocity_mm_s: ArrayLike,
    offset: AxialOffset,
    *,
    factor: ArrayLike = 1.0,
) -> tuple[Array, Array]:
    """Return the radius of curvature (mm) and its relative standard deviation, by depth, velocity, tissue and needle.

    `factor` is g (`finite_depth_factor`), 1 for a deep needle. The radius is infinite where nothing is left of the
    axial force. Of the logarithm of R: +3/4 for EI, +1/4 for kf, -1 for the cutting part of the axial force.
    """
    force, sd = cutting_force_n(needle, tissue, axial_force_n, depth_mm, velocity_mm_s, offset)
    push = force * math.cos(needle.bevel_angle_rad)
    some = push > 0
    steady = needle.bending_stiffness_n_mm2 * tissue.decay_1_mm(needle)
    radius = np.where(some, steady * np.asarray(factor, float) / np.where(some, push, 1.0), np.inf)
    return radius, np.where(some, sd / np.where(some, force, 1.0), np.inf)


def finite_depth_factor(
    needle: Needle, tissue: Tissue, depth_mm: ArrayLike, *, straight_start_mm: float = 20.0, step_mm: float = 1.0
) -> Array:
    """Return g, the local radius over the steady one for a constant force that begins at `straight_start_mm`.

    `depth_mm`, any shape, from two steps beyond the straight start to two steps short of the needle's length; one
    march, without axial terms. Raises ModelError for other depths.
    """
    depth = np.asarray(depth_mm, float)
    lowest, highest = straight_start_mm + 2 * step_mm, needle.length_mm - 2 * step_mm
    if not ((depth >= lowest) & (depth <= highest)).all():
        raise ModelError(Mistake("depth_mm", "", f"must be from {lowest:g} to {highest:g} mm"))
    grid = step_mm * np.arange(math.ceil(float(depth.max()) / step_mm) + 2)
    force = 0.1
    inserted = march(needle, tissue, np.where(grid > straight_start_mm, force, 0.0), step_mm, terms=AxialTerms.PLAIN)
    curvature = np.diff(inserted.tip_mm, 2) / step_mm**2
    push = force * math.cos(needle.bevel_angle_rad)
    steady = push / (needle.bending_stiffness_n_mm2 * tissue.decay_1_mm(needle))
    return np.asarray(steady / np.interp(depth, grid[1:-1], curvature))
