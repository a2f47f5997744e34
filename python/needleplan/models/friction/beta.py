"""The term beta of the averaged LuGre model: what the spread of the normal force does to the mean bristle.

For bristles that are carried along the shaft with the speed v, whose bending is z = psi(zeta) phi(t), psi =
zeta^lambda, the mean bending weighted with fn obeys (thesis, (3.11)) z' = v - sigma0 |v| z/g + beta v z, and by parts

    beta = [ int_0^L psi fn' dzeta - psi(L) fn(L) ] / int_0^L psi fn dzeta.

What was wrong in print: (3.12) divides its last term by Fn where it has to be Fn z; (3.16), the right trapezoid, leaves
that term out although fn(L) = f is not zero there, and so becomes practically zero (positive, 5e-10 to 2e-3 per mm at
L = 76 mm) where it should be -0.017 to -0.079. (3.17), the isosceles one, is right.

What no choice of psi mends: the partial differential equation gives a bending that is flat beyond the first g/sigma0
(0.03 to 0.5 mm), which is lambda -> 0 and beta -> 0. See `needleplan.models.friction.distributed`.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from needleplan.models.friction.profile import Profile
from needleplan.signals import Array

__all__ = ["Beta", "beta_per_mm"]

_SHORTEST_MM = 1e-3
"""Shorter patches count as this long: beta grows as 1/L."""


class Beta(StrEnum):
    """Which term stands in the equation."""

    TRANSPORT = "transport"
    """beta v: (3.17) for the isosceles trapezoid, (3.16) with its end term for the right one.

    It lowers |F| on insertion and raises it on retraction, by 2 to 5 % each, and makes the bristle unstable on
    retraction where -beta > sigma0/g (isosceles, lambda 5: below a length of 1.4 to 4.4 mm).
    """

    PRINTED = "printed"
    """beta v as printed: (3.16) without its end term for the right trapezoid; (3.17) for the isosceles one."""

    ABSOLUTE = "absolute"
    """beta |v|, isosceles only: a patch of fixed length that fresh bristles enter at whichever end is upstream."""

    TIP = "tip"
    """beta v for a tip inside of the tissue, L' = v, where fn grows with the patch (Leibniz's rule); 0 for lambda 0."""


def beta_per_mm(profile: Profile, term: Beta, length_mm: Array, ramp_mm: float, exponent: float) -> Array:
    """Return beta (1/mm) for inserted lengths, any shape; `profile` is RIGHT or ISOSCELES, `exponent` lambda >= 0."""
    length = np.maximum(np.asarray(length_mm, float), _SHORTEST_MM)
    # Each branch is evaluated on lengths of its own side only, so that no power of a negative number appears.
    if profile is Profile.RIGHT:
        short, long = np.minimum(length, ramp_mm), np.maximum(length, ramp_mm)
        triangle, trapezoid = _right(term, short, long, ramp_mm, exponent)
        return np.where(length <= ramp_mm, triangle, trapezoid)
    short, long = np.minimum(length, 2 * ramp_mm), np.maximum(length, 2 * ramp_mm)
    triangle, trapezoid = _isosceles(term, short, long, ramp_mm, exponent)
    return np.where(length <= 2 * ramp_mm, triangle, trapezoid)


def _right(term: Beta, short: Array, long: Array, w: float, lam: float) -> tuple[Array, Array]:
    below = (lam + 2) * long ** (lam + 1) - w ** (lam + 1)
    rising = (lam + 2) / ((lam + 1) * short), (lam + 2) * w**lam / below
    if term is Beta.PRINTED:
        return rising
    if term is Beta.TIP:
        return rising[0] - 2 / short, rising[1] - 1 / (long - w / 2)
    end = (lam + 2) / short, (lam + 2) * (lam + 1) * long**lam / below
    return rising[0] - end[0], rising[1] - end[1]


def _isosceles(term: Beta, short: Array, long: Array, w: float, lam: float) -> tuple[Array, Array]:
    power = 2 ** (lam + 1)
    weight = long ** (lam + 2) - (long - w) ** (lam + 2) - w ** (lam + 2)
    if term is Beta.TIP:
        triangle = ((lam + 2) / (power - 1) - 2) / short
        return triangle, (lam + 2) * w ** (lam + 1) / weight - 1 / (long - w)
    triangle = -2 * (lam + 2) * (2**lam - 1) / (power - 1) / short
    return triangle, (lam + 2) * ((long - w) ** (lam + 1) + w ** (lam + 1) - long ** (lam + 1)) / weight
