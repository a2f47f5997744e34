"""Where the gap is: parts of the motions with their shares of the residual, and curves along an axis.

The residual is that of the readings at the posterior mean of a hypothesis: base parameters, tolerances and tissue are
taken out, and noise and errors whitened. Without a gap it is white with variance 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from needleplan.artifacts import CallRepr
from needleplan.diagnosis._constants import REST_SPEED_SHARE
from needleplan.diagnosis._evidence import Columns
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis.channels import GapAxis
from needleplan.signals import Array, Motion

__all__ = [
    "Curve", "Curves", "GapPart", "MotionPhase", "axis_values", "curves_along", "gap_parts", "motion_phases",
    "residuals_of",
]  # fmt: skip

# Numbers of bins of depth, speed and time.
_DEPTHS, _SPEEDS, _TIMES = 10, 5, 8
# Travel (mm) after a change of direction, or a rotation, that is assigned to that phase.
_REVERSAL_MM = 2.0
# Number of nodes of a curve, and its extension beyond each end of the visited range, as a share of that range.
_NODES, _BEYOND = 25, 0.2
# Correlation lengths tried, as shares of the visited range, and prior amplitudes tried, in units of the noise RMS.
_LENGTHS, _AMPLITUDES = (0.08, 0.15, 0.3, 0.6), np.geomspace(0.02, 200.0, 17)

# Unit of each axis.
_UNITS = {
    GapAxis.TIME: "s",
    GapAxis.DEPTH: "mm",
    GapAxis.SPEED: "mm/s",
    GapAxis.ACCELERATION: "mm/s2",
    GapAxis.FORCE: "N",
    GapAxis.DWELL: "s",
    GapAxis.PERIOD: "mm",
}

_ADVANCE, _RETRACTION, _REST, _ANY = "advance", "retraction", "rest", "any"

# Ways of moving that have separate curves; other axes have one curve for all motion.
_WAYS = {
    GapAxis.DEPTH: (_ADVANCE, _RETRACTION),
    GapAxis.PERIOD: (_ADVANCE, _RETRACTION),
    GapAxis.SPEED: (_ADVANCE, _RETRACTION),
    GapAxis.DWELL: (_REST,),
}


class MotionPhase(StrEnum):
    """Phase of the needle's motion. The values are those of `diagnosis.json`."""

    ADVANCE = "advance"
    DWELL = "hold"
    REVERSAL = "reversal"
    """The first millimetres of travel after a change of direction."""

    RETRACTION = "retraction"
    ROTATED = "after a rotation"
    """The first millimetres of travel after a rotation."""


@dataclass(frozen=True)
class GapPart:
    """A part of the motions: a range of an axis, a phase of the motion, or a trial."""

    axis: str
    label: str
    share: float
    """Share of the residual energy above that of the noise, in all parts of the axis."""

    p_value: float
    """Probability that noise alone has this energy in any part of the axis."""


def residuals_of(hypothesis: Hypothesis, best: Hypothesis | None = None) -> list[Array]:
    """Return the residual of each trial at the posterior mean.

    Parameters
    ----------
    hypothesis
        A fitted set of effects.
    best
        Hypothesis from which heterogeneity, noise variance and scales of the tolerances are taken; by default the
        hypothesis itself.

    Returns
    -------
    list of Array
        Whitened residual of each trial in standard deviations of the noise, shape (axes * samples,), without the first
        samples of each axis that the autoregression of the noise takes.
    """
    best = best or hypothesis
    h, linear = best.best, hypothesis.with_scales(best.scales).linear
    return [
        left[: trial.readings] / np.sqrt(best.noise_variance)
        for trial, left in zip(hypothesis.trials, linear.residuals(h, linear.mean[h]), strict=True)
    ]


def gap_parts(hypothesis: Hypothesis, best: Hypothesis) -> tuple[GapPart, ...]:
    """Return the parts of all axes with their shares of the gap that a hypothesis leaves, the largest first.

    Heterogeneity, noise variance and scales of the tolerances are those of the most probable set, `best`.
    """
    energies = np.concatenate([each**2 for each in residuals_of(hypothesis, best)])
    found: list[GapPart] = []
    for axis, labels in _labels(hypothesis).items():
        whole = np.concatenate(labels)
        parts = [(str(name), energies[whole == name]) for name in dict.fromkeys(whole.tolist())]
        excess = [max(float(own.sum()) - len(own), 0.0) for _, own in parts]
        if len(parts) < 2 or not sum(excess):  # a single part holds the whole gap: no information
            continue
        for (name, own), more in zip(parts, excess, strict=True):
            chance = min(len(parts) * float(chdtrc(len(own), own.sum())), 1.0)
            found.append(GapPart(axis, name, more / sum(excess), chance))
    return tuple(sorted(found, key=lambda each: -each.share))


