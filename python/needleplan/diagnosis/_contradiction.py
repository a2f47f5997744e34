"""Trials that lack an effect which the others have."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from needleplan.diagnosis._fit import linearised_trials
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.signals import Role

__all__ = ["Lack", "strongest_lack"]


@dataclass(frozen=True)
class Lack:
    """A trial without an effect, and the log odds (nats) of this against the effect in all trials."""

    effect: str
    trial: str
    nats: float


def strongest_lack(hypothesis: Hypothesis) -> Lack | None:
    """Return the trial and the effect with the largest odds that this trial lacks what the others have.

    The rival of a set has the same effects, laws and base, with the output of one effect zero in one trial, as in a
    reference. All these rivals together are as probable as the set before the data. None if fewer than two trials can
    have effects.
    """
    problem, trials = hypothesis.problem, hypothesis.trials
    numbers = [number for number, trial in enumerate(trials) if not trial.is_reference]
    missing = [index for index, effect in enumerate(hypothesis.effects) if not effect.given]
    if len(numbers) < 2 or not missing:
        return None
    found = []
    for index in missing:
        effects = tuple(
            each if other == index else replace(each, given=True) for other, each in enumerate(hypothesis.effects)
        )
        for number in numbers:
            trial = trials[number]
            without = replace(trial, record=replace(trial.record, role=Role.REFERENCE), shared=None)
            rivals = (*trials[:number], without, *trials[number + 1 :])
            rival = hypothesis.again(effects, linearised_trials(problem, effects, rivals, again=True))
            nats = rival.log_evidence - hypothesis.log_evidence - math.log(len(missing) * len(numbers))
            found.append(Lack(hypothesis.effects[index].name, str(trial.record.trial), nats))
    return max(found, key=lambda each: each.nats)
