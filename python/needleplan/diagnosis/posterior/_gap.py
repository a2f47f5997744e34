"""Where the gap is: parts of the motions with their shares of the residual, and curves along an axis.

The residual is that of the readings at the posterior mean of a hypothesis: base parameters, tolerances and tissue are
taken out, and noise and errors whitened. Without a gap it is white with variance 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc

from needleplan.diagnosis.channels import GapAxis
from needleplan.diagnosis.gap import Curves, curves_along, motion_phases
from needleplan.diagnosis.posterior._evidence import Columns
from needleplan.diagnosis.posterior._hypothesis import Hypothesis
from needleplan.signals import Array

__all__ = ["GapPart", "course_of", "gap_parts", "residuals_of"]

# Numbers of bins of depth, speed and time.
_DEPTHS, _SPEEDS, _TIMES = 10, 5, 8


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
    """Return the residual of each trial at the posterior mean, in units of the noise, shape (rows of samples,).

    Heterogeneity and noise variance are those of `best`, by default those of the hypothesis itself.
    """
    best = best or hypothesis
    h, linear = best.best, hypothesis.linear
    shared = linear.mean[h]
    found = []
    for trial, block, basis, own in zip(
        hypothesis.trials, linear.blocks, linear.basis, linear.base_steps(h, shared), strict=True
    ):
        left = block.residual - block.base @ own - basis @ shared
        left = left - block.modes @ (block.weights[h] * (block.modes.T @ left))
        found.append(left[: int(trial.rows.sum())] / np.sqrt(best.noise_variance))
    return found


def gap_parts(hypothesis: Hypothesis, best: Hypothesis) -> tuple[GapPart, ...]:
    """Return the parts of all axes with their shares of the gap that a hypothesis leaves, the largest first.

    Heterogeneity and noise variance are those of the most probable set, `best`.
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
        "depth_mm": list(_cut([each.depth_mm for each in motions], _DEPTHS, "mm")),
        "speed_mm_s": list(_cut([np.abs(each.velocity_mm_s) for each in motions], _SPEEDS, "mm/s")),
        "time_s": list(_cut([each.time_s - each.time_s[0] for each in motions], _TIMES, "s")),
        "phase": [motion_phases(each) for each in motions],
        "trial": [np.full(len(trial.motion), trial.record.trial, dtype=object) for trial in trials],
    }
    return {
        axis: [each[trial.samples()] for each, trial in zip(labels, trials, strict=True)]
        for axis, labels in found.items()
    }


def _cut(values: Sequence[Array], count: int, unit: str) -> Iterator[Array]:
    low, high = min(float(each.min()) for each in values), max(float(each.max()) for each in values)
    edges = np.linspace(low, high, count + 1)
    names = np.array([f"{begin:.3g} to {end:.3g} {unit}" for begin, end in pairwise(edges)], dtype=object)
    for each in values:
        yield names[np.clip(np.searchsorted(edges, each, side="right") - 1, 0, count - 1)]


def course_of(axis: GapAxis, hypothesis: Hypothesis) -> Curves:
    """Return the output that is missing beside a hypothesis, as curves along an axis."""

    def normal(basis: Sequence[Array]) -> tuple[Array, Array]:
        problem = hypothesis.problem
        columns = hypothesis.decorrelated(
            Columns(
                hypothesis.linear.blocks,
                [problem.whiten(trial, number, basis[number]) for number, trial in enumerate(hypothesis.trials)],
            )
        )
        projected = hypothesis.linear.project(columns, np.array([hypothesis.best]))
        matrix = hypothesis.linear.normals(columns, projected, np.arange(columns.count)[None])
        return matrix[0, 0], projected.slope[0]

    return curves_along(axis, hypothesis.trials, normal)
