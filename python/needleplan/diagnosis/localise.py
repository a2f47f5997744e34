"""Where a gap lies: its energy by depth, speed, phase, time and trial, and where it begins.

What smooth functions see of the residual, with all that the base can take up projected out, is cut into bins. Without a
gap the coefficients of these functions are independent and normal: drawn as such, they say how large the greatest bin
of an axis gets by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.rivals import omnibus
from needleplan.diagnosis.space import Space
from needleplan.signals import Array, Motion

__all__ = ["Bin", "ChangePoint", "Localisation", "Phase", "localise", "phases"]

_RUNS = 400
_AT_REST = 0.02
_REVERSAL_MM = 2.0
_INTERVAL = 3.84
"""Twice the log likelihood that a change point may lose within its 95 % interval."""


class Phase(StrEnum):
    """What the needle does."""

    ADVANCE = "advance"
    HOLD = "hold"
    REVERSAL = "reversal"
    """The first millimetres after a change of direction."""

    RETRACTION = "retraction"
    ROTATED = "after a rotation"


@dataclass(frozen=True)
class Bin:
    """A part of the data: its share of the gap's energy, and how often chance makes the greatest bin as large."""

    axis: str
    label: str
    share: float
    p_value: float


@dataclass(frozen=True)
class ChangePoint:
    """Where a step fits best, with the interval within which it fits nearly as well, and what it gains."""

    axis: Axis
    place: float
    low: float
    high: float
    unit: str
    gain: float


@dataclass(frozen=True)
class Localisation:
    """All bins, the change points that gain more than they cost, and the energy that smooth functions see."""

    bins: tuple[Bin, ...]
    changes: tuple[ChangePoint, ...]
    energy: float
    freedom: int

    def where(self, p_value: float = 0.01) -> tuple[Bin, ...]:
        """Return the bins that chance does not explain, the greatest share first."""
        return tuple(sorted((each for each in self.bins if each.p_value <= p_value), key=lambda each: -each.share))


def localise(space: Space, cases: Sequence[Case], *, seed: int = 0) -> Localisation:
    """Return where the gap lies that the base of `space` leaves in `cases`."""
    smooth, residual, rows = _projected(space, cases)
    left, singular, _ = np.linalg.svd(smooth, full_matrices=False)
    kept = left[:, singular > 1e-6 * singular[0]]
    coefficients = kept.T @ residual
    drawn = np.random.default_rng(seed).standard_normal((kept.shape[1], _RUNS))
    bins: list[Bin] = []
    total = float(coefficients @ coefficients)
    for axis, labels in _labels(cases).items():
        whole = np.concatenate([np.asarray(each)[row] for each, row in zip(labels, rows, strict=True)])
        if len(set(whole.tolist())) < 2:  # of one part it says nothing that it has all of the gap
            continue
        bins += _binned(axis, whole, kept, coefficients, drawn, total)
    return Localisation(tuple(bins), tuple(_changes(space, cases)), total, kept.shape[1])


def phases(motion: Motion) -> Array:
    """Return the phase of every sample, shape (samples,) of texts."""
    speed = np.abs(motion.velocity_mm_s)
    still = speed <= _AT_REST * max(float(speed.max()), 1e-12)
    found = np.where(motion.direction > 0, Phase.ADVANCE.value, Phase.RETRACTION.value).astype(object)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.depth_mm)))])
    turned = np.flatnonzero(np.diff(motion.direction) != 0) + 1
    for index in turned[motion.direction[turned - 1] != 0]:
        found[(way >= way[index]) & (way < way[index] + _REVERSAL_MM)] = Phase.REVERSAL.value
    rotated = np.flatnonzero(np.abs(np.diff(motion.angle_rad)) > 1e-6) + 1
    for index in rotated:
        found[(way >= way[index]) & (way < way[index] + _REVERSAL_MM)] = Phase.ROTATED.value
    found[still] = Phase.HOLD.value
    return np.asarray(found)


def _projected(space: Space, cases: Sequence[Case]) -> tuple[Array, Array, list[NDArray[np.intp]]]:
    """Return smooth functions and residual, weighed by the tissue's variation and free of the base, and which rows."""
    smooth: list[Array] = []
    residual: list[Array] = []
    rows: list[NDArray[np.intp]] = []
    level = space.levels[space.best]
    for case, each in zip(cases, omnibus(cases), strict=True):
        block, sure = case.block, _sure(case)
        share = 1 - 1 / np.sqrt(1 + level**2 * block.variances)
        weighed = [
            (values - block.modes @ (share[:, None] * (block.modes.T @ values))) * sure[:, None]
            for values in (block.sensitivities, each, block.residual[:, None])
        ]
        basis = np.linalg.qr(weighed[0])[0]
        count = int(case.rows.sum())
        smooth.append((weighed[1] - basis @ (basis.T @ weighed[1]))[:count])
        residual.append((weighed[2] - basis @ (basis.T @ weighed[2]))[:count, 0])
        rows.append(case.samples())
    return np.vstack(smooth), np.concatenate(residual), rows


