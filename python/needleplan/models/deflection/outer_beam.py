"""The needle outside of the tissue: a clamped beam under a constant axial load, exactly.

With z = N l^2/EI and the Stumpff functions c_k(z) = sum_j (-z)^j/(2j + k)!, entire in z, so that tension, compression
and no load are one formula (c_0 = cos sqrt(z), c_1 = sin sqrt(z)/sqrt(z), ...)::

    end stiffness, [force, moment] = K [u, u']:  K = EI/l^3 [[c1, -l c2], [-l c2, l^2 (c2 - c3)]]/(c3 - 2 c4)
    shape, clamped at 0:                         u(x) = A x^2 c2(N x^2/EI) + B x^3 c3(N x^2/EI)
"""

from __future__ import annotations

import math

import numpy as np

from needleplan.signals import Array

__all__ = ["end_stiffness", "outer_shape"]

_TERMS = 16


def end_stiffness(bending_n_mm2: Array, axial_n: Array, length_mm: Array) -> tuple[Array, Array, Array]:
    """Return K_uu (N/mm), K_ut (N), K_tt (N mm) of the free end of a beam that is clamped at the other."""
    z = axial_n * length_mm**2 / bending_n_mm2
    if not np.any(z):
        unit = bending_n_mm2 / length_mm**3
        return 12 * unit, -6 * unit * length_mm, 4 * unit * length_mm**2
    _, c1, c2, c3, c4 = (_stumpff(order, z) for order in range(5))
    unit = bending_n_mm2 / length_mm**3 / (c3 - 2 * c4)
    return unit * c1, -unit * length_mm * c2, unit * length_mm**2 * (c2 - c3)


def outer_shape(
    place_mm: Array, bending_n_mm2: Array, axial_n: Array, length_mm: Array, end_mm: Array, end_slope_rad: Array
) -> tuple[Array, Array]:
    """Return deflection and slope at `place_mm` from the base, given those at the end; all broadcast."""
    z = axial_n * length_mm**2 / bending_n_mm2
    c1, c2, c3 = (_stumpff(order, z) for order in (1, 2, 3))
    determinant = length_mm**4 * (c2**2 - c1 * c3)
    a = (end_mm * length_mm**2 * c2 - end_slope_rad * length_mm**3 * c3) / determinant
    b = (end_slope_rad * length_mm**2 * c2 - end_mm * length_mm * c1) / determinant
    here = axial_n * place_mm**2 / bending_n_mm2
    c1, c2, c3 = (_stumpff(order, here) for order in (1, 2, 3))
    return a * place_mm**2 * c2 + b * place_mm**3 * c3, a * place_mm * c1 + b * place_mm**2 * c2


def _stumpff(order: int, z: Array) -> Array:
    """Return c_k; good to rounding for |z| < 20, far beyond buckling (z = 2.5) of what is clamped at one end."""
    total = np.zeros_like(z)
    for j in reversed(range(_TERMS)):
        total = 1 / math.factorial(2 * j + order) - z * total
    return total
