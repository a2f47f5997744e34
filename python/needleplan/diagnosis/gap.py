"""Where the gap is: bins of its energy, change points, and curves along an axis.

Smooth functions are fitted to the residual with the base model projected out, and the energy of the fit is divided into
bins. Without a gap the coefficients are independent and normal; random draws of them give the distribution of the
largest standardised energy of the bins of an axis.

A curve is a Gaussian process with a squared-exponential correlation. The amplitude and the correlation length of this
process maximise the likelihood, with the base model projected out. Outside the visited range, and in ranges in which
the base model absorbs the gap, the uncertainty band of the curve widens to that of the prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from needleplan.diagnosis.alternatives import smooth_sensitivities
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.channels import GapAxis, channel_description
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.signals import Array, Motion

__all__ = [
    "Bin",
    "ChangePoint",
    "Curve",
    "Curves",
    "Localisation",
    "MotionPhase",
    "axis_values",
    "curves_along",
    "localise",
    "motion_phases",
]

# Number of simulated data sets from which the p-values of bins are computed.
_CHANCE_RUNS = 400
# Share of the maximum speed below which the needle counts as at rest.
_REST_SPEED_SHARE = 0.02
# Travel (mm) after a change of direction, or a rotation, that is assigned to that phase.
_REVERSAL_MM = 2.0
# Drop of twice the log-likelihood at the ends of a change point's 95 % interval.
_CHI2_95 = 3.84
# Number of nodes of a curve.
_NODES = 25
# Extension of a curve beyond each end of the visited range, as a share of that range.
_BEYOND = 0.2
# Correlation lengths tried, as shares of the visited range.
_LENGTHS = (0.08, 0.15, 0.3, 0.6)
# Prior amplitudes tried, in units of the noise RMS.
_AMPLITUDES = np.geomspace(0.02, 200.0, 17)

# Unit of each axis.
_UNITS = {
    GapAxis.TIME: "s",
    GapAxis.DEPTH: "mm",
    GapAxis.SPEED: "mm/s",
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
class Bin:
    """A part of an axis, with its share of the gap's energy.

    The energy is standardised by the mean and the standard deviation that it has without a gap. The p-value is the
    probability that, without a gap, the largest standardised energy on the axis is at least that of this bin.
    """

    axis: str
    label: str
    share: float
    p_value: float


@dataclass(frozen=True)
class ChangePoint:
    """Depth or time (`place`) at which a step in the output fits best, with its 95 % interval and likelihood gain."""

    axis: GapAxis
    place: float
    low: float
    high: float
    unit: str
    likelihood_gain: float


@dataclass(frozen=True)
class Localisation:
    """Where the gap is: all bins, and the significant change points.

    `energy` and `degrees_of_freedom` belong to the fitted smooth functions.
    """

    bins: tuple[Bin, ...]
    changes: tuple[ChangePoint, ...]
    energy: float
    degrees_of_freedom: int

    def where(self, p_value: float = 0.01) -> tuple[Bin, ...]:
        """Return the bins with at most the given p-value, the largest share first."""
        return tuple(sorted((each for each in self.bins if each.p_value <= p_value), key=lambda each: -each.share))


def localise(likelihood: JointLikelihood, trials: Sequence[CalibratedTrial], *, seed: int = 0) -> Localisation:
    """Locate the gap that the model of `likelihood` leaves in `trials`; `seed` initialises the random draws."""
    smooth, residual, rows = _projected(likelihood, trials)
    left, singular, _ = np.linalg.svd(smooth, full_matrices=False)
    kept = left[:, singular > 1e-6 * singular[0]]
    coefficients = kept.T @ residual
    drawn = np.random.default_rng(seed).standard_normal((kept.shape[1], _CHANCE_RUNS))
    bins: list[Bin] = []
    total = float(coefficients @ coefficients)
    for axis, labels in _labels(trials).items():
        whole = np.concatenate([np.asarray(each)[row] for each, row in zip(labels, rows, strict=True)])
        if len(set(whole.tolist())) < 2:  # a single bin holds the whole gap: no information
            continue
        bins += _binned(axis, whole, kept, coefficients, drawn, total)
    return Localisation(tuple(bins), tuple(_changes(likelihood, trials)), total, kept.shape[1])


def motion_phases(motion: Motion) -> Array:
    """Return the value of `MotionPhase` at each sample, as an array of str, shape (samples,).

    Where several phases apply, a dwell has priority over the travel after a rotation, which has priority over that
    after a change of direction.
    """
    speed = np.abs(motion.velocity_mm_s)
    still = speed <= _REST_SPEED_SHARE * max(float(speed.max()), 1e-12)
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


def _projected(
    likelihood: JointLikelihood, trials: Sequence[CalibratedTrial]
) -> tuple[Array, Array, list[NDArray[np.intp]]]:
    """Return smooth functions and residual with the base model projected out, and the sample of each row by trial."""
    smooth: list[Array] = []
    residual: list[Array] = []
    rows: list[NDArray[np.intp]] = []
    heterogeneity_sd = likelihood.heterogeneity_sds[likelihood.best]
    for trial, each in zip(trials, smooth_sensitivities(trials), strict=True):
        whitened, reliable = trial.whitened, _reliable(trial)
        share = 1 - 1 / np.sqrt(1 + heterogeneity_sd**2 * whitened.variances)
        weighed = [
            (values - whitened.modes @ (share[:, None] * (whitened.modes.T @ values))) * reliable[:, None]
            for values in (whitened.base_sensitivities, each, whitened.residual[:, None])
        ]
        basis = np.linalg.qr(weighed[0])[0]
        count = int(trial.rows.sum())
        smooth.append((weighed[1] - basis @ (basis.T @ weighed[1]))[:count])
        residual.append((weighed[2] - basis @ (basis.T @ weighed[2]))[:count, 0])
        rows.append(trial.samples())
    return np.vstack(smooth), np.concatenate(residual), rows


def _reliable(trial: CalibratedTrial) -> Array:
    """Return 0 for whitened samples near a sudden change whose time is uncertain, 1 for all others.

    Timing errors cause large residuals at these samples, which would make the largest bin too significant.
    """
    moved = channel_description(trial.model.channel).turn_errors(trial.predicted, trial.motion)
    raw = np.any(moved != 0, axis=1) if moved.shape[1] else np.zeros(len(trial.predicted), bool)
    axes = np.split(raw, len(raw) // len(trial.motion))
    whitened = np.concatenate([axis[trial.noise.order :] for axis in axes])[trial.rows]
    return np.append(~whitened, np.ones(trial.whitened.samples - len(whitened), bool)).astype(float)


def _labels(trials: Sequence[CalibratedTrial]) -> dict[str, list[Array]]:
    """Return for each axis the label of the bin of each sample, one array per trial."""
    motions = [trial.motion for trial in trials]
    return {
        "depth_mm": _cut([each.depth_mm for each in motions], 10, "mm"),
        "speed_mm_s": _cut([np.abs(each.velocity_mm_s) for each in motions], 5, "mm/s"),
        "time_s": _cut([each.time_s - each.time_s[0] for each in motions], 8, "s"),
        "phase": [motion_phases(each) for each in motions],
        "trial": [np.full(len(trial.motion), trial.record.trial, dtype=object) for trial in trials],
    }


def _cut(values: Sequence[Array], count: int, unit: str) -> list[Array]:
    low, high = min(float(each.min()) for each in values), max(float(each.max()) for each in values)
    edges = np.linspace(low, high, count + 1)
    names = np.array([f"{begin:.3g} to {end:.3g} {unit}" for begin, end in pairwise(edges)], dtype=object)
    return [names[np.clip(np.searchsorted(edges, each, side="right") - 1, 0, count - 1)] for each in values]


def _binned(axis: str, labels: Array, basis: Array, coefficients: Array, drawn: Array, total: float) -> list[Bin]:
    """Return the bins of one axis with their shares and p-values."""
    names = list(dict.fromkeys(labels.tolist()))
    found, chance = [], []
    for name in names:
        part = basis[labels == name]
        gram = part.T @ part
        by_chance = (drawn * (gram @ drawn)).sum(axis=0)
        mean, sd = float(np.trace(gram)), float(np.sqrt(2 * np.sum(gram**2))) + 1e-12
        energy = float(coefficients @ gram @ coefficients)
        found.append((name, energy, (energy - mean) / sd))
        chance.append((by_chance - mean) / sd)
    greatest = np.max(chance, axis=0)
    return [
        Bin(axis, str(name), energy / max(total, 1e-12), float((1 + np.sum(greatest >= score)) / (1 + greatest.size)))
        for name, energy, score in found
    ]


def _changes(likelihood: JointLikelihood, trials: Sequence[CalibratedTrial]) -> list[ChangePoint]:
    """Return the best change point in depth and the best in time, each only if its gain exceeds the BIC penalty."""
    deepest = max(float(trial.motion.depth_mm.max()) for trial in trials)
    longest = max(float(trial.motion.time_s[-1] - trial.motion.time_s[0]) for trial in trials)
    bic_penalty = 2 * float(np.log(likelihood.samples))
    found = []
    for axis, unit, grid in (
        (GapAxis.DEPTH, "mm", np.arange(2.0, deepest - 1, 0.5)),
        (GapAxis.TIME, "s", np.arange(0.5, longest - 0.5, 0.25)),
    ):
        if not grid.size:
            continue
        sensitivities = []
        for trial in trials:
            motion = trial.motion
            forward = np.where(motion.direction > 0, 1.0, 0.0)[:, None]
            past = motion.depth_mm[:, None] >= grid if axis is GapAxis.DEPTH else motion.time_s[:, None] >= grid
            sensitivities.append(
                trial.whiten(trial.on_each_axis(np.asarray(past * (forward if axis is GapAxis.DEPTH else 1.0), float)))
            )
        gains, _ = likelihood.scores(sensitivities).gains()
        gains = gains.reshape(-1, len(grid)).max(axis=0)
        best = int(gains.argmax())
        near = np.flatnonzero(gains > gains[best] - _CHI2_95)
        if gains[best] > bic_penalty:
            ends = float(grid[near[0]]), float(grid[near[-1]])
            found.append(ChangePoint(axis, float(grid[best]), *ends, unit, float(gains[best])))
    return found


@dataclass(frozen=True)
class Curve:
    """The missing output along an axis for one way of moving; all arrays have shape (nodes,)."""

    way: str
    places: Array
    mean: Array
    sd: Array
    inside: NDArray[np.bool_]
    """Whether each node lies in the visited range; at other nodes `sd` approaches that of the prior."""


@dataclass(frozen=True)
class Curves:
    """All curves along an axis, the standard deviation of their prior, and their likelihood gain."""

    axis: GapAxis
    unit: str
    curves: tuple[Curve, ...]
    prior_sd: float
    likelihood_gain: float


def curves_along(
    axis: GapAxis,
    trials: Sequence[CalibratedTrial],
    normal: Callable[[Sequence[Array]], tuple[Array, Array]],
) -> Curves:
    """Return curves of the missing output along an axis, fitted with the base model projected out.

    `normal` returns the normal matrix and the right side of columns (changes of the output, one array per trial).
    """
    values = [axis_values(axis, trial.motion, trial.output) for trial in trials]
    ways = _WAYS.get(axis, (_ANY,))
    masks = [[_movement_mask(way, trial.motion) for trial in trials] for way in ways]
    low, high = min(float(each.min()) for each in values), max(float(each.max()) for each in values)
    span = max(high - low, 1e-9)
    count = _NODES if axis is not GapAxis.PERIOD else 3 * _NODES
    places = np.linspace(low - _BEYOND * span, high + _BEYOND * span, count)
    hats = [_hats(each, places) for each in values]
    basis = [
        np.column_stack([hat * masks[way][at][:, None] for way in range(len(ways))]) for at, hat in enumerate(hats)
    ]
    matrix, target = normal(basis)
    likelihood_gain, mean, covariance, prior_sd = _posterior(
        matrix, target, places, len(ways), span, trials[0].noise.rms
    )
    found = []
    for index, way in enumerate(ways):
        part = slice(index * count, (index + 1) * count)
        there = [value[mask > 0] for value, mask in zip(values, masks[index], strict=True)]
        visited = np.concatenate(there) if there else np.zeros(0)
        inside = (places >= visited.min()) & (places <= visited.max()) if visited.size else np.zeros(count, bool)
        sd = np.sqrt(np.maximum(np.diag(covariance)[part], 0.0))
        found.append(Curve(way, places, mean[part], sd, inside))
    return Curves(axis, _UNITS[axis], tuple(found), prior_sd, likelihood_gain)


def axis_values(axis: GapAxis, motion: Motion, force: Array) -> Array:
    """Return the value of an axis variable at each sample, shape (samples,); `force` is the base model's output.

    Values of DWELL are the time since the needle came to rest, 0 in motion. Values of PERIOD are the depth.
    """
    if axis is GapAxis.TIME:
        return np.asarray(motion.time_s - motion.time_s[0], float)
    if axis is GapAxis.SPEED:
        return np.abs(motion.velocity_mm_s)
    if axis is GapAxis.FORCE:
        return np.asarray(force, float)
    if axis is GapAxis.DWELL:
        rest = _movement_mask(_REST, motion) > 0
        began = np.maximum.accumulate(np.where(rest, -np.inf, motion.time_s))
        return np.where(rest, motion.time_s - np.where(np.isfinite(began), began, motion.time_s[0]), 0.0)
    if axis is GapAxis.ANGLE:
        return np.asarray(motion.angle_rad, float)
    return np.maximum(motion.depth_mm, 0.0)


def _movement_mask(way: str, motion: Motion) -> Array:
    """Return a mask, shape (samples,): 1 at samples of the given way of moving (such as advance), else 0."""
    speed = np.abs(motion.velocity_mm_s)
    rest = speed <= _REST_SPEED_SHARE * max(float(speed.max()), 1e-12)
    if way == _ANY:
        return np.ones(len(motion))
    # Friction keeps its direction during a dwell, so curves by direction include dwells.
    mask = {_REST: rest, _ADVANCE: motion.direction > 0, _RETRACTION: motion.direction < 0}[way]
    return np.asarray(mask, float)


def _hats(values: Array, places: Array) -> Array:
    """Return the weights that interpolate node values linearly at `values`, shape (samples, nodes)."""
    return np.column_stack([np.interp(values, places, row) for row in np.eye(len(places))])


def _posterior(
    matrix: Array, target: Array, places: Array, ways: int, span: float, noise_sd: float
) -> tuple[float, Array, Array, float]:
    """Return likelihood gain, mean and covariance at the nodes, and prior amplitude, for the prior that fits best."""
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
    return best
