"""An insertion step by step, and the radius of curvature from the axial force at the base.

**March.** The tip cuts the path, and the rest of the needle follows it. The path is stored in tissue coordinates (X = x
- l1) with one node for each step; the nodes of the elements coincide with the nodes of the path. The newest node is the
present position of the tip, which is an unknown of the same equations (implicit).

**Radius.** The axial force is F = F0 + vf v l + Fc sin a. F0 is an offset (Coulomb friction, the remainder of the
rupture, the zero of the sensor), vf v l the viscous friction along the inserted length, and Fc the force on the bevel
face. The steady radius is EI lam/(Fc cos a), so that equation (4) of docs/explanation/deflection.md is::

    R = EI^(3/4) kf^(1/4) tan(a) / (sqrt(2) (F - F0 - vf v l)) g

The factor g describes the effect of the base at small depths; g is about 1 for lam l > 1.

Fc is a small difference of large numbers. The thesis has no F0: with F0 = 0, the forces of the thesis give a quarter of
the radii of the thesis. F0 must be identified, and the standard deviation of F0 propagates to the radius.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection._beam import AxialTerms, Beam, ElasticTissue, Foundation, NeedleShaft
from needleplan.models.deflection._elements import solve_uniform
from needleplan.signals import Array

__all__ = ["AxialOffset", "CutPath", "cutting_force_n", "finite_depth_factor", "march", "radius_from_axial_mm"]


@dataclass(frozen=True)
class CutPath(CallRepr):
    """Result of `march` at every depth of the tip, shape (..., steps + 1); `depth_mm` has the shape (steps + 1,)."""

    depth_mm: Array
    tip_mm: Array
    tip_slope_rad: Array
    tracked_mm: Array
    """Deflection (mm) of the point at the distance `behind_tip_mm` behind the tip."""

    last_shape: Array
    """Deflection (mm) of the inserted needle after the last step, at the distances `depth_mm` from the entry point."""


def march(
    needle: NeedleShaft,
    tissue: ElasticTissue,
    cutting_force_n: ArrayLike,
    step_mm: float,
    velocity_mm_s: ArrayLike = 0.0,
    *,
    bevel: ArrayLike = 1,
    terms: AxialTerms = AxialTerms.CONSISTENT,
    foundation: Foundation = Foundation.MEMORY,
    anchoring: float = 1.0,
    tip_moment_n_mm: float = 0.0,
    behind_tip_mm: float = 0.0,
) -> CutPath:
    """Insert a needle in steps of `step_mm` with a given force on the bevel face.

    `cutting_force_n`, shape (..., steps + 1), is Fc after 0, 1, ..., steps steps; the first value has no effect.
    `velocity_mm_s` and `bevel` (+1 or -1; a change is a flip) broadcast to this shape. The force should grow from zero,
    because at very small depths a force moves the tip of the unguided needle by millimetres. `anchoring` is mu, the
    share of the tip's path that the tissue keeps; it counts as 0 for Foundation.ANCHORED. The error is of order step^2
    if the force grows with the square of the depth, and of order step if the force jumps. Raises ModelError for a step
    that is not positive, fewer than two forces, or an `anchoring` outside of [0, 1].
    """
    force = np.atleast_1d(np.asarray(cutting_force_n, float))
    steps = force.shape[-1] - 1
    if not step_mm > 0 or steps < 1:
        raise ModelError(Mistake("step_mm", f"{step_mm:g}", "must be positive, with a force for at least two depths"))
    if not 0 <= anchoring <= 1:
        raise ModelError(Mistake("anchoring", f"{anchoring:g}", "must be from 0 to 1"))
    kept = anchoring if foundation is Foundation.MEMORY else 0.0
    depth = step_mm * np.arange(steps + 1)
    side = np.broadcast_to(np.asarray(bevel, float), force.shape)
    velocity = np.broadcast_to(np.asarray(velocity_mm_s, float), force.shape)
    beam = Beam.of(
        needle, tissue, np.broadcast_to(depth[1:], force[..., 1:].shape), force[..., 1:], velocity[..., 1:],
        bevel=side[..., 1:], terms=terms, tip_moment_n_mm=tip_moment_n_mm,
    )  # fmt: skip
    many = int(np.prod(force.shape[:-1]))
    columns = [np.reshape(coefficient, (many, steps)) for coefficient in beam.coefficients]
    path, slope, tracked = (np.zeros((many, steps + 1)) for _ in range(3))
    tip = np.zeros((many, steps + 1))
    for k in range(1, steps + 1):
        shape = solve_uniform(
            Beam(*(column[:, k - 1] for column in columns), steps=beam.steps),
            k,
            path[:, : k + 1] if kept else None,
            anchoring=kept,
        )
        tip[:, k], slope[:, k] = shape.tip_mm, shape.tip_slope_rad
        path[:, k] = kept * tip[:, k]
        tracked[:, k] = shape.at(behind_tip_mm) if behind_tip_mm else tip[:, k]
    return CutPath(
        depth, tip.reshape(force.shape), slope.reshape(force.shape), tracked.reshape(force.shape),
        shape.deflection_mm.reshape(force.shape),
    )  # fmt: skip


@dataclass(frozen=True)
class AxialOffset:
    """The offset F0 of the axial force and its standard deviation, N."""

    value_n: float
    sd_n: float


def cutting_force_n(
    needle: NeedleShaft,
    tissue: ElasticTissue,
    axial_force_n: ArrayLike,
    depth_mm: ArrayLike,
    velocity_mm_s: ArrayLike,
    offset: AxialOffset,
) -> tuple[Array, Array]:
    """Return Fc = (F - F0 - vf v l)/sin a (N) and its standard deviation (N); the arguments broadcast.

    The standard deviation contains the uncertainty of F0 only. Fc is not clipped; a negative value means that the
    record contradicts F0.
    """
    friction = tissue.friction_n_s_mm2 * np.asarray(velocity_mm_s, float) * np.asarray(depth_mm, float)
    sine = math.sin(needle.bevel_angle_rad)
    force = (np.asarray(axial_force_n, float) - offset.value_n - friction) / sine
    return force, np.full_like(force, offset.sd_n / sine)


def radius_from_axial_mm(
    needle: NeedleShaft,
    tissue: ElasticTissue,
    axial_force_n: ArrayLike,
    depth_mm: ArrayLike,
    velocity_mm_s: ArrayLike,
    offset: AxialOffset,
    *,
    factor: ArrayLike = 1.0,
) -> tuple[Array, Array]:
    """Return the radius of curvature (mm) and its relative standard deviation.

    `factor` is g (`finite_depth_factor`), 1 for a deep needle. The radius is infinite where Fc is not positive. The
    sensitivity of ln R is 3/4 to ln EI, 1/4 to ln kf, and -1 to the logarithm of the cutting part of the axial force.
    """
    force, sd = cutting_force_n(needle, tissue, axial_force_n, depth_mm, velocity_mm_s, offset)
    push = force * math.cos(needle.bevel_angle_rad)
    some = push > 0
    steady = needle.bending_stiffness_n_mm2 * tissue.decay_1_mm(needle)
    radius = np.where(some, steady * np.asarray(factor, float) / np.where(some, push, 1.0), np.inf)
    return radius, np.where(some, sd / np.where(some, force, 1.0), np.inf)


def finite_depth_factor(
    needle: NeedleShaft,
    tissue: ElasticTissue,
    depth_mm: ArrayLike,
    *,
    straight_start_mm: float = 20.0,
    step_mm: float = 1.0,
) -> Array:
    """Return g, the ratio of the local radius to the steady radius, of the shape of `depth_mm`.

    The force is zero up to the depth `straight_start_mm` and then constant. All depths are computed by one march
    without axial terms. Raises ModelError for a depth that is less than two steps beyond the straight start or less
    than two steps short of the length of the needle. If the stiffness changes along the shaft, the steady radius is
    that of a shaft like the tip, and g contains the effect of the stiffer or softer parts.
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
