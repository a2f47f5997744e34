"""Trials that lack an effect which the others have."""

from __future__ import annotations

import math

import numpy as np

from needleplan.diagnosis._constants import LACKING_SDS
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.models.effects import SIZE

__all__ = ["transfer_z"]


def transfer_z(hypothesis: Hypothesis) -> float:
    """Return the largest deviation, in standard deviations, of a trial that lacks an effect which the others have.

    The amplitude that a trial has by itself follows from the posterior with and without this trial. A trial lacks the
    effect if 0 is within two standard deviations of this amplitude. Trials with more or less of it contradict nothing.
    """
    linear, parts = hypothesis.linear, hypothesis.linear.parts[:, hypothesis.best]
    prior, whole, f = np.diag(linear.precision), parts.sum(axis=0), len(linear.precision)
    every = np.linalg.inv(whole[:f, :f] + prior)
    mean, worst = every @ whole[:f, f], 0.0
    for part in parts:
        others = np.linalg.inv(whole[:f, :f] - part[:f, :f] + prior)
        without = others @ (whole[:f, f] - part[:f, f])
        for row, (index, name, _) in enumerate(hypothesis.coordinates):
            effect, learnt = hypothesis.effects[index], float(others[row, row] - every[row, row])
            if name != SIZE or effect.given or learnt <= 0:
                continue
            size = effect.values[SIZE] / effect.effect.parameters[SIZE].typical + without[row]
            own = size + float(mean[row] - without[row]) * others[row, row] / learnt
            spread = math.sqrt(others[row, row] * every[row, row] / learnt * hypothesis.noise_variance)
            score = abs(mean[row] - without[row]) / math.sqrt(learnt * hypothesis.noise_variance)
            if own * np.sign(size) < LACKING_SDS * spread:
                worst = max(worst, float(score))
    return worst
