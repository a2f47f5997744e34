"""What single trials say against a set of effects: one lacks an effect, or the held-out ones keep their gap."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from needleplan.diagnosis._constants import LEAST_CLOSED, SURE_NATS
from needleplan.diagnosis._evidence import squared_residuals
from needleplan.diagnosis._fit import linearised_trials
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.signals import Role

__all__ = ["Absence", "closed_share", "contradiction", "strongest_absence"]


@dataclass(frozen=True)
class Absence:
    """A trial without an effect, and the log odds (nats) of this against the effect in all trials."""

    effect: str
    trial: str
    nats: float


def contradiction(best: Hypothesis, nothing: Hypothesis) -> str:
    """Return words on what single trials say against the most probable set; empty if they say nothing.

    `nothing` is the empty set.
    """
    absence = strongest_absence(best)
    if absence is not None and absence.nats > SURE_NATS:
        return f"trial {absence.trial!r} lacks {absence.effect}, by {absence.nats:.0f} nats"
    calibration = best.problem.calibration
    share = closed_share(best, nothing, len(calibration.training), len(calibration.held_out))
    return f"closes {max(share, 0.0):.0%} of the gap in the held-out trials only" if share < LEAST_CLOSED else ""


def strongest_absence(hypothesis: Hypothesis) -> Absence | None:
    """Return the trial and the effect with the largest odds that this trial lacks what the others have.

    The rival of a set has the same effects, laws and base, with the output of one effect zero in one trial, as in a
    reference. All these rivals together are as probable as the set before the data. None if no effect is in several
    trials.
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
        energies = [float(np.sum(np.square(own[index]))) for own in hypothesis.outputs]
        for number in numbers:
            if energies[number] >= (1 - 1e-9) * sum(energies):  # no other trial has it
                continue
            trial = trials[number]
            without = replace(trial, record=replace(trial.record, role=Role.REFERENCE), shared=None)
            rivals = (*trials[:number], without, *trials[number + 1 :])
            rival = hypothesis.again(effects, linearised_trials(problem, effects, rivals, again=True))
            nats = rival.log_evidence - hypothesis.log_evidence - math.log(len(missing) * len(numbers))
            found.append(Absence(hypothesis.effects[index].name, str(trial.record.trial), nats))
    return max(found, key=lambda each: each.nats, default=None)


def closed_share(named: Hypothesis, nothing: Hypothesis, training: int, held_out: int) -> float:
    """Return the share of the held-out residual energy above the noise that the effects of a set remove; at most 1.

    The energy is the whitened squared residual of the held-out trials, which follow the training trials. The share is
    (before - after) / (before - floor): `before` is the energy without effects, `after` the energy with the effects
    fitted to the training trials. In both energies the base model has no tolerances, so that the tolerances add nothing
    to the share. `floor` is the number of readings, or the energy of the set with its tolerances if that energy is
    smaller.

    Parameters
    ----------
    named, nothing : Hypothesis
        The set, and the empty set.
    training, held_out : int
        Numbers of trials.

    Returns
    -------
    float
        NaN if the set is empty, no trial is held out, or `before` is not above `floor`.
    """
    end = training + held_out
    if not named.names or not held_out:
        return math.nan
    level, linear = named.best, named.linear  # index of the heterogeneity; f: effects, then tolerances
    normal, prior, count = linear.parts[:, level], np.diag(linear.precision), len(named.coordinates)
    trained, tested = normal[:training].sum(axis=0), normal[training:end].sum(axis=0)
    fitted = np.linalg.solve(trained[:-1, :-1] + prior, trained[:-1, -1])
    fitted[count:] = 0.0  # no tolerances of the base model
    before = float(nothing.linear.parts[training:end, level].sum(axis=0)[-1, -1])
    after, smallest = (float(squared_residuals(tested, f)) for f in (fitted, linear.mean[level]))
    floor = min(sum(trial.readings for trial in named.trials[training:end]), smallest)
    return float(min((before - after) / (before - floor), 1.0)) if before > floor else math.nan
