"""Finite elements for the inserted part of the needle, with the exact solution for the outer part.

Cubic Hermite elements discretise the weak form of the equation of `Beam`, with the test function v and the term v N u''
integrated by parts::

    int EI v'' u'' - N v' u' + (b + c) v u' + kf v u  +  v (N - s) u'|_L  =  kf int v path + v P|_L + v' M|_L

All elements of an insertion have the same length h, up to a given maximum. If their number were fixed, the elements
would be so short just after the entry that rounding errors would dominate. The unknowns are u and h u' at the nodes.
Insertions with the same number of elements are solved together.

The part outside of the tissue is a clamped beam under a constant axial load N. With z = N l^2/EI and the Stumpff
functions c_k(z) = sum_j (-z)^j/(2j + k)!, tension, compression and no load are one formula (c_0 = cos sqrt(z), c_1 =
sin sqrt(z)/sqrt(z), ...)::

    end stiffness, [force, moment] = K [u, u']:  K = EI/l^3 [[c1, -l c2], [-l c2, l^2 (c2 - c3)]]/(c3 - 2 c4)
    shape, clamped at 0:                         u(x) = A x^2 c2(N x^2/EI) + B x^3 c3(N x^2/EI)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection._beam import Beam
from needleplan.models.deflection._blocks import solve_blocks
from needleplan.models.deflection._stepped import element_bending, outer_stiffness
from needleplan.signals import Array

__all__ = ["ElementShape", "end_stiffness", "hermite", "outer_shape", "solve_elements", "solve_uniform"]

# Terms of the series of a Stumpff function.
_TERMS = 16


def end_stiffness(bending_n_mm2: Array, axial_n: Array, length_mm: Array) -> tuple[Array, Array, Array]:
    """Return K_uu (N/mm), K_ut (N) and K_tt (N mm) of the free end of a beam that is clamped at the other end."""
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
    """Return deflection (mm) and slope (rad) of a beam at `place_mm` from its clamped end.

    `end_mm` and `end_slope_rad` are deflection and slope of the free end.
    """
    z = axial_n * length_mm**2 / bending_n_mm2
    c1, c2, c3 = (_stumpff(order, z) for order in (1, 2, 3))
    determinant = length_mm**4 * (c2**2 - c1 * c3)
    a = (end_mm * length_mm**2 * c2 - end_slope_rad * length_mm**3 * c3) / determinant
    b = (end_slope_rad * length_mm**2 * c2 - end_mm * length_mm * c1) / determinant
    here = axial_n * place_mm**2 / bending_n_mm2
    c1, c2, c3 = (_stumpff(order, here) for order in (1, 2, 3))
    return a * place_mm**2 * c2 + b * place_mm**3 * c3, a * place_mm * c1 + b * place_mm**2 * c2


def _stumpff(order: int, z: Array) -> Array:
    """Return c_k(z), exact to rounding for |z| < 20; a beam that is clamped at one end buckles at z = 2.5."""
    total = np.zeros_like(z)
    for j in reversed(range(_TERMS)):
        total = 1 / math.factorial(2 * j + order) - z * total
    return total


# Number of insertions that are solved together; limits the use of memory.
_AT_ONCE = 4096

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_POINTS, _WEIGHTS = (_POINTS + 1) / 2, _WEIGHTS / 2


def hermite(at: Array, order: int = 0) -> Array:
    """Return the four Hermite functions at `at` in [0, 1], or their first or second derivatives, shape (4, ...)."""
    x = np.asarray(at, float)
    if order == 0:
        rows = (1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2)
    elif order == 1:
        rows = (6 * x**2 - 6 * x, 1 - 4 * x + 3 * x**2, 6 * x - 6 * x**2, 3 * x**2 - 2 * x)
    else:
        rows = (12 * x - 6, 6 * x - 4, 6 - 12 * x, 6 * x - 2)
    return np.stack(rows)


def _integral(left: Array, right: Array, weight: Array | float = 1.0) -> Array:
    result: Array = np.einsum("ig,jg,g->ij", left, right, _WEIGHTS * weight)
    return result


_H0, _H1, _H2 = (hermite(_POINTS, order) for order in range(3))
_BEND, _FOUNDATION, _ADVECT = _integral(_H2, _H2), _integral(_H0, _H0), _integral(_H0, _H1)
_AXIAL, _AXIAL_RATE = _integral(_H1, _H1), _integral(_H1, _H1, _POINTS)
_PATH = _integral(_H0, np.stack([1 - _POINTS, _POINTS]))


@dataclass(frozen=True)
class ElementShape(CallRepr):
    """Shapes of bent needles with the same number n of elements.

    `deflection_mm` and `slope_rad` are the values at the nodes from the entry point to the tip, shape (insertions, n +
    1). `beam` is flat. `base_mm` and `base_slope_rad` are the deflection and slope of the base.
    """

    beam: Beam
    deflection_mm: Array
    slope_rad: Array
    base_mm: float = 0.0
    base_slope_rad: float = 0.0

    @property
    def tip_mm(self) -> Array:
        """Deflection of the tip, shape (insertions,)."""
        return self.deflection_mm[:, -1]

    @property
    def tip_slope_rad(self) -> Array:
        """Slope of the tip, shape (insertions,)."""
        return self.slope_rad[:, -1]

    def at(self, behind_tip_mm: ArrayLike) -> Array:
        """Return the deflection (mm) at a distance behind the tip, in or outside the tissue, shape (insertions,).

        Raises ModelError for a place outside of the tissue if the stiffness changes along the shaft.
        """
        flat, n = self.beam, self.deflection_mm.shape[1] - 1
        behind = np.broadcast_to(np.asarray(behind_tip_mm, float), flat.depth_mm.shape)
        if flat.steps and (behind > flat.depth_mm).any():
            rule = "must be in the tissue, at most the depth, if the stiffness changes along the shaft"
            raise ModelError(Mistake("behind_tip_mm", f"{behind.max():g}", rule), "deflection")
        h = flat.depth_mm / n
        place = np.clip((flat.depth_mm - behind) / h, 0, n)
        element = np.minimum(place.astype(int), n - 1)
        rows = np.arange(len(h))
        values = np.stack([
            self.deflection_mm[rows, element], h * self.slope_rad[rows, element],
            self.deflection_mm[rows, element + 1], h * self.slope_rad[rows, element + 1],
        ])  # fmt: skip
        inside = (values * hermite(place - element)).sum(axis=0)
        outer = flat.length_mm - flat.depth_mm
        x = np.clip(flat.length_mm - behind, 0, outer)
        outside, _ = outer_shape(
            x, flat.bending_n_mm2, _entry_axial(flat), outer,
            self.deflection_mm[:, 0] - self.base_mm - self.base_slope_rad * outer,
            self.slope_rad[:, 0] - self.base_slope_rad,
        )  # fmt: skip
        carried = self.base_mm + self.base_slope_rad * x
        result: Array = np.where(behind <= flat.depth_mm, inside, carried + outside)
        return result


def solve_elements(beam: Beam, behind_tip_mm: ArrayLike = 0.0, *, element_mm: float | None = None) -> Array:
    """Return the deflection (mm) at a distance behind the tip, for springs anchored to the straight line.

    The result has the shape of the coefficients. The depths may differ. `element_mm` is the largest length of an
    element; the default, a fifth of 1/lam, gives a relative error below 1e-5. Raises ModelError if `element_mm` is not
    positive.
    """
    if element_mm is not None and not element_mm > 0:
        raise ModelError(Mistake("element_mm", f"{element_mm:g}", "must be positive"), "deflection")
    flat = beam.flat()
    behind = np.broadcast_to(np.asarray(behind_tip_mm, float), beam.shape).reshape(-1)
    longest = np.sqrt(np.sqrt(4 * flat.bending_n_mm2 / flat.foundation_n_mm2)) / 5 if element_mm is None else element_mm
    counts = np.ceil(flat.depth_mm / longest * (1 - 1e-12)).astype(int)
    result = np.empty(flat.depth_mm.shape)
    for count in np.unique(counts):
        (same,) = np.nonzero(counts == count)
        for first in range(0, same.size, _AT_ONCE):
            rows = same[first : first + _AT_ONCE]
            result[rows] = solve_uniform(flat.rows(rows), int(count)).at(behind[rows])
    return result.reshape(beam.shape)


def solve_uniform(
    beam: Beam,
    count: int,
    path_mm: Array | None = None,
    *,
    anchoring: float = 0.0,
    base_mm: float = 0.0,
    base_slope_rad: float = 0.0,
) -> ElementShape:
    """Return the shapes of all insertions in the flat `beam`, with `count` elements each.

    `path_mm`, shape (insertions, count + 1), is the path that was cut, at the nodes and linear between them; None is
    the straight line. With `anchoring` mu > 0, the last value of `path_mm` is ignored: there the path is mu times the
    deflection of the tip, which is unknown. `base_mm` and `base_slope_rad` are deflection and slope of the base. At a
    buckling load the equations are singular, see `solve_blocks`.
    """
    flat = beam.flat()
    h = flat.depth_mm / count
    stiffness = _element_matrices(flat, h, count)
    diagonal = [[np.zeros((count + 1, h.size)) for _ in range(2)] for _ in range(2)]
    lower = [[np.broadcast_to(stiffness[2 + p][q], (count, h.size)) for q in range(2)] for p in range(2)]
    upper = [[np.broadcast_to(stiffness[p][2 + q], (count, h.size)) for q in range(2)] for p in range(2)]
    for p in range(2):
        for q in range(2):
            diagonal[p][q][:-1] = stiffness[p][q]
            diagonal[p][q][1:] += stiffness[2 + p][2 + q]
    loads = [np.zeros((count + 1, h.size)) for _ in range(2)]
    _add_outer(flat, h, diagonal, loads, base_mm, base_slope_rad)
    diagonal[0][1][-1] += (flat.tip_axial_n - flat.tip_follow_n) / h
    loads[0][-1] += flat.tip_push_n
    loads[1][-1] += flat.tip_moment_n_mm / h
    spring = flat.foundation_n_mm2 * h
    if anchoring:  # terms of the unknown deflection of the tip in the equations of the last element
        for p in range(2):
            upper[p][0] = upper[p][0].copy()
            upper[p][0][-1] -= anchoring * spring * _PATH[p, 1]
            diagonal[p][0][-1] -= anchoring * spring * _PATH[2 + p, 1]
    if path_mm is not None:
        given = np.array(np.broadcast_to(path_mm, (h.size, count + 1)).T, float)
        if anchoring:
            given[-1] = 0.0
        given *= spring
        for p in range(2):
            loads[p][:-1] += _PATH[p, 0] * given[:-1] + _PATH[p, 1] * given[1:]
            loads[p][1:] += _PATH[2 + p, 0] * given[:-1] + _PATH[2 + p, 1] * given[1:]
    deflection, turned = solve_blocks(diagonal, lower, upper, loads)
    return ElementShape(flat, deflection.T, (turned / h).T, base_mm, base_slope_rad)


def _element_matrices(flat: Beam, h: Array, count: int) -> list[list[Array]]:
    """Return the 4 x 4 matrices of all elements, entry by entry, each of shape (1 or count, insertions)."""
    bend, spring = flat.bending_n_mm2 / h**3, flat.foundation_n_mm2 * h
    advect, rate = flat.slope_n_mm + flat.axial_rate_n_mm, flat.axial_rate_n_mm
    loaded = np.any(flat.tip_axial_n) or np.any(rate)
    bending = element_bending(flat.steps, flat.depth_mm, count) if flat.steps else _BEND
    left = (flat.tip_axial_n / h + rate * np.arange(count, 0, -1)[:, None]) if loaded else None

    def entry(p: int, q: int) -> Array:
        same = bend * bending[p, q] + spring * _FOUNDATION[p, q] + advect * _ADVECT[p, q] + rate * _AXIAL_RATE[p, q]
        if left is None:
            return np.atleast_2d(same)
        stiffness: Array = left * -_AXIAL[p, q]
        stiffness += same  # in place: allocation for thousands of insertions would take longer than the sum
        return stiffness

    return [[entry(p, q) for q in range(4)] for p in range(4)]


def _add_outer(
    flat: Beam, h: Array, diagonal: list[list[Array]], loads: list[Array], base_mm: float, base_slope_rad: float
) -> None:
    outer, axial = flat.length_mm - flat.depth_mm, _entry_axial(flat)
    if flat.steps:
        k_uu, k_ut, k_tt = outer_stiffness(
            flat.steps, flat.bending_n_mm2, axial, flat.depth_mm, flat.length_mm, _stumpff
        )
    else:
        k_uu, k_ut, k_tt = end_stiffness(flat.bending_n_mm2, axial, outer)
    diagonal[0][0][0] += k_uu
    diagonal[0][1][0] += k_ut / h
    diagonal[1][0][0] += k_ut / h
    diagonal[1][1][0] += k_tt / h**2
    if base_mm or base_slope_rad:
        # A moved base is equivalent to a fixed base and a free end that is moved back by the rigid-body motion of the
        # base. The axial load acts along the base and has a component across the insertion.
        end = base_mm + base_slope_rad * outer
        loads[0][0] += k_uu * end + k_ut * base_slope_rad + axial * base_slope_rad
        loads[1][0] += (k_ut * end + k_tt * base_slope_rad) / h


def _entry_axial(flat: Beam) -> Array:
    return flat.tip_axial_n + flat.axial_rate_n_mm * flat.depth_mm
