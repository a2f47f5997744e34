"""95 % intervals of what was fitted, and whether the size of an effect is there at all.

A size with a direction is a vector. Where the base takes up the part along the bevel, only the part across is known:
size and direction are then both vague, and linear intervals of the two say nothing. Its two components are what is
normal, so the interval of the size is that of the lengths of all vectors in their ellipse.

A size that trades with another parameter, such as the length over which an effect fades, is vague too, and yet not
zero: whether it is there is asked with the others held.
"""

from __future__ import annotations

import numpy as np

from needleplan.diagnosis.refit import Joint
from needleplan.models.effects import SIZE
from needleplan.signals import Array

__all__ = ["DIRECTION", "interval_of", "is_possible", "is_there"]

DIRECTION = "direction_rad"
_TWO_SIDED = 1.959964
_POINTS = 720
_FURTHEST = 50.0
"""Of a coordinate: beyond, nothing is known of it."""


def interval_of(joint: Joint, which: int, name: str) -> tuple[float, float]:
    """Return the 95 % interval of a parameter of an effect, within its bounds.

    Where that of a size that is there would hold zero, since another size at another place does as well, it is taken
    for its logarithm.
    """
    each = joint.added[which]
    what, value = each.effect.parameters[name], each.values[name]
    if not what.free:
        return value, value
    if name != SIZE:
        step = min(_TWO_SIDED * joint.sd(which, name) / what.slope(value), _FURTHEST)
        ends = what.value(what.coordinate(value) - step), what.value(what.coordinate(value) + step)
    else:
        ends = _ends(joint.covariance, joint, which)
        if ends[0] * ends[1] <= 0 and is_there(joint, which):
            factor = float(np.exp(min(max(abs(end - value) for end in ends) / abs(value), _FURTHEST)))
            ends = value / factor, value * factor
    low, high = (float(np.clip(end, what.lower, what.upper)) for end in ends)
    return min(low, high, value), max(low, high, value)


def is_there(joint: Joint, which: int) -> bool:
    """Whether the size of an effect differs from zero, its places and times held: at zero there are none."""
    kept = [row for row, (index, name) in enumerate(joint.names) if index != which or name in (SIZE, DIRECTION)]
    # In units of the standard deviations: one that is vague must not hide one that is known.
    scale = np.sqrt(np.maximum(np.diag(joint.covariance), 1e-300))
    precision = np.linalg.pinv(joint.covariance / np.outer(scale, scale), hermitian=True)[np.ix_(kept, kept)]
    covariance = np.zeros_like(joint.covariance)
    covariance[np.ix_(kept, kept)] = np.linalg.pinv(precision, hermitian=True)
    covariance *= np.outer(scale, scale)
    low, high = _ends(covariance, joint, which)
    return low * high > 0


def is_possible(joint: Joint, which: int) -> bool:
    """Whether the size of an effect is within its bounds, and not at one of them."""
    each = joint.added[which]
    what, size = each.effect.parameters[SIZE], each.values[SIZE]
    sd = joint.sd(which, SIZE)
    within = what.lower - 2 * sd <= size <= what.upper + 2 * sd
    return bool(within and size not in (what.lower, what.upper))


def _ends(covariance: Array, joint: Joint, which: int) -> tuple[float, float]:
    """Return the interval of a size; of one with a direction, that of the lengths of its vectors."""
    each = joint.added[which]
    size, unit = each.values[SIZE], each.effect.parameters[SIZE].typical
    row = joint.names.index((which, SIZE))
    if DIRECTION not in each.effect.parameters:
        sd = unit * float(np.sqrt(max(covariance[row, row], 0.0)))
        return size - _TWO_SIDED * sd, size + _TWO_SIDED * sd
    angle, rows = each.values[DIRECTION], [row, joint.names.index((which, DIRECTION))]
    units = np.array([unit, each.effect.parameters[DIRECTION].typical])
    turn = np.array([[np.cos(angle), -size * np.sin(angle)], [np.sin(angle), size * np.cos(angle)]]) * units
    vector = size * np.array([np.cos(angle), np.sin(angle)])
    values, axes = np.linalg.eigh(turn @ covariance[np.ix_(rows, rows)] @ turn.T)
    radii = _TWO_SIDED * np.sqrt(np.maximum(values, 0.0))
    round_ = np.linspace(0.0, 2 * np.pi, _POINTS, endpoint=False)
    edge = vector[:, None] + axes @ (radii[:, None] * np.array([np.cos(round_), np.sin(round_)]))
    lengths = np.hypot(*edge)
    inside = bool(((axes.T @ vector / np.maximum(radii, 1e-9 * abs(size))) ** 2).sum() <= 1)
    low, high = (0.0 if inside else float(lengths.min())), float(lengths.max())
    return (low, high) if size >= 0 else (-high, -low)