def _labels(hypothesis: Hypothesis) -> dict[str, list[Array]]:
    """Return for each axis the label of the part of each sample, one array per trial."""
    trials = hypothesis.trials
    motions = [trial.motion for trial in trials]
    found = {
        "depth_mm": list(_cut([motion.depth_mm for motion in motions], _DEPTHS, "mm")),
        "speed_mm_s": list(_cut([np.abs(motion.velocity_mm_s) for motion in motions], _SPEEDS, "mm/s")),
        "time_s": list(_cut([motion.time_s - motion.time_s[0] for motion in motions], _TIMES, "s")),
        "phase": [motion_phases(motion) for motion in motions],
        "trial": [np.full(len(trial.motion), trial.record.trial, dtype=object) for trial in trials],
    }
    return {
        axis: [each[trial.samples()] for each, trial in zip(labels, trials, strict=True)]
        for axis, labels in found.items()
    }


def _cut(values: Sequence[Array], count: int, unit: str) -> Iterator[Array]:
    low, high = min(float(value.min()) for value in values), max(float(value.max()) for value in values)
    edges = np.linspace(low, high, count + 1)
    names = np.array([f"{begin:.3g} to {end:.3g} {unit}" for begin, end in pairwise(edges)], dtype=object)
    for value in values:
        yield names[np.clip(np.searchsorted(edges, value, side="right") - 1, 0, count - 1)]


def motion_phases(motion: Motion) -> Array:
    """Return the value of `MotionPhase` at each sample, as an array of str, shape (samples,).

    Where several phases apply, a dwell has priority over the travel after a rotation, which has priority over that
    after a change of direction.
    """
    speed = np.abs(motion.velocity_mm_s)
    still = speed <= REST_SPEED_SHARE * max(float(speed.max()), 1e-12)
    found = np.where(motion.direction > 0, MotionPhase.ADVANCE.value, MotionPhase.RETRACTION.value).astype(object)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.depth_mm)))])
    turned = np.flatnonzero(np.diff(motion.direction) != 0) + 1
    for index in turned[motion.direction[turned - 1] != 0]:
        found[(way >= way[index]) & (way < way[index] + _REVERSAL_MM)] = MotionPhase.REVERSAL.value
    rotated = np.flatnonzero(np.abs(np.diff(motion.angle_rad)) > 1e-6) + 1
    for index in rotated:
        found[(way >= way[index]) & (way < way[index] + _REVERSAL_MM)] = MotionPhase.ROTATED.value
    found[still] = MotionPhase.DWELL.value
    return np.asarray(found)


@dataclass(frozen=True)
class Curve(CallRepr):
    """Difference of measurement and model as a function of an axis variable, such as depth, for one kind of motion.

    All arrays have the shape (nodes,). `mean` and `sd` are in the unit of the channel.
    """

    way: str
    """Kind of motion: `advance`, `retraction`, `rest` or `any`."""

    places: Array
    """Values of the axis variable, in the unit of the axis."""

    mean: Array
    """Posterior mean of the difference."""

    sd: Array
    """Posterior standard deviation of the difference."""

    inside: NDArray[np.bool_]
    """Whether each node lies in the visited range; at other nodes `sd` approaches that of the prior."""


@dataclass(frozen=True)
class Curves(CallRepr):
    """All curves along an axis, and the standard deviation of their prior."""

    axis: GapAxis
    unit: str
    curves: tuple[Curve, ...]
    prior_sd: float

    @property
    def rms(self) -> float:
        """RMS of the curves within the visited range; 1 if they are 0."""
        values = np.concatenate([curve.mean[curve.inside] for curve in self.curves])
        return float(np.sqrt(np.mean(values**2))) or 1.0 if values.size else 1.0


