"""Bending stiffness that changes along the shaft: elements inside the tissue, and the end stiffness of the outer part.

The stiffness is piecewise constant, EI(s) = EI ratio_k from the distance s_k from the tip on. A taper is a number of
small steps.

*Element.* With y in [0, 1] along an element of the length h, and the compliance rho(y) = 1 / ratio, the flexibility of
the right end relative to the left end is h^3/EI [[f2, f1], [f1, f0]] in (u, h u'), f_n = int (1 - y)^n rho dy. Its
inverse, carried to both ends by the rigid motions T, is the stiffness: bending is exact for steps at any place.

*Outer part.* The state (u, theta, m, q) with m = EI u'' and the transverse force q = EI u''' + N u' is continuous at a
step. Over a length x of constant EI, with z = N x^2/EI and the Stumpff functions c_k(z), ::

    u+ = u + theta x c1 + m x^2/EI c2 + q x^3/EI c3,    theta+ = theta c0 + m x/EI c1 + q x^2/EI c2
    m+ = m + q x - N (u+ - u),                           q+ = q

The two solutions that are clamped at the base give the end stiffness, [-q, m] = K [u, theta].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from needleplan.signals import Array

__all__ = ["StiffnessSteps", "element_bending", "outer_stiffness"]

StiffnessSteps = tuple[tuple[float, float], ...]
"""Pairs (distance from the tip in mm, ratio of the bending stiffness to that of the tip), by increasing distance."""

_RIGID = np.array([[-1.0, -1.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])


def _pieces(steps: StiffnessSteps) -> list[tuple[float, float, float]]:
    """Return begin and end (mm from the tip) and ratio of every piece, from the tip to infinity."""
    begins, ratios = [0.0, *(place for place, _ in steps)], [1.0, *(ratio for _, ratio in steps)]
    return list(zip(begins, [*begins[1:], np.inf], ratios, strict=True))


def element_bending(steps: StiffnessSteps, depth_mm: Array, count: int) -> Array:
    """Return the bending matrices of all elements without the factor EI/h^3, shape (4, 4, count, insertions).

    The elements are ordered from the surface to the tip; their unknowns are u and h u' of both ends.
    """
    h, number = depth_mm / count, np.arange(count)[:, None]
    moments = np.zeros((3, count, depth_mm.size))
    for begin, end, ratio in _pieces(steps):
        low, high = (1 - np.clip((depth_mm - place) / h - number, 0.0, 1.0) for place in (begin, end))
        for power in range(3):
            moments[power] += (high ** (power + 1) - low ** (power + 1)) / (power + 1) / ratio
    f0, f1, f2 = moments
    relative = np.array([[f0, -f1], [-f1, f2]]) / (f0 * f2 - f1 * f1)
    bending: Array = np.einsum("ai,abkn,bj->ijkn", _RIGID, relative, _RIGID)
    return bending


def outer_stiffness(
    steps: StiffnessSteps, bending_n_mm2: Array, axial_n: Array, depth_mm: Array, length_mm: Array,
    stumpff: Callable[[int, Array], Array],
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the stiffness of the part of the shaft outside of the tissue, at the surface; its base is clamped.

    The three arrays are force per displacement (N/mm), force per slope (N) and moment per slope (N mm).
    """
    one, zero = np.ones_like(depth_mm), np.zeros_like(depth_mm)
    ends = []
    for moment, force in ((one, zero), (zero, one)):
        u, theta, m, q = zero, zero, moment, force
        for begin, end, ratio in reversed(_pieces(steps)):
            x = np.clip(np.minimum(end, length_mm) - np.maximum(begin, depth_mm), 0.0, None)
            stiff = ratio * bending_n_mm2
            c0, c1, c2, c3 = (stumpff(order, axial_n * x**2 / stiff) for order in range(4))
            before = u
            u = u + theta * x * c1 + (m * x**2 * c2 + q * x**3 * c3) / stiff
            theta = theta * c0 + (m * x * c1 + q * x**2 * c2) / stiff
            m = m + q * x - axial_n * (u - before)
        ends.append((u, theta, m, q))
    (u1, t1, m1, q1), (u2, t2, m2, q2) = ends
    determinant = u1 * t2 - u2 * t1
    k_uu = (-q1 * t2 + q2 * t1) / determinant
    k_ut = (q1 * u2 - q2 * u1) / determinant
    return k_uu, k_ut, (m2 * u1 - m1 * u2) / determinant
