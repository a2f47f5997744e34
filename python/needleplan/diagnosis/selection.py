"""Selection of a set of effects: each effect is needed beside the others, and no other effect would do as well.

Effects are added one at a time. While a second effect is still missing, the first one may fail on the held-out trials,
or a wrong effect may imitate both. A first effect that fails validation is therefore tried again together with a second
one, and at the end each effect is compared again with its alternatives beside the other effects.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from needleplan.diagnosis.alternatives import score_alternatives, validate, winning_alternative
from needleplan.diagnosis.calibration import LAG, CalibratedTrial, Calibration, calibrate_trial, unusual_lag_s
from needleplan.diagnosis.catalogue import (
    DetectionLimit,
    FittedEffect,
    Library,
    find_detection_limits,
    screen,
    whitened_sensitivities,
)
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.joint_fit import (
    HeldOutValidation,
    JointFit,
    fit_jointly,
    is_within_bounds,
    transfers,
)
from needleplan.diagnosis.likelihood import Gates, JointLikelihood
from needleplan.diagnosis.selection_round import RoundOutcome, Search, SelectionRound, run_round

__all__ = ["Selection", "select_effects", "total_bic_gain"]

# Shift of a fit coordinate by calibration above which the parameter is also tried at its prior.
_FAR_FROM_PRIOR = 0.3
# Least BIC gain of a replacement, as a share of the BIC gain of the effect that it replaces.
_REPLACEMENT_SHARE = 0.5
# Largest number of replacements that are fitted for one effect.
_MOST_REPLACEMENTS = 3


@dataclass(frozen=True)
class Selection:
    """All rounds, and the joint fit of the accepted effects (`joint`; None if no effect was accepted)."""

    base: JointLikelihood
    rounds: tuple[SelectionRound, ...]
    joint: JointFit | None
    effects: tuple[FittedEffect, ...]
    """The effects of `joint`; the gains of each effect are those over the fit without this effect."""

    validation: HeldOutValidation | None
    """Validation of all accepted effects together, compared with the base model alone; None if there is none."""

    detection_limits: tuple[DetectionLimit, ...]
    at_prior: tuple[CalibratedTrial, ...] = ()
    """Training trials recalibrated with some parameters held at their priors: those that calibration moved far.

    Empty if calibration moved no parameter far.
    """

    @property
    def unambiguous(self) -> tuple[FittedEffect, ...]:
        """The accepted effects that no other effect could replace equally well."""
        return tuple(each for each in self.effects if not each.alternatives)

    @property
    def bic_gain(self) -> float:
        """BIC gain of all accepted effects over the base model; 0 without effects."""
        return total_bic_gain(self.joint, self.base) if self.joint else 0.0


def select_effects(calibration: Calibration, library: Library, gates: Gates, *, seed: int = 0) -> Selection:
    """Add effects one at a time until no further effect passes all gates; then compare each with its alternatives.

    The search is repeated from other first effects. A set found in this way is returned only if the set contains
    several effects and leads in combined gain by more than `gates.lead`.
    """
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    entries = library.entries([trial.motion for trial in calibration.training])
    sensitivities = whitened_sensitivities(calibration, library, calibration.training, entries)
    raw = [library.sensitivities(calibration.model, trial.motion, entries) for trial in calibration.training]
    detection_limits = find_detection_limits(base, raw, sensitivities, entries, calibration.noise.rms)
    at_prior = _trials_at_prior(calibration)
    search = Search(calibration, library, entries, base, sensitivities, at_prior, gates, seed)
    rounds, last = _grow(search)
    found = _settle(search, rounds, last) if rounds else None
    first_round = rounds[0] if rounds else last
    tied = first_round.ranked[0] if first_round.outcome is RoundOutcome.TIE else None
    for begin in _other_starts(search, first_round, found):
        other = _settle(search, *_grow(search, begin))
        least = found.combined_gain if found else tied.combined_gain if tied else 0.0
        if other and len(other.joint.effects) > 1 and other.combined_gain > least + gates.lead:
            found = other
    if found is None:
        last = replace(rounds[0], outcome=RoundOutcome.NO_TRANSFER) if rounds else last
        return Selection(base, (last,), None, (), None, detection_limits, at_prior)
    return Selection(
        base, (*found.rounds, found.last), found.joint, found.effects, found.validation, detection_limits, at_prior
    )


@dataclass(frozen=True)
class _EffectSet:
    """A set of accepted effects, the rounds that accepted them, and the final round, which accepted none."""

    rounds: tuple[SelectionRound, ...]
    last: SelectionRound
    joint: JointFit
    effects: tuple[FittedEffect, ...]
    validation: HeldOutValidation | None
    bic_gain: float

    @property
    def combined_gain(self) -> float:
        """BIC gain in training plus the likelihood gain on the held-out trials."""
        return self.bic_gain + (self.validation.likelihood_gain if self.validation else 0.0)


def _grow(search: Search, begin: SelectionRound | None = None) -> tuple[list[SelectionRound], SelectionRound]:
    """Return the rounds that accepted an effect, and the final round, which accepted none.

    `begin` replaces the first round. A first effect that the held-out trials refute is accepted if a second effect
    passes all gates beside it.
    """
    accepted: list[SelectionRound] = []
    on_trial: SelectionRound | None = None
    joint: JointFit | None = None
    round_ = begin or run_round(search, None, 0.0)
    while True:
        if round_.outcome is RoundOutcome.ACCEPTED:
            accepted += [replace(on_trial, outcome=RoundOutcome.ACCEPTED), round_] if on_trial else [round_]
            on_trial = None
        elif round_.outcome is RoundOutcome.NO_TRANSFER and joint is None:
            on_trial = round_
        else:
            return accepted, on_trial or round_
        joint = round_.ranked[0]
        round_ = run_round(search, joint, (on_trial or accepted[0]).ranked[0].newest.likelihood_gain)


def _other_starts(search: Search, first: SelectionRound, found: _EffectSet | None) -> Iterator[SelectionRound]:
    """Yield variants of the first round that take another effect first; none without a set or a tie.

    An effect is taken only if its gain together with a second effect is at least the gain of the set found so far. One
    effect can imitate two others: a warming sensor resembles a bias and a drift.
    """
    if not found and first.outcome is not RoundOutcome.TIE:
        return
    names = {each.effect.name for each in found.joint.effects} if found else set()
    bic_gain = found.bic_gain if found else first.ranked[0].newest.bic_gain
    for each in first.ranked:
        if each.newest.name in names:
            continue
        beside = screen(each.likelihood, search.sensitivities_beside(each), search.entries)
        second = max((other.bic_gain for other in beside if other.name not in (each.newest.name, *names)), default=0.0)
        if second < search.gates.needed(each.likelihood.heterogeneity_sd) or each.newest.bic_gain + second < bic_gain:
            continue
        order = (each, *(other for other in first.ranked if other is not each))
        yield replace(first, ranked=order, outcome=RoundOutcome.NO_TRANSFER if each.refuted else RoundOutcome.ACCEPTED)


def _settle(search: Search, rounds: Sequence[SelectionRound], last: SelectionRound) -> _EffectSet | None:
    """Return the set of effects after pruning and replacement; None if `rounds` is empty or the set is refuted.

    The set is refuted if the held-out trials refute its first effect alone and do not confirm the whole set.
    """
    if not rounds:
        return None
    joint, effects, beaten = _prune(search, rounds)
    if any(each.alternatives for each in effects):
        last = _contested_round(search, joint, effects, last)
    elif joint is not rounds[-1].ranked[0]:
        last = replace(last, alternatives=score_alternatives(joint.likelihood, joint.trials))
    if beaten:
        last = replace(last, outcome=RoundOutcome.NAMELESS, tied=())
    alone = len(rounds) == 1
    validation = (alone and rounds[0].ranked[0].validation) or validate(joint, search.calibration)
    if rounds[0].ranked[0].refuted and (
        len(joint.effects) == 1 or (validation and not transfers(validation, search.gates))
    ):
        return None
    return _EffectSet(tuple(rounds), last, joint, effects, validation, total_bic_gain(joint, search.base))


def _prune(search: Search, rounds: Sequence[SelectionRound]) -> tuple[JointFit, tuple[FittedEffect, ...], bool]:
    """Drop the effects that are not needed.

    Returns the fit of the remaining effects, these effects with their gains, and whether an effect was dropped because
    a nonparametric alternative did better.
    """
    joint = rounds[-1].ranked[0]
    chances = [round_.p_value for round_ in rounds]
    if len(rounds) == 1:
        return joint, (replace(joint.newest, likelihood_gain=joint.likelihood_gain, p_value=chances[0]),), False
    beaten = False
    alternatives: list[tuple[FittedEffect, ...]] = [()] * len(rounds)
    for index in range(len(rounds)):
        joint, alternatives[index] = _best_replacement(search, joint, index)
    while True:
        rests = [search.without(joint, index) for index in range(len(joint.effects))]
        effects = tuple(
            replace(
                each,
                likelihood_gain=joint.likelihood_gain - rest.likelihood_gain,
                bic_gain=total_bic_gain(joint, search.base) - total_bic_gain(rest, search.base),
                p_value=chance,
                alternatives=others,
            )
            for each, rest, chance, others in zip(joint.effects, rests, chances, alternatives, strict=True)
        )
        weakest = min(range(len(effects)), key=lambda index: effects[index].bic_gain)
        if effects[weakest].bic_gain >= search.gates.needed(joint.likelihood.heterogeneity_sd):
            lost = [index for index, member in enumerate(effects) if _is_beaten(search, joint, member, index)]
            if not lost:
                return joint, effects, beaten
            weakest, beaten = min(lost, key=lambda index: effects[index].bic_gain), True
        joint = rests[weakest]
        del chances[weakest], alternatives[weakest]
        if len(joint.effects) == 1:
            only = replace(
                joint.newest,
                likelihood_gain=joint.likelihood_gain,
                bic_gain=total_bic_gain(joint, search.base),
                p_value=chances[0],
                alternatives=alternatives[0],
            )
            return joint, (only,), beaten


def _is_beaten(search: Search, joint: JointFit, member: FittedEffect, index: int) -> bool:
    """Return whether a nonparametric alternative does better than effect number `index`, beside the other effects."""
    rest = search.without(joint, index)
    degrees_of_freedom = len(joint.effects[index].effect.parameters)
    alternatives = score_alternatives(rest.likelihood, rest.trials)
    return (
        winning_alternative(
            alternatives,
            search.gates,
            likelihood_gain=member.likelihood_gain,
            bic_gain=member.bic_gain,
            degrees_of_freedom=degrees_of_freedom,
            lead=0.0,
        )
        is not None
    )


def _best_replacement(search: Search, joint: JointFit, index: int) -> tuple[JointFit, tuple[FittedEffect, ...]]:
    """Return the joint fit with the best effect at position `index`, and the other effects that do as well there."""
    rest = search.without(joint, index)
    names = {each.effect.name for each in joint.effects}
    least = _REPLACEMENT_SHARE * (total_bic_gain(joint, search.base) - total_bic_gain(rest, search.base))
    sets = [joint]
    for other in screen(rest.likelihood, search.sensitivities_beside(rest), search.entries):
        if other.effect.name in names or other.bic_gain < least or len(sets) > _MOST_REPLACEMENTS:
            continue
        effects = [*joint.effects]
        effects[index] = search.start(other)
        sets.append(fit_jointly(effects, search.calibration, search.base, joint.trials))
    if len(sets) == 1:
        return joint, ()
    supports = []
    for each in sets:
        seen = validate(each, search.calibration)
        holds = (seen is None or transfers(seen, search.gates)) and is_within_bounds(each, index)
        supports.append((holds, total_bic_gain(each, search.base) + (seen.likelihood_gain if seen else 0.0)))
    best = max(range(len(sets)), key=lambda place: supports[place])
    holds, combined_gain = supports[best]
    return sets[best], tuple(
        each.effects[index] for place, each in enumerate(sets)
        if place != best and (supports[place][0] or not holds)
        and supports[place][1] > combined_gain - search.gates.lead
    )  # fmt: skip


def _contested_round(
    search: Search, joint: JointFit, effects: Sequence[FittedEffect], last: SelectionRound
) -> SelectionRound:
    """Return a round with outcome TIE between the first effect that has alternatives and these alternatives."""
    index = next(place for place, each in enumerate(effects) if each.alternatives)
    rest = search.without(joint, index) if len(joint.effects) > 1 else None
    others, likelihood_gain, before = (
        (rest.effects, rest.likelihood_gain, total_bic_gain(rest, search.base)) if rest else ((), 0.0, 0.0)
    )
    ranked = []
    for each in (joint.effects[index], *effects[index].alternatives):
        whole = fit_jointly([*others, each], search.calibration, search.base, joint.trials)
        ranked.append(
            whole.with_newest(whole.likelihood_gain - likelihood_gain, total_bic_gain(whole, search.base) - before)
        )
    return SelectionRound(
        last.screened, score_alternatives(joint.likelihood, joint.trials), tuple(ranked), effects[index].p_value,
        RoundOutcome.TIE, tuple(each.newest.name for each in ranked),
    )  # fmt: skip


def total_bic_gain(joint: JointFit, base: JointLikelihood) -> float:
    """Return the BIC gain of all effects of a joint fit over the base model alone."""
    return joint.likelihood_gain - base.bic_penalty * sum(len(each.effect.parameters) for each in joint.effects)


def _trials_at_prior(calibration: Calibration) -> tuple[CalibratedTrial, ...]:
    """Return the training trials, recalibrated with those parameters held at their priors that calibration moved far.

    The sensor lag counts as such a parameter. A parameter far from its prior may imitate an effect; with the parameter
    at its prior, the effect is visible. Returns an empty tuple if calibration moved no parameter far.
    """
    given, now = calibration.given, calibration.model
    far = {
        name
        for name in calibration.free
        if abs(given.parameters()[name].coordinate(getattr(now, name))
               - given.parameters()[name].coordinate(getattr(given, name))) > _FAR_FROM_PRIOR
    }  # fmt: skip
    late = unusual_lag_s(calibration) > 0
    if not far and not late:
        return ()
    held = {*far, LAG} if late else far
    usual_lag_s = channel_description(given.channel).usual_lag_s
    return tuple(
        calibrate_trial(
            trial.model.with_values(**{name: getattr(given, name) for name in far}), trial.record, calibration.noise,
            calibration.free, start_lag_s=usual_lag_s if late else trial.lag_s, about=given, hold=held,
        )
        for trial in calibration.training
    )  # fmt: skip
