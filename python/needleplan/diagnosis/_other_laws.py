"""Laws of the base that differ from the model's: what the tolerances of the base explain, without any effect."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from needleplan.diagnosis._base_law import Law
from needleplan.diagnosis._hypothesis import TOLERANCE_SCALES, Hypothesis

__all__ = ["other_laws"]

# The laws of the base in words, and effects that would look alike.
_LAWS = {
    Law.REVERSAL: ("friction reverses", "a longer bristle or a delay"),
    Law.DEPTH: ("the forces depend on the depth", "cutting_with_depth"),
    Law.FORCE: ("the forces depend on their size and direction", "gain_error or friction_by_direction"),
    Law.SPEED: ("the forces depend on the speed", "viscous or stribeck"),
    Law.ENTRY: ("the forces come up at the entry", "entry_spring, or a layer near the entry,"),
}
# Log evidence ratio above which a law is said to differ: odds of twenty.
_DIFFERS = math.log(20)


def other_laws(hypothesis: Hypothesis) -> Iterator[tuple[str, str]]:
    """Yield each law of the base that differs from the model's beside the effects of a hypothesis, and a remark.

    The evidence with the tolerance of the law is compared with that of its least tolerance. A deviation below the law
    tolerance of the effects beside it may be theirs, and does not count.
    """
    h, noise, linear = hypothesis.best, hypothesis.problem.noise_scale, hypothesis.linear
    best = linear.evidence_with(linear.precision, h, noise)
    rows = sum(len(block.residual) for block in linear.blocks)
    theirs = hypothesis.problem.settings.law_tolerance**2 * _energy(hypothesis)
    for law, group in hypothesis.groups.items():
        if law is Law.EFFECTS:
            continue
        words, alike = _LAWS[law]
        least = {**hypothesis.scales, law: TOLERANCE_SCALES[0]}
        gain = best - linear.evidence_with(hypothesis.precision_with(least), h, noise)
        energy = sum(float(((each[:, group] @ linear.mean[h, group]) ** 2).sum()) for each in linear.basis)
        if gain > _DIFFERS and energy > theirs:
            size = f"odds {_odds(gain)}; RMS {math.sqrt(energy / rows):.1f} times the noise"
            yield (
                words,
                (
                    f"{words} by another law than the model's ({size}): this needs no effect, but {alike} would look alike"
                ),
            )


def _energy(hypothesis: Hypothesis) -> float:
    """Return the squared whitened output of all effects together, summed over all trials."""
    found = 0.0
    for number, (trial, own) in enumerate(zip(hypothesis.trials, hypothesis.outputs, strict=False)):
        whitened = hypothesis.problem.whiten(trial, number, np.sum(own, axis=0))
        found += float(whitened @ whitened)
    return found


def _odds(gain: float) -> str:
    """Return a log evidence ratio as odds."""
    return f"{math.exp(gain):.0f} to 1" if gain < math.log(1e4) else "above 10,000 to 1"
