"""The motion that tells rival effects apart (T-optimal, after Hunter and Reiner).

Were the first of two effects true, one more trial of a motion would show what its model predicts, and the second would
explain what it can of that: with the base calibrated anew, and with its own parameters moved as far as the data so
far allow. The whitened square of what is left is how much the balance between the two is expected to change, in the
same units as the lead that a name needs. A balance that is expected to change by D does so with a variance of 4 D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf, sqrt

import numpy as np
from scipy.special import ndtr

from needleplan.diagnosis.calibrate import pooled
from needleplan.diagnosis.diagnosis import Diagnosis
from needleplan.diagnosis.next_motion.proposal import NextMotion, Tried, predicted_case
from needleplan.diagnosis.refit import Added, added_output
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.step import Ranked, Step, Stop
from needleplan.diagnosis.verdict import Verdict
from needleplan.models import Model
from needleplan.signals import Array, Motion, Role

__all__ = ["NOTHING", "Rival", "Separating", "Separation", "Synonyms", "rivals_of", "separating", "separations_by"]

NOTHING = "nothing"
"""Name of the rival of an effect that has no other."""

_MOST = 4
_NEAR = 2.0
"""Leads behind the best within which an effect is a rival."""

_MOST_TRIALS = 5
"""More trials than that, of the motion that is best for a pair, nobody makes: the two are synonyms here."""

_STEP = 0.02


@dataclass(frozen=True)
class Separation:
    """How far one more trial would tell two effects apart, were the first one true."""

    true: str
    rival: str
    lead: float
    """Of the first over the second so far, by all data, in the units of the balance."""

    expected: float
    """By how much the lead is expected to grow."""

    thresholds: float
    """The same, in units of the lead that a name needs."""

    resolves: float
    """Probability that the lead is enough then."""


@dataclass(frozen=True)
class Synonyms:
    """Two effects that no motion which was considered tells apart: they say the same of this needle."""

    first: str
    second: str
    trials: int | None
    """How many more trials of the best motion for this pair a decision would take; None for no number of them."""


@dataclass(frozen=True)
class Separating(NextMotion):
    """The motion after which a decision between effects is most probable."""

    separations: tuple[Separation, ...]
    resolves: float
    """Probability that it decides between the rivals, each true with the probability that the balance gives it."""

    repeated: tuple[Separation, ...]
    """What the last training motion would do, were it made once more."""

    repeated_resolves: float
    considered: tuple[tuple[str, float, float], ...]
    """All programs: name, probability, least separation in thresholds."""

    synonyms: tuple[Synonyms, ...]
    """Pairs that none of the programs tells apart."""

    @property
    def least(self) -> float:
        """Separation of the pair that is told apart worst, in units of the lead that a name needs."""
        return min(each.thresholds for each in self.separations)

    @property
    def why(self) -> str:
        """What it does for the pair that is hardest to tell apart, and which pairs nothing tells apart."""
        pair = min(self.separations, key=lambda each: each.thresholds)
        if pair.rival == NOTHING or pair.true == NOTHING:
            name = pair.true if pair.rival == NOTHING else pair.rival
            return (
                f"No two effects are left, but data lack. If {name} is what is missing, this motion shows it with "
                f"{pair.thresholds:.0f} times the lead that a name needs."
            )
        again = min(each.thresholds for each in self.repeated)
        text = (
            f"It should move the balance of {pair.true} and {pair.rival} by {pair.thresholds:.1f} times the lead that "
            f"a name needs; the last motion again: {again:.1f} times."
        )
        return " ".join([text, *(f"{_said(each)}." for each in self.synonyms)])


def _said(each: Synonyms) -> str:
    """Return what is to be said of a pair that nothing tells apart."""
    count = "no number of trials of any motion" if each.trials is None else f"no fewer than {each.trials} more trials"
    return (
        f"{each.first} and {each.second} act alike in all motions that were considered ({count} would tell them apart "
        "on this channel): either name is a name for both"
    )


@dataclass(frozen=True)
class Rival:
    """An effect that may be what is missing, as it was fitted."""

    name: str
    support: float
    """What all data say for it, in the units of the balance."""

    level: float
    """By how much the tissue varies beside it."""

    base: Model
    added: tuple[Added, ...]
    names: tuple[tuple[int, str], ...]
    covariance: Array


def separating(found: Diagnosis, rivals: Sequence[Rival], tried: Sequence[Tried], role: Role) -> Separating:
    """Return the best of the motions for a decision between two rivals and more."""
    all_ = [*rivals, *_close_behind(found, rivals)]
    every = [separations_by(found, all_, motion) for _, motion in tried]
    made = [(*each, _among(rivals, pairs)) for each, pairs in zip(tried, every, strict=True)]
    again = separations_by(found, rivals, found.calibration.training[-1].motion)
    synonyms, all_synonyms = (_synonyms(each, found.gates.lead) for each in ([pairs for *_, pairs in made], every))
    judged = [(*each, _resolves(rivals, each[2], synonyms)) for each in made]
    # Probabilities that are all but the same are no choice: then the farther apart the better, and apart from what is
    # close behind too, which one of them may be mistaken for when the other one is gone.
    order = [
        (round(each[3], 2), _least(_separable(pairs, all_synonyms))) for each, pairs in zip(judged, every, strict=True)
    ]
    program, motion, pairs, _ = judged[order.index(max(order))]
    considered = tuple((each[0].name, each[3], _least(each[2])) for each in judged)
    return Separating(
        program, motion, role, pairs, _resolves(rivals, pairs, ()), again, _resolves(rivals, again, ()), considered,
        synonyms,
    )  # fmt: skip


def rivals_of(found: Diagnosis) -> tuple[Rival, ...]:
    """Return the effects that are near the best one in the round that decided, or could not."""
    step = _deciding(found)
    if step is None:
        return ()
    behind = max(each.support for each in step.ranked) - _NEAR * found.gates.lead
    near = [
        _fitted(each, found) for each in step.ranked
        if (each.name in step.tied if step.tied else each.support > behind and not each.vetoed)
    ]  # fmt: skip
    tried = {each.name for each in step.ranked}
    taken = step.ranked[0].joint.added[:-1]
    for screened in step.screened:
        name = screened.effect.name
        if name not in tried and (name in step.tied if step.tied else screened.balance > behind):
            added = (*taken, Added(screened.effect, screened.values))
            near.append(_unfitted(name, screened.balance, added, found))
    if len(near) == 1 and found.verdict is Verdict.AMBIGUOUS:
        # What lacks is not a rival but data: then what shows the one effect best, beside none.
        near.append(_unfitted(NOTHING, 0.0, (), found))
    return tuple(sorted(near, key=lambda each: -each.support)[:_MOST])


def _close_behind(found: Diagnosis, rivals: Sequence[Rival]) -> list[Rival]:
    """Return effects that fit nearly as well as the rivals, whatever another motion says of them."""
    step = _deciding(found)
    assert step is not None, "there are rivals of it"
    names = {each.name for each in rivals}
    least = max(each.balance for each in step.ranked) - _NEAR * found.gates.lead
    near = [each for each in step.ranked if each.name not in names and each.balance > least]
    near.sort(key=lambda each: -each.balance)
    return [_fitted(each, found) for each in near[: max(_MOST - len(rivals), 1)]]


def _among(rivals: Sequence[Rival], pairs: Sequence[Separation]) -> tuple[Separation, ...]:
    names = {each.name for each in rivals}
    return tuple(each for each in pairs if each.true in names and each.rival in names)


def separations_by(found: Diagnosis, rivals: Sequence[Rival], motion: Motion) -> tuple[Separation, ...]:
    """Return how far one more trial of a motion would tell rivals apart, every pair both ways."""
    lead = found.gates.lead
    shown = {each.name: added_output(each.added, each.base, motion).ravel() for each in rivals}
    pairs = []
    case = predicted_case(found.calibration.model, found.calibration, motion)
    # The tissue varies as it does beside the effect that is true: beside the base alone it takes up the gap as well.
    spaces = {true.name: Space([case.block], np.array([true.level])) for true in rivals}
    for rival in rivals:
        moved = case.whiten(_derivatives(rival, motion)) if rival.names else np.zeros((case.block.samples, 0))
        for true in rivals:
            if true is rival:
                continue
            gap = case.whiten((shown[true.name] - shown[rival.name])[:, None])
            matrix, _ = spaces[true.name].normal([np.column_stack([gap, moved])], 0)
            expected = _left(matrix, rival.covariance)
            now = true.support - rival.support
            sure = ndtr((now + expected - lead) / (2 * sqrt(expected) + 1e-9))
            pairs.append(Separation(true.name, rival.name, now, expected, expected / lead, float(sure)))
    return tuple(pairs)


def _deciding(found: Diagnosis) -> Step | None:
    accepted = [step for step in found.selection.steps if step.stop is Stop.ACCEPTED]
    last = found.selection.steps[-1]
    if found.verdict in (Verdict.AMBIGUOUS, Verdict.INCOMPLETE):
        return last if last.stop is Stop.TIE else accepted[-1] if accepted else None
    return accepted[-1] if found.verdict is Verdict.NAMED else None


def _fitted(each: Ranked, found: Diagnosis) -> Rival:
    joint = each.joint
    base = pooled([case.model for case in joint.cases], found.calibration.free)
    return Rival(each.name, each.support, joint.space.level, base, joint.added, joint.names, joint.covariance)


def _unfitted(name: str, balance: float, added: tuple[Added, ...], found: Diagnosis) -> Rival:
    level = found.selection.base.level
    return Rival(name, balance, level, found.calibration.model, added, (), np.zeros((0, 0)))


def _synonyms(made: Sequence[Sequence[Separation]], lead: float) -> tuple[Synonyms, ...]:
    """Return the pairs that cannot be decided, one way or the other, whichever of the motions is made."""
    needed: dict[tuple[str, str], float] = {}
    for pairs in made:
        for pair in pairs:
            key = min(pair.true, pair.rival), max(pair.true, pair.rival)
            # Were the other one true its lead would have to be gained: both ways must be within reach.
            both = [each for each in pairs if {each.true, each.rival} == set(key)]
            trials = max((lead - each.lead) / each.expected if each.expected > 0 else inf for each in both)
            needed[key] = min(needed.get(key, inf), trials)
    return tuple(
        Synonyms(*key, ceil(trials) if trials < 1000 else None)
        for key, trials in needed.items()
        if trials > _MOST_TRIALS and NOTHING not in key
    )


def _separable(pairs: Sequence[Separation], synonyms: Sequence[Synonyms]) -> list[Separation]:
    """Return the pairs about which something can be done; all of them where that is none."""
    alike = [{each.first, each.second} for each in synonyms]
    return [each for each in pairs if {each.true, each.rival} not in alike] or list(pairs)


def _least(pairs: Sequence[Separation]) -> float:
    return min(each.thresholds for each in pairs)


def _resolves(rivals: Sequence[Rival], pairs: Sequence[Separation], synonyms: Sequence[Synonyms]) -> float:
    best = max(each.support for each in rivals)
    weights = np.array([np.exp((each.support - best) / 2) for each in rivals])
    left = _separable(pairs, synonyms)
    each = [min([pair.resolves for pair in left if pair.true == rival.name] or [0.0]) for rival in rivals]
    return float(weights @ each / weights.sum())


def _left(matrix: Array, covariance: Array) -> float:
    """Return the square of the first column with the others taken out, as far as what is known of them lets them."""
    if not covariance.size:
        return max(float(matrix[0, 0]), 0.0)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    known = np.linalg.inv(covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(scale)))
    inner = matrix[1:, 1:] * np.outer(scale, scale) + known
    cross = matrix[1:, 0] * scale
    return max(float(matrix[0, 0] - cross @ np.linalg.solve(inner, cross)), 0.0)


def _derivatives(rival: Rival, motion: Motion) -> Array:
    """Return how the output depends on each coordinate of an effect's parameters, shape (samples, coordinates)."""
    here = added_output(rival.added, rival.base, motion).ravel()
    columns = []
    for index, name in rival.names:
        each = rival.added[index]
        what = each.effect.parameters[name]
        step = _STEP if what.value(what.coordinate(each.values[name]) + _STEP) <= what.upper else -_STEP
        values = {**each.values, name: what.value(what.coordinate(each.values[name]) + step)}
        added = tuple(Added(each.effect, values) if at == index else old for at, old in enumerate(rival.added))
        columns.append((added_output(added, rival.base, motion).ravel() - here) / step)
    return np.column_stack(columns)
