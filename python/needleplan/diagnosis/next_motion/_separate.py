"""The motion that separates effects that explain the data equally well (T-optimal design, Hunter and Reiner).

Suppose that the first of two effects is true. The model with the first effect then predicts one more trial of a motion.
The second effect can explain part of that prediction, after recalibration of the base model and a change of the second
effect's parameters within their uncertainty. The whitened energy D of the unexplained part is the expected growth of
the first effect's lead in BIC gain; the variance of the growth is 4 D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf, sqrt

import numpy as np
from scipy.special import ndtr

from needleplan.diagnosis._diagnosis import Diagnosis
from needleplan.diagnosis._verdict import Verdict
from needleplan.diagnosis.calibration import mean_model
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.joint_fit import JointFit, effects_output
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.diagnosis.next_motion._programs import NextMotion, Tried, predicted_trial
from needleplan.diagnosis.selection_round import RoundOutcome, SelectionRound
from needleplan.models import Model
from needleplan.signals import Array, Motion, Role

__all__ = [
    "NOTHING",
    "AlternativeEffect",
    "Separating",
    "Separation",
    "Synonyms",
    "alternatives_of",
    "separating",
    "separations_by",
]

# Stands for "no effect": the alternative if only one effect is possible.
NOTHING = "nothing"
# Largest number of possible effects that are compared.
_MOST = 4
# Deficit in gain behind the best effect, in units of `Gates.lead`, up to which an effect counts as possible.
_NEAR = 2.0
# Number of further trials of the best motion above which a pair counts as inseparable.
_MOST_TRIALS = 5
# Change of a fit coordinate for numerical sensitivities.
_STEP = 0.02


@dataclass(frozen=True)
class Separation:
    """How well one more trial would separate two effects if the first one is true."""

    true: str
    alternative: str
    lead: float
    """Present lead in combined gain of the effect `true` over `alternative`."""

    expected: float
    """Expected growth of the lead if `true` is the true effect."""

    thresholds: float
    """Ratio of `expected` to the lead that a name needs."""

    resolves: float
    """Probability that the lead is sufficient after the trial."""


@dataclass(frozen=True)
class Synonyms:
    """Two effects that none of the considered motions separates within a few trials."""

    first: str
    second: str
    trials: int | None
    """Number of trials of the best motion that would separate the effects; None if at least 1000 would be needed."""


@dataclass(frozen=True)
class Separating(NextMotion):
    """The motion with the largest probability of a decision between the possible effects."""

    separations: tuple[Separation, ...]
    resolves: float
    """Mean probability of a decision, weighted by the present probability of each effect."""

    repeated: tuple[Separation, ...]
    """Separations if the last training motion were repeated instead."""

    repeated_resolves: float
    considered: tuple[tuple[str, float, float], ...]
    """Name, probability of a decision, and smallest `Separation.thresholds` of each program."""

    synonyms: tuple[Synonyms, ...]
    """Pairs of effects that no program separates."""

    @property
    def least(self) -> float:
        """Smallest separation of all pairs, in units of the lead that a name needs."""
        return min(each.thresholds for each in self.separations)

    @property
    def why(self) -> str:
        """Reason for the motion, in words, with a remark on pairs that no motion separates."""
        pair = min(self.separations, key=lambda each: each.thresholds)
        if pair.alternative == NOTHING or pair.true == NOTHING:
            name = pair.true if pair.alternative == NOTHING else pair.alternative
            return (
                f"Only one effect is possible, but data are missing. If {name} is the missing effect, this motion "
                f"should give it {pair.thresholds:.0f} times the lead that a name needs."
            )
        again = min(each.thresholds for each in self.repeated)
        text = (
            f"This motion should change the lead between {pair.true} and {pair.alternative} by {pair.thresholds:.1f} "
            f"times the lead that a name needs; the last motion, repeated, would change it by {again:.1f} times."
        )
        return " ".join([text, *(f"{_said(each)}." for each in self.synonyms)])


def _said(each: Synonyms) -> str:
    """Return a statement, without a full stop, on a pair of effects that no motion separates."""
    count = "no number of trials of any motion" if each.trials is None else f"no fewer than {each.trials} more trials"
    return (
        f"{each.first} and {each.second} act alike in all considered motions ({count} would separate them "
        "on this channel): either name stands for both"
    )


@dataclass(frozen=True)
class AlternativeEffect:
    """A fitted effect that may be the missing effect."""

    name: str
    combined_gain: float
    """BIC gain in training plus likelihood gain on the held-out trials."""

    heterogeneity_sd: float
    """Estimated heterogeneity standard deviation in the fit with this effect."""

    base: Model
    effects: tuple[FittedEffect, ...]
    coordinates: tuple[tuple[int, str], ...]
    covariance: Array


def separating(
    found: Diagnosis, alternatives: Sequence[AlternativeEffect], tried: Sequence[Tried], role: Role
) -> Separating:
    """Return the motion with the largest probability of a decision between the possible effects, at least two.

    Among motions with almost equal probabilities, the one that separates its least separable pair best is returned.
    """
    all_ = [*alternatives, *_close_behind(found, alternatives)]
    every = [separations_by(found, all_, motion) for _, motion in tried]
    made = [(*each, _among(alternatives, pairs)) for each, pairs in zip(tried, every, strict=True)]
    again = separations_by(found, alternatives, found.calibration.training[-1].motion)
    synonyms, all_synonyms = (_synonyms(each, found.gates.lead) for each in ([pairs for *_, pairs in made], every))
    judged = [(*each, _resolves(alternatives, each[2], synonyms)) for each in made]
    # Among almost equal probabilities the larger separation wins. It includes effects close behind, because these may
    # remain possible after one of the best effects is excluded.
    order = [
        (round(each[3], 2), _least(_separable(pairs, all_synonyms))) for each, pairs in zip(judged, every, strict=True)
    ]
    program, motion, pairs, _ = judged[order.index(max(order))]
    considered = tuple((each[0].name, each[3], _least(each[2])) for each in judged)
    return Separating(
        program, motion, role, pairs, _resolves(alternatives, pairs, ()), again,
        _resolves(alternatives, again, ()), considered, synonyms,
    )  # fmt: skip


def alternatives_of(found: Diagnosis) -> tuple[AlternativeEffect, ...]:
    """Return at most four possible effects, the best first; none if no round is decisive.

    The possible effects are those that tied in the decisive round or, without a tie, those near the best effect of this
    round. If only one effect is possible and the verdict is AMBIGUOUS, `NOTHING` is added.
    """
    round_ = _deciding(found)
    if round_ is None:
        return ()
    behind = max(each.combined_gain for each in round_.ranked) - _NEAR * found.gates.lead
    near = [
        _fitted(each, found) for each in round_.ranked
        if (each.newest.name in round_.tied if round_.tied else each.combined_gain > behind and not each.refuted)
    ]  # fmt: skip
    tried = {each.newest.name for each in round_.ranked}
    taken = round_.ranked[0].effects[:-1]
    for screened in round_.screened:
        name = screened.effect.name
        if name not in tried and (name in round_.tied if round_.tied else screened.bic_gain > behind):
            effects = (*taken, FittedEffect(screened.effect, screened.values))
            near.append(_unfitted(name, screened.bic_gain, effects, found))
    if len(near) == 1 and found.verdict is Verdict.AMBIGUOUS:
        # One effect without an alternative, but with missing data: look for the motion that shows it best.
        near.append(_unfitted(NOTHING, 0.0, (), found))
    return tuple(sorted(near, key=lambda each: -each.combined_gain)[:_MOST])


def _close_behind(found: Diagnosis, alternatives: Sequence[AlternativeEffect]) -> list[AlternativeEffect]:
    """Return further effects that fit the training data nearly as well, validated or not."""
    round_ = _deciding(found)
    assert round_ is not None, "alternatives come from this round"
    names = {each.name for each in alternatives}
    least = max(each.newest.bic_gain for each in round_.ranked) - _NEAR * found.gates.lead
    near = [each for each in round_.ranked if each.newest.name not in names and each.newest.bic_gain > least]
    near.sort(key=lambda each: -each.newest.bic_gain)
    return [_fitted(each, found) for each in near[: max(_MOST - len(alternatives), 1)]]


def _among(alternatives: Sequence[AlternativeEffect], pairs: Sequence[Separation]) -> tuple[Separation, ...]:
    """Return the pairs whose effects are both in `alternatives`."""
    names = {each.name for each in alternatives}
    return tuple(each for each in pairs if each.true in names and each.alternative in names)


def separations_by(
    found: Diagnosis, alternatives: Sequence[AlternativeEffect], motion: Motion
) -> tuple[Separation, ...]:
    """Return how well one more trial of a motion would separate the effects, for each ordered pair."""
    lead = found.gates.lead
    shown = {each.name: effects_output(each.effects, each.base, motion).ravel() for each in alternatives}
    pairs = []
    trial = predicted_trial(found.calibration.model, found.calibration, motion)
    # Heterogeneity as estimated with the true effect: estimated without effects it would absorb the gap too.
    spaces = {true.name: JointLikelihood([trial.whitened], np.array([true.heterogeneity_sd])) for true in alternatives}
    for alternative in alternatives:
        moved = (
            trial.whiten(_derivatives(alternative, motion))
            if alternative.coordinates
            else np.zeros((trial.whitened.samples, 0))
        )
        for true in alternatives:
            if true is alternative:
                continue
            gap = trial.whiten((shown[true.name] - shown[alternative.name])[:, None])
            matrix, _ = spaces[true.name].normal([np.column_stack([gap, moved])], 0)
            expected = _unexplained_energy(matrix, alternative.covariance)
            now = true.combined_gain - alternative.combined_gain
            enough = ndtr((now + expected - lead) / (2 * sqrt(expected) + 1e-9))
            pairs.append(Separation(true.name, alternative.name, now, expected, expected / lead, float(enough)))
    return tuple(pairs)


def _deciding(found: Diagnosis) -> SelectionRound | None:
    """Return the round that the verdict depends on: the last tied or accepting round; None without such a round."""
    accepted = [round_ for round_ in found.selection.rounds if round_.outcome is RoundOutcome.ACCEPTED]
    last = found.selection.rounds[-1]
    if found.verdict in (Verdict.AMBIGUOUS, Verdict.INCOMPLETE):
        return last if last.outcome is RoundOutcome.TIE else accepted[-1] if accepted else None
    return accepted[-1] if found.verdict is Verdict.NAMED else None


def _fitted(joint: JointFit, found: Diagnosis) -> AlternativeEffect:
    base = mean_model([trial.model for trial in joint.trials], found.calibration.free)
    return AlternativeEffect(
        joint.newest.name,
        joint.combined_gain,
        joint.likelihood.heterogeneity_sd,
        base,
        joint.effects,
        joint.coordinates,
        joint.covariance,
    )


def _unfitted(name: str, bic_gain: float, effects: tuple[FittedEffect, ...], found: Diagnosis) -> AlternativeEffect:
    heterogeneity_sd = found.selection.base.heterogeneity_sd
    return AlternativeEffect(name, bic_gain, heterogeneity_sd, found.calibration.model, effects, (), np.zeros((0, 0)))


def _synonyms(made: Sequence[Sequence[Separation]], lead: float) -> tuple[Synonyms, ...]:
    """Return the pairs that no motion separates within `_MOST_TRIALS` trials.

    The number of trials of a motion is the larger of the two numbers that are needed if one or the other effect is
    true. Pairs with `NOTHING` are left out.
    """
    needed: dict[tuple[str, str], float] = {}
    for pairs in made:
        for pair in pairs:
            key = min(pair.true, pair.alternative), max(pair.true, pair.alternative)
            # Either effect may be true, so both directions must be within reach.
            both = [each for each in pairs if {each.true, each.alternative} == set(key)]
            trials = max((lead - each.lead) / each.expected if each.expected > 0 else inf for each in both)
            needed[key] = min(needed.get(key, inf), trials)
    return tuple(
        Synonyms(*key, ceil(trials) if trials < 1000 else None)
        for key, trials in needed.items()
        if trials > _MOST_TRIALS and NOTHING not in key
    )


def _separable(pairs: Sequence[Separation], synonyms: Sequence[Synonyms]) -> list[Separation]:
    """Return the pairs that are not synonyms; all pairs if all are synonyms."""
    alike = [{each.first, each.second} for each in synonyms]
    return [each for each in pairs if {each.true, each.alternative} not in alike] or list(pairs)


def _least(pairs: Sequence[Separation]) -> float:
    return min(each.thresholds for each in pairs)


def _resolves(
    alternatives: Sequence[AlternativeEffect], pairs: Sequence[Separation], synonyms: Sequence[Synonyms]
) -> float:
    """Return the mean probability of a decision, weighted by the present probability of each effect.

    The probability of a decision for a true effect is that of its least separable pair; `synonyms` are left out.
    """
    best = max(each.combined_gain for each in alternatives)
    weights = np.array([np.exp((each.combined_gain - best) / 2) for each in alternatives])
    left = _separable(pairs, synonyms)
    each = [
        min([pair.resolves for pair in left if pair.true == alternative.name] or [0.0]) for alternative in alternatives
    ]
    return float(weights @ each / weights.sum())


def _unexplained_energy(matrix: Array, covariance: Array) -> float:
    """Return the energy of the first column that the other columns cannot explain.

    `matrix` is the normal matrix of all columns; `covariance` is the prior of the other columns' coefficients.
    """
    if not covariance.size:
        return max(float(matrix[0, 0]), 0.0)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    known = np.linalg.inv(covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(scale)))
    inner = matrix[1:, 1:] * np.outer(scale, scale) + known
    cross = matrix[1:, 0] * scale
    return max(float(matrix[0, 0] - cross @ np.linalg.solve(inner, cross)), 0.0)


def _derivatives(alternative: AlternativeEffect, motion: Motion) -> Array:
    """Return the derivatives of the output with respect to the coordinates of an alternative.

    The shape is (axes * samples, coordinates).
    """
    here = effects_output(alternative.effects, alternative.base, motion).ravel()
    columns = []
    for index, name in alternative.coordinates:
        each = alternative.effects[index]
        what = each.effect.parameters[name]
        step = _STEP if what.value(what.coordinate(each.values[name]) + _STEP) <= what.upper else -_STEP
        values = {**each.values, name: what.value(what.coordinate(each.values[name]) + step)}
        effects = tuple(
            FittedEffect(each.effect, values) if at == index else old for at, old in enumerate(alternative.effects)
        )
        columns.append((effects_output(effects, alternative.base, motion).ravel() - here) / step)
    return np.column_stack(columns)