def _sure(case: Case) -> Array:
    """Return 1 for the whitened samples of a trial, 0 for those at which the moment of a sudden change is not known.

    What is left there is large and says nothing of a place; it would make the greatest bin by far too certain.
    """
    moved = measurand_of(case.model.channel).moments(case.predicted, case.motion)
    raw = np.any(moved != 0, axis=1) if moved.shape[1] else np.zeros(len(case.predicted), bool)
    axes = np.split(raw, len(raw) // len(case.motion))
    whitened = np.concatenate([axis[case.noise.order :] for axis in axes])[case.rows]
    return np.append(~whitened, np.ones(case.block.samples - len(whitened), bool)).astype(float)


def _labels(cases: Sequence[Case]) -> dict[str, list[Array]]:
    motions = [case.motion for case in cases]
    return {
        "depth_mm": _cut([each.depth_mm for each in motions], 10, "mm"),
        "speed_mm_s": _cut([np.abs(each.velocity_mm_s) for each in motions], 5, "mm/s"),
        "time_s": _cut([each.time_s - each.time_s[0] for each in motions], 8, "s"),
        "phase": [phases(each) for each in motions],
        "trial": [np.full(len(case.motion), case.record.trial, dtype=object) for case in cases],
    }


def _cut(values: Sequence[Array], count: int, unit: str) -> list[Array]:
    low, high = min(float(each.min()) for each in values), max(float(each.max()) for each in values)
    edges = np.linspace(low, high, count + 1)
    names = np.array([f"{begin:.3g} to {end:.3g} {unit}" for begin, end in pairwise(edges)], dtype=object)
    return [names[np.clip(np.searchsorted(edges, each, side="right") - 1, 0, count - 1)] for each in values]


def _binned(axis: str, labels: Array, basis: Array, coefficients: Array, drawn: Array, total: float) -> list[Bin]:
    names = list(dict.fromkeys(labels.tolist()))
    found, chance = [], []
    for name in names:
        part = basis[labels == name]
        gram = part.T @ part
        by_chance = (drawn * (gram @ drawn)).sum(axis=0)
        mean, spread = float(np.trace(gram)), float(np.sqrt(2 * np.sum(gram**2))) + 1e-12
        energy = float(coefficients @ gram @ coefficients)
        found.append((name, energy, (energy - mean) / spread))
        chance.append((by_chance - mean) / spread)
    greatest = np.max(chance, axis=0)
    return [
        Bin(axis, str(name), energy / max(total, 1e-12), float((1 + np.sum(greatest >= score)) / (1 + greatest.size)))
        for name, energy, score in found
    ]


def _changes(space: Space, cases: Sequence[Case]) -> list[ChangePoint]:
    deepest = max(float(case.motion.depth_mm.max()) for case in cases)
    longest = max(float(case.motion.time_s[-1] - case.motion.time_s[0]) for case in cases)
    price = 2 * float(np.log(space.samples))
    found = []
    for axis, unit, grid in (
        (Axis.DEPTH, "mm", np.arange(2.0, deepest - 1, 0.5)),
        (Axis.TIME, "s", np.arange(0.5, longest - 0.5, 0.25)),
    ):
        if not grid.size:
            continue
        columns = []
        for case in cases:
            motion = case.motion
            forward = np.where(motion.direction > 0, 1.0, 0.0)[:, None]
            past = motion.depth_mm[:, None] >= grid if axis is Axis.DEPTH else motion.time_s[:, None] >= grid
            columns.append(case.whiten(case.spread(np.asarray(past * (forward if axis is Axis.DEPTH else 1.0), float))))
        gains, _ = space.scores(columns).gains()
        gains = gains.reshape(-1, len(grid)).max(axis=0)
        best = int(gains.argmax())
        near = np.flatnonzero(gains > gains[best] - _INTERVAL)
        if gains[best] > price:
            ends = float(grid[near[0]]), float(grid[near[-1]])
            found.append(ChangePoint(axis, float(grid[best]), *ends, unit, float(gains[best])))
    return found
