"""An insertion, depth by depth: the tip cuts the path that the needle behind it then follows.

The path is stored where the tissue is (X = x - l1), a node every step, so that the elements of the inserted part lie
on it. The newest anchor is where the tip is now, which is part of the same equations (implicit).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection.beam import Beam, Tissue
from needleplan.models.deflection.choices import AxialTerms, Foundation
from needleplan.models.deflection.elements import solve_uniform
from needleplan.models.needle import Needle
from needleplan.signals import Array

__all__ = ["CutPath", "march"]


@dataclass(frozen=True)
class CutPath:
    """An insertion: at every depth (steps + 1,) tip and tracked point, each (..., steps + 1)."""

    depth_mm: Array
    tip_mm: Array
    tip_slope_rad: Array
    tracked_mm: Array
    """Deflection of the point `behind_tip_mm` behind the tip, at the depth of the tip."""

    last_shape: Array
    """Deflection of the inserted needle at the end, at the nodes of `depth_mm`, (..., steps + 1)."""


def march(
    needle: Needle,
    tissue: Tissue,
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
    """Insert the needle by steps of `step_mm` with a force Fc on the bevel face at every depth, (..., steps + 1).

    `cutting_force_n` and `bevel` (+1, -1; a change is a flip) are those at the depths 0, 1, ... steps; the first does
    nothing. Let the force begin gently: a force at no depth moves the tip of an unguided needle by millimetres.
    `anchoring` is mu, the part of the tip's path that the memory keeps; Foundation.ANCHORED keeps none.
    The error is of order step^2 where the force grows like depth^2, of order step where it jumps. Raises ModelError.
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
    columns = [np.reshape(each, (many, steps)) for each in vars(beam).values()]
    path, slope, tracked = (np.zeros((many, steps + 1)) for _ in range(3))
    tip = np.zeros((many, steps + 1))
    for k in range(1, steps + 1):
        shape = solve_uniform(
            Beam(*(each[:, k - 1] for each in columns)), k, path[:, : k + 1] if kept else None, anchoring=kept
        )
        tip[:, k], slope[:, k] = shape.tip_mm, shape.tip_slope_rad
        path[:, k] = kept * tip[:, k]
        tracked[:, k] = shape.at(behind_tip_mm) if behind_tip_mm else tip[:, k]
    return CutPath(
        depth, tip.reshape(force.shape), slope.reshape(force.shape), tracked.reshape(force.shape),
        shape.deflection_mm.reshape(force.shape),
    )  # fmt: skip
