"""Vibration of the needle: its inertia is negligible at 10 to 15 mm/s.

The whole needle is discretised with Hermite elements of fixed length. The front of the tissue moves (l1 = L - v t); the
foundation is integrated exactly over the inserted part of an element. Time integration is by Newmark's method with
average acceleration. The foundation is anchored to the straight line, and there are no axial terms
(`Foundation.ANCHORED`, `AxialTerms.PLAIN`).

The coordinates move with the needle, as in (5.7) and (5.8), and there are no convective terms. A step of the force at
the entry excites the free cantilever, and without damping the vibration never ends. Such a vibration is an artefact of
the initial condition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models import NeedleShaft
from needleplan.models.deflection import ElasticTissue, hermite
from needleplan.signals import Array

__all__ = ["Vibration", "natural_frequencies_hz", "vibrate"]

# Points and weights of Gauss quadrature on [0, 1].
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_POINTS, _WEIGHTS = (_POINTS + 1) / 2, _WEIGHTS / 2


def _matrix(order: int, start: float = 0.0) -> Array:
    """Return the integrals over [start, 1] of products of Hermite functions, differentiated `order` times."""
    values = hermite(start + (1 - start) * _POINTS, order)
    result: Array = (1 - start) * np.einsum("ig,jg,g->ij", values, values, _WEIGHTS)
    return result


# Element matrices of bending stiffness and of mass (or foundation), without dimension.
_BEND, _FULL = _matrix(2), _matrix(0)


@dataclass(frozen=True)
class Vibration:
    """Deflection of the tip with and without inertia at each time after the entry, shape (steps + 1,) each."""

    time_s: Array
    depth_mm: Array
    tip_mm: Array
    static_tip_mm: Array


def natural_frequencies_hz(
    needle: NeedleShaft, tissue: ElasticTissue, depth_mm: float, count: int = 3, *, element_mm: float = 2.0
) -> Array:
    """Return the `count` lowest natural frequencies (Hz), ascending, of the needle at rest at a depth.

    At depth 0 the needle is a free cantilever.

    The unknowns are the curvatures at the element ends. Nodal displacements would lose ten digits of the lowest
    frequency with 100 elements, because the ratio of the largest to the smallest eigenvalue grows with the fourth power
    of their number. With curvatures the bending stiffness is block diagonal, displacements are sums of positive
    multiples of curvatures, and the lowest frequencies are the largest eigenvalues: rounding costs about three digits.
    """
    from scipy.linalg import eigh

    mesh = _Mesh(needle, tissue, element_mm)
    moved = mesh.displacements()
    mass = moved.T @ mesh.dense(mesh.mass) @ moved
    stiffness = mesh.bending() + moved.T @ mesh.dense(mesh.foundation(depth_mm)) @ moved
    last = mesh.unknowns - 1
    squared_periods = eigh(mass, stiffness, eigvals_only=True, subset_by_index=(last - count + 1, last))[::-1]
    return np.asarray(1 / (2 * math.pi * np.sqrt(squared_periods)), float)


def vibrate(
    needle: NeedleShaft,
    tissue: ElasticTissue,
    tip_push_n: Array,
    velocity_mm_s: float,
    step_s: float,
    *,
    damping_1_s: float = 0.0,
    element_mm: float = 2.0,
) -> Vibration:
    """Simulate an insertion with and without inertia. The needle is at rest at the entry.

    `tip_push_n`, shape (steps + 1,), is the lateral tip force P at the times 0, step, ... `damping_1_s` is the damping
    force per mass and velocity: 2 zeta omega for a mode of the angular frequency omega. Raises ModelError if the last
    depth is not between 0 and the length of the needle.
    """
    from scipy.linalg import solve_banded

    push = np.asarray(tip_push_n, float)
    time = np.asarray(step_s * np.arange(push.size), float)
    depth = velocity_mm_s * time
    if not 0 < depth[-1] < needle.length_mm:
        rule = f"must end between 0 and the needle's length, {needle.length_mm:g} mm"
        raise ModelError(Mistake("velocity_mm_s", f"{velocity_mm_s:g}", rule), "vibration")
    mesh = _Mesh(needle, tissue, element_mm)
    tip = -2
    place, speed = np.zeros(mesh.unknowns), np.zeros(mesh.unknowns)
    acceleration = np.zeros(mesh.unknowns)
    loads = np.zeros((mesh.unknowns, 2))
    moved, static = np.zeros(push.size), np.zeros(push.size)
    # Equations at the new time with a+ = 4/h^2 (x+ - x - h v) - a and v+ = 2/h (x+ - x) - v.
    inertia = mesh.mass * (4 / step_s**2 + 2 * damping_1_s / step_s)
    for k in range(1, push.size):
        stiffness = mesh.beam + mesh.foundation(float(depth[k]))
        history = (4 / step_s**2 + 2 * damping_1_s / step_s) * place + (4 / step_s + damping_1_s) * speed + acceleration
        loads[:, 0] = mesh.times_mass(history)
        loads[tip, 0] += push[k]
        new = solve_banded((3, 3), stiffness + inertia, loads[:, 0], check_finite=False)
        loads[:, 1] = 0.0
        loads[tip, 1] = push[k]
        static[k] = solve_banded((3, 3), stiffness, loads[:, 1], check_finite=False)[tip]
        faster = 2 / step_s * (new - place) - speed
        acceleration = 4 / step_s**2 * (new - place - step_s * speed) - acceleration
        place, speed, moved[k] = new, faster, new[tip]
    return Vibration(time, depth, moved, static)


class _Mesh:
    """Band matrices, shape (7, unknowns), of a clamped needle.

    The unknowns are u and h u' of the free nodes: u is the deflection, h the length of an element.
    """

    def __init__(self, needle: NeedleShaft, tissue: ElasticTissue, element_mm: float) -> None:
        self.count = math.ceil(needle.length_mm / element_mm)
        self.unknowns = 2 * self.count
        self.h = needle.length_mm / self.count
        self.spring = tissue.stiffness_n_mm2 * self.h
        every = np.ones(self.count)
        self.bending_n_mm = needle.bending_stiffness_n_mm2 / self.h**3
        self.beam = self.band(self.bending_n_mm * _BEND, every)
        self.mass = self.band(needle.line_mass_t_mm * self.h * _FULL, every)

    def foundation(self, depth_mm: float) -> Array:
        covered = depth_mm / self.h
        full = min(int(covered), self.count)
        amount = np.zeros(self.count)
        amount[self.count - full :] = 1.0
        bands = self.band(self.spring * _FULL, amount)
        if full < self.count and covered > full:
            partly = np.zeros(self.count)
            partly[self.count - full - 1] = 1.0
            bands = bands + self.band(self.spring * _matrix(0, 1 - (covered - full)), partly)
        return bands

    def band(self, element: Array, amount: Array) -> Array:
        bands = np.zeros((7, self.count + 1, 2))
        for p in range(4):
            for q in range(4):
                node = q // 2
                bands[3 + p - q, node : node + self.count, q % 2] += element[p, q] * amount
        clamped: Array = bands.reshape(7, -1)[:, 2:].copy()
        return clamped

    def displacements(self) -> Array:
        """Return the square matrix that maps h^2 u'' at the two ends of every element to the unknowns."""
        matrix = np.zeros((self.unknowns, self.unknowns))
        u, slope = np.zeros(self.unknowns), np.zeros(self.unknowns)
        for start in range(0, self.unknowns, 2):
            u = u + slope
            u[start : start + 2] += (1 / 3, 1 / 6)
            slope = slope.copy()
            slope[start : start + 2] += (1 / 2, 1 / 2)
            matrix[start], matrix[start + 1] = u, slope
        return matrix

    def bending(self) -> Array:
        """Return the block-diagonal bending stiffness for h^2 u'' at the element ends, as in `displacements`."""
        block = np.array([[1 / 3, 1 / 6], [1 / 6, 1 / 3]])
        return np.asarray(self.bending_n_mm * np.kron(np.eye(self.count), block), float)

    def dense(self, bands: Array) -> Array:
        matrix = np.zeros((self.unknowns, self.unknowns))
        for offset in range(-3, 4):
            length = self.unknowns - abs(offset)
            row = bands[3 - offset]
            matrix += np.diag(row[max(offset, 0) :][:length], offset)
        return matrix

    def times_mass(self, vector: Array) -> Array:
        result: Array = self.mass[3] * vector
        for offset in range(1, 4):
            result[:-offset] += self.mass[3 - offset, offset:] * vector[offset:]
            result[offset:] += self.mass[3 + offset, :-offset] * vector[:-offset]
        return result
