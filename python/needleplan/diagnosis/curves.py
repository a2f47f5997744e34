"""What no effect explains, as curves: along one axis, apart for each way of moving, with a band.

A curve is a random function with a squared-exponential correlation; its size and length are those under which the data
are most probable. What the base can take up is projected out first, so that a curve says nothing of it: there, and
beyond what the motions visited, the band is that of the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.space import Space
from needleplan.signals import Array, Motion

__all__ = ["Curve", "Curves", "axis_values", "curves_along"]

_NODES = 25
_BEYOND = 0.2
_LENGTHS = (0.08, 0.15, 0.3, 0.6)
"""Of the range that was visited."""

_SIZES = np.geomspace(0.02, 200.0, 17)
"""Of the noise's standard deviation."""

_AT_REST = 0.02
_UNITS = {Axis.TIME: "s", Axis.DEPTH: "mm", Axis.SPEED: "mm/s", Axis.FORCE: "N", Axis.HOLD: "s", Axis.PERIOD: "mm"}
_ADVANCE, _RETRACTION, _REST, _ANY = "advance", "retraction", "rest", "any"
_WAYS = {
    Axis.DEPTH: (_ADVANCE, _RETRACTION),
    Axis.PERIOD: (_ADVANCE, _RETRACTION),
    Axis.SPEED: (_ADVANCE, _RETRACTION),
    Axis.HOLD: (_REST,),
}


@dataclass(frozen=True)
class Curve:
    """What is missing in the force along an axis, in one way of moving; rows have the shape (nodes,)."""

    way: str
    places: Array
    mean: Array
    sd: Array
    inside: NDArray[np.bool_]
    """Whether the motions went there. Elsewhere the band is that of the prior."""


@dataclass(frozen=True)
class Curves:
    """All curves of an axis, the prior's standard deviation, and what the likelihood gains by them, twice."""

    axis: Axis
    unit: str
    curves: tuple[Curve, ...]
    prior_sd: float
    gain: float


def curves_along(axis: Axis, space: Space, cases: Sequence[Case]) -> Curves:
    """Return what is missing along an axis, beside all that the base can take up."""
    values = [axis_values(axis, case.motion, case.output) for case in cases]
    ways = _WAYS.get(axis, (_ANY,))
    masks = [[_moving(way, case.motion) for case in cases] for way in ways]
    low, high = min(float(each.min()) for each in values), max(float(each.max()) for each in values)
    span = max(high - low, 1e-9)
    count = _NODES if axis is not Axis.PERIOD else 3 * _NODES
    places = np.linspace(low - _BEYOND * span, high + _BEYOND * span, count)
    hats = [_hats(each, places) for each in values]
    basis = [
        case.whiten(np.column_stack([hat * masks[way][at][:, None] for way in range(len(ways))]))
        for at, (case, hat) in enumerate(zip(cases, hats, strict=True))
    ]
    matrix, target = space.normal(basis, space.best)
    gain, mean, covariance, prior_sd = _posterior(matrix, target, places, len(ways), span, cases[0].noise.rms)
    found = []
    for index, way in enumerate(ways):
        part = slice(index * count, (index + 1) * count)
        there = [value[mask > 0] for value, mask in zip(values, masks[index], strict=True)]
        visited = np.concatenate(there) if there else np.zeros(0)
        inside = (places >= visited.min()) & (places <= visited.max()) if visited.size else np.zeros(count, bool)
        sd = np.sqrt(np.maximum(np.diag(covariance)[part], 0.0))
        found.append(Curve(way, places, mean[part], sd, inside))
    return Curves(axis, _UNITS[axis], tuple(found), prior_sd, gain)


def axis_values(axis: Axis, motion: Motion, force: Array) -> Array:
    """Return where along an axis each sample is, shape (samples,); `force` is that of the base."""
    if axis is Axis.TIME:
        return np.asarray(motion.time_s - motion.time_s[0], float)
    if axis is Axis.SPEED:
        return np.abs(motion.velocity_mm_s)
    if axis is Axis.FORCE:
        return np.asarray(force, float)
    if axis is Axis.HOLD:
        rest = _moving(_REST, motion) > 0
        began = np.maximum.accumulate(np.where(rest, -np.inf, motion.time_s))
        return np.where(rest, motion.time_s - np.where(np.isfinite(began), began, motion.time_s[0]), 0.0)
    return np.maximum(motion.depth_mm, 0.0)


def _moving(way: str, motion: Motion) -> Array:
    speed = np.abs(motion.velocity_mm_s)
    rest = speed <= _AT_REST * max(float(speed.max()), 1e-12)
    if way == _ANY:
        return np.ones(len(motion))
    # Where friction points is as it was before a rest: a curve by the way of moving holds through it.
    mask = {_REST: rest, _ADVANCE: motion.direction > 0, _RETRACTION: motion.direction < 0}[way]
    return np.asarray(mask, float)


def _hats(values: Array, places: Array) -> Array:
    """Return the weights of linear interpolation between places, shape (samples, places)."""
    return np.column_stack([np.interp(values, places, row) for row in np.eye(len(places))])


def _posterior(
    matrix: Array, target: Array, places: Array, ways: int, span: float, noise_sd: float
) -> tuple[float, Array, Array, float]:
    """Return the gain, mean and covariance at the nodes, and the size of the prior, for the most probable prior."""
    best: tuple[float, Array, Array, float] | None = None
    distance = (places[:, None] - places) / span
    one = np.eye(len(target))
    for length in _LENGTHS:
        shape = np.kron(np.eye(ways), np.exp(-0.5 * (distance / length) ** 2) + 1e-6 * np.eye(len(places)))
        for size in _SIZES * noise_sd:
            prior = size**2 * shape
            # (M + K^-1)^-1 = K (1 + M K)^-1, without the inverse of a smooth K.
            solved = np.linalg.solve(one + matrix @ prior, np.column_stack([target[:, None], matrix]))
            mean = prior @ solved[:, 0]
            gain = float(target @ mean) - float(np.linalg.slogdet(one + matrix @ prior)[1])
            if best is None or gain > best[0]:
                best = gain, mean, prior - prior @ solved[:, 1:] @ prior, float(size)
    assert best is not None
    return best
