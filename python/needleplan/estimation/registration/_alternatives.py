"""Other readings of the measurements that fit better: other pairs, a mirror image, a scale, an order of the quaternion.

The residual of the best rigid motion follows from the singular values s of the cross-covariance of centred points a and
b: n FRE^2 = |a|^2 + |b|^2 - 2 (s1 + s2 + d s3), with d = det(U V^T) for a motion and -d for a mirror image (Umeyama,
IEEE Trans. PAMI 13 (1991) 376).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from needleplan.estimation.registration._measurements import axes_of
from needleplan.signals import Array

__all__ = ["Pairing", "best_scale", "pairings", "quaternion_orders"]

# Largest number of points of which all orders are tried.
_MOST_PERMUTED = 7


@dataclass(frozen=True)
class Pairing:
    """An order of the points of the plan, with or without a mirrored frame, and its FRE (mm).

    `order[k]` is the index of the plan's point that belongs to point k of the tracker.
    """

    order: tuple[int, ...]
    mirrored: bool
    fre_mm: float

    @property
    def given(self) -> bool:
        """Whether the points are in the order of the file."""
        return self.order == tuple(range(len(self.order)))

    def described(self, names: tuple[str, ...]) -> str:
        """Return the pairing in words; `names` are the names of the points."""
        moved = [k for k, other in enumerate(self.order) if other != k]
        if not moved:
            order = "the given pairs"
        elif self.order == tuple(range(len(self.order)))[::-1] and len(moved) > 2:
            order = "the plan's points in reversed order"
        elif len(moved) == 2:
            order = f"{names[moved[0]]} and {names[moved[1]]} exchanged in one of the frames"
        else:
            pairs = ", ".join(f"{names[k]} to that of {names[self.order[k]]}" for k in moved)
            order = f"the tracker's points paired with other points of the plan ({pairs})"
        return f"{order}, with one axis of a frame mirrored" if self.mirrored else order


def pairings(first_mm: Array, second_mm: Array) -> list[Pairing]:
    """Return other pairings and mirror images of the points, best first.

    Parameters
    ----------
    first_mm, second_mm : array, shape (n, 3)
        Points of the tracker and of the plan in the given order.

    Returns
    -------
    list of Pairing
        Of up to seven points, all orders with and without a mirror image; of more, the given order, its reversal and
        all exchanges of two points. The given order without a mirror image is left out.

    """
    first, second = first_mm - first_mm.mean(axis=0), second_mm - second_mm.mean(axis=0)
    orders = np.array(list(_orders(len(first))))
    cross = np.einsum("ki,pkj->pij", first, second[orders])
    singular = np.linalg.svd(cross, compute_uv=False)
    sign = np.where(np.linalg.det(cross) < 0, -1.0, 1.0)
    whole = float((first**2).sum() + (second**2).sum())
    choices = []
    for mirrored in (False, True):
        last = singular[:, 2] * (-sign if mirrored else sign)
        squares = whole - 2 * (singular[:, 0] + singular[:, 1] + last)
        fre = np.sqrt(np.maximum(squares, 0.0) / len(first))
        choices += [
            Pairing(tuple(order), mirrored, fre_mm)
            for order, fre_mm in zip(orders.tolist(), fre.tolist(), strict=True)
            if mirrored or order != list(range(len(first)))
        ]
    return sorted(choices, key=lambda pairing: pairing.fre_mm)


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    if count <= _MOST_PERMUTED:
        yield from permutations(range(count))
        return
    yield tuple(range(count))
    yield tuple(range(count))[::-1]
    for one, other in combinations(range(count), 2):
        order = list(range(count))
        order[one], order[other] = other, one
        yield tuple(order)


def best_scale(first_mm: Array, second_mm: Array) -> tuple[float, float]:
    """Return the scale from the first to the second points, and the FRE (mm) of the best motion with this scale."""
    first, second = first_mm - first_mm.mean(axis=0), second_mm - second_mm.mean(axis=0)
    cross = first.T @ second
    singular = np.linalg.svd(cross, compute_uv=False)
    trace = float(singular[0] + singular[1] + (-1 if np.linalg.det(cross) < 0 else 1) * singular[2])
    squares = float((second**2).sum()) - trace**2 / float((first**2).sum())
    return trace / float((first**2).sum()), float(np.sqrt(max(squares, 0.0) / len(first)))


def quaternion_orders(quaternions: Array) -> dict[str, Array]:
    """Return the z axes, shape (n, 3), of quaternions, shape (n, 4), in other conventions, by description."""
    last, first = quaternions[:, [3, 0, 1, 2]], quaternions[:, [1, 2, 3, 0]]
    inverse = np.array([1.0, -1.0, -1.0, -1.0])
    return {
        "the columns qw, qx, qy, qz hold x, y, z, w": axes_of(last),
        "the columns qx, qy, qz, qw hold w, x, y, z": axes_of(first),
        "the rotations are inverse": axes_of(quaternions * inverse),
        "the columns qw, qx, qy, qz hold x, y, z, w, and the rotations are inverse": axes_of(last * inverse),
        "the columns qx, qy, qz, qw hold w, x, y, z, and the rotations are inverse": axes_of(first * inverse),
    }