def curves_along(axis: GapAxis, hypothesis: Hypothesis) -> Curves:
    """Return the output that is missing beside a hypothesis, as curves along an axis.

    A curve is a Gaussian process with a squared-exponential correlation, whose amplitude and correlation length
    maximise the likelihood. Where the base model absorbs the gap, and outside the visited range, the standard deviation
    of the curve approaches that of the prior.
    """
    trials, problem = hypothesis.trials, hypothesis.problem
    values = [axis_values(axis, trial.motion, trial.output) for trial in trials]
    ways = _WAYS.get(axis, (_ANY,))
    masks = [[_movement_mask(way, trial.motion) for trial in trials] for way in ways]
    low, high = min(float(each.min()) for each in values), max(float(each.max()) for each in values)
    span = max(high - low, 1e-9)
    count = _NODES if axis is not GapAxis.PERIOD else 3 * _NODES
    places = np.linspace(low - _BEYOND * span, high + _BEYOND * span, count)
    hats = [np.column_stack([np.interp(each, places, node) for node in np.eye(count)]) for each in values]
    columns = Columns(hypothesis.linear.blocks, [
        problem.whiten(trial, n, np.column_stack([hats[n] * masks[way][n][:, None] for way in range(len(ways))]))
        for n, trial in enumerate(trials)
    ])  # fmt: skip
    projected = hypothesis.linear.project(columns, np.array([hypothesis.best]))
    matrix = hypothesis.linear.normals(columns, projected, np.arange(columns.count)[None])[0, 0]
    mean, covariance, prior_sd = _posterior(
        matrix, projected.slope[0], places, len(ways), span, problem.calibration.noise.rms
    )
    found = []
    for index, way in enumerate(ways):
        part = slice(index * count, (index + 1) * count)
        visited = np.concatenate([value[mask > 0] for value, mask in zip(values, masks[index], strict=True)])
        inside = (places >= visited.min()) & (places <= visited.max()) if visited.size else np.zeros(count, bool)
        sd = np.sqrt(np.maximum(np.diag(covariance)[part], 0.0))
        found.append(Curve(way, places, mean[part], sd, inside))
    return Curves(axis, _UNITS[axis], tuple(found), prior_sd)


def axis_values(axis: GapAxis, motion: Motion, force: Array) -> Array:
    """Return the value of an axis variable at each sample, shape (samples,); `force` is the base model's output.

    Values of DWELL are the time since the needle came to rest, 0 in motion. Values of PERIOD are the depth.
    """
    if axis is GapAxis.TIME:
        return np.asarray(motion.time_s - motion.time_s[0], float)
    if axis is GapAxis.SPEED:
        return np.abs(motion.velocity_mm_s)
    if axis is GapAxis.ACCELERATION:
        return motion.acceleration_mm_s2
    if axis is GapAxis.FORCE:
        return np.asarray(force, float)
    if axis is GapAxis.DWELL:
        rest = _movement_mask(_REST, motion) > 0
        began = np.maximum.accumulate(np.where(rest, -np.inf, motion.time_s))
        return np.where(rest, motion.time_s - np.where(np.isfinite(began), began, motion.time_s[0]), 0.0)
    return np.maximum(motion.depth_mm, 0.0)


def _movement_mask(way: str, motion: Motion) -> Array:
    """Return a mask, shape (samples,): 1 at samples of the given way of moving (such as advance), else 0."""
    speed = np.abs(motion.velocity_mm_s)
    rest = speed <= REST_SPEED_SHARE * max(float(speed.max()), 1e-12)
    if way == _ANY:
        return np.ones(len(motion))
    # Friction keeps its direction during a dwell, so curves by direction include dwells.
    mask = {_REST: rest, _ADVANCE: motion.direction > 0, _RETRACTION: motion.direction < 0}[way]
    return np.asarray(mask, float)


def _posterior(
    matrix: Array, target: Array, places: Array, ways: int, span: float, noise_sd: float
) -> tuple[Array, Array, float]:
    """Return mean and covariance at the nodes, and prior amplitude, for the prior that fits best."""
    best: tuple[float, Array, Array, float] | None = None
    distance = (places[:, None] - places) / span
    one = np.eye(len(target))
    for length in _LENGTHS:
        shape = np.kron(np.eye(ways), np.exp(-0.5 * (distance / length) ** 2) + 1e-6 * np.eye(len(places)))
        for amplitude in _AMPLITUDES * noise_sd:
            prior = amplitude**2 * shape
            # (M + K^-1)^-1 = K (1 + M K)^-1, without the inverse of a smooth K.
            solved = np.linalg.solve(one + matrix @ prior, np.column_stack([target[:, None], matrix]))
            mean = prior @ solved[:, 0]
            likelihood_gain = float(target @ mean) - float(np.linalg.slogdet(one + matrix @ prior)[1])
            if best is None or likelihood_gain > best[0]:
                best = likelihood_gain, mean, prior - prior @ solved[:, 1:] @ prior, float(amplitude)
    assert best is not None
    return best[1:]
