"""One round of the selection: screen all effects, fit the best, validate them, compare them with alternatives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from needleplan.diagnosis.alternatives import AlternativeModel, refit_alternatives, score_alternatives, validate
from needleplan.diagnosis.calibration import UNUSUAL_LAG_FACTOR, CalibratedTrial, Calibration, unusual_lag_s
from needleplan.diagnosis.catalogue import (
    CatalogueEntry,
    FittedEffect,
    Library,
    chance_probability,
    local_optima,
    screen,
    whitened_sensitivities,
)
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.joint_fit import JointFit, fit_jointly, is_nonzero, transfers
from needleplan.diagnosis.likelihood import Gates, JointLikelihood
from needleplan.models.effects import SIZE, Effect
from needleplan.signals import Array

__all__ = ["RoundOutcome", "Search", "SelectionRound", "explains_as_well", "run_round"]

# Largest number of screened effects that are fitted in a round.
_MOST_FITTED = 4
# Deficit in BIC gain behind the best effect up to which an effect is still fitted.
_FIT_MARGIN = 40.0
# The same deficit as a share of the best BIC gain; the larger of both limits applies.
_FIT_MARGIN_SHARE = 0.1
# The same share for an effect with local optima, because its screened gain is less reliable.
_FIT_MARGIN_SHARE_NONCONVEX = 0.5
# Largest number of further local optima of the best effect that are fitted.
_MOST_OPTIMA = 5
# Shortfall below the required BIC gain up to which an effect, screened at the prior, is still fitted.
_IMITATION_MARGIN = 30.0
# Screened BIC gain below which no effect is fitted.
_LEAST_SCREENED_GAIN = 5.0
# Largest number of further effects that are fitted to break a tie.
_MOST_OTHERS = 2
# Share of its BIC gain that an effect must keep beside a second effect to count as independent of it.
_INDEPENDENT_SHARE = 0.5
# Least predicted held-out gain, as a multiple of the required BIC gain, for which validation confirms an effect.
_CONFIRMING_FACTOR = 3.0
# Number of effects permitted beyond the largest number of names, because one name may occur at several depths.
_MOST_REPEATS = 2
# Start of a joint fit: a screened effect, and the trials whose base model it starts from.
_Start = tuple[FittedEffect, Sequence[CalibratedTrial]]


class RoundOutcome(StrEnum):
    """How a round ended. The values are those of `diagnosis.json`."""

    ACCEPTED = "accepted"
    WEAK = "weak"
    """No effect could be fitted, or the best does not reach the required BIC gain, or its amplitude may be zero."""

    CHANCE = "chance"
    """Simulated data without an effect reach the same BIC gain too often."""

    TIE = "tie"
    """At least two effects explain the data equally well."""

    NO_TRANSFER = "no_transfer"
    """The held-out trials refute the best effect."""

    SMALL = "small"
    """The gain of the further effect is too small, compared with that of the first effect."""

    NAMELESS = "nameless"
    """A nonparametric alternative does better than one of the effects."""

    ENOUGH = "enough"
    """The largest number of names is reached."""


@dataclass(frozen=True)
class SelectionRound:
    """One round: screened effects, alternatives, fits ordered by rank, p-value of the best fit, and outcome."""

    screened: tuple[FittedEffect, ...]
    alternatives: tuple[AlternativeModel, ...]
    ranked: tuple[JointFit, ...]
    p_value: float | None
    outcome: RoundOutcome
    tied: tuple[str, ...] = ()
    """Names of the effects that explain the data equally well, the best first; empty without a tie."""


def explains_as_well(best: JointFit, other: JointFit, lead: float) -> bool:
    """Return whether `other` explains the data as well as `best`.

    The result is True if the combined gain of `other` is less than `lead` behind, or if `other` is not refuted and the
    BIC gain of `other` in training is more than `lead` ahead.
    """
    fits_better = not other.refuted and other.newest.bic_gain > best.newest.bic_gain + lead
    return bool(other.combined_gain > best.combined_gain - lead or fits_better)


@dataclass(frozen=True)
class Search:
    """Data, catalogue and gates that all rounds share, with a cache of sensitivities and fits."""

    calibration: Calibration
    library: Library
    entries: tuple[CatalogueEntry, ...]
    base: JointLikelihood
    sensitivities: Sequence[Array]
    """Whitened sensitivities of all candidates for the base model without effects, one array per trial."""

    at_prior: tuple[CalibratedTrial, ...]
    """As `Selection.at_prior`: trials with those parameters at their priors that calibration moved far."""

    gates: Gates
    seed: int
    _sensitivities: dict[int, tuple[JointFit, list[Array]]] = field(default_factory=dict)
    _rests: dict[tuple[int, int], tuple[JointFit, JointFit]] = field(default_factory=dict)

    @property
    def bic_penalty(self) -> float:
        """BIC penalty of one parameter."""
        return self.base.bic_penalty

    def sensitivities_beside(self, joint: JointFit | None) -> Sequence[Array]:
        """Return the whitened sensitivities of all candidates for the trials of a joint fit; cached for each fit."""
        if joint is None:
            return self.sensitivities
        if id(joint) not in self._sensitivities:
            made = whitened_sensitivities(self.calibration, self.library, joint.trials, self.entries)
            self._sensitivities[id(joint)] = joint, made  # keeps the fit alive, so that its id stays unique
        return self._sensitivities[id(joint)][1]

    def without(self, joint: JointFit, index: int) -> JointFit:
        """Return a joint fit of all effects of `joint` except number `index`; cached."""
        key = id(joint), index
        if key not in self._rests:
            rest = [each for place, each in enumerate(joint.effects) if place != index]
            self._rests[key] = joint, fit_jointly(rest, self.calibration, self.base, joint.trials)
        return self._rests[key][1]

    def has_local_optima(self, effect: Effect) -> bool:
        """Return whether fits of an effect may end in local optima."""
        return next(each.has_local_optima for each in self.entries if each.effect is effect)

    def start(self, screened: FittedEffect) -> FittedEffect:
        """Return the starting values of a joint fit: a screened effect, with the search range of its parameters."""
        bounds = next(each.bounds() for each in self.entries if each.effect is screened.effect)
        return FittedEffect(screened.effect, screened.values, bounds)

    def sensitivities_at_prior(self) -> Sequence[Array]:
        """Return the whitened sensitivities of all candidates for the base model as given, in the trials `at_prior`."""
        return whitened_sensitivities(
            self.calibration, self.library, self.at_prior, self.entries, self.calibration.given
        )


def run_round(search: Search, taken: JointFit | None, first_gain: float) -> SelectionRound:
    """Look for one more effect beside the effects of `taken` and return the round.

    `first_gain` is the likelihood gain of the first effect; it is not used if `taken` is None.
    """
    gates = search.gates
    likelihood = taken.likelihood if taken else search.base
    trials = taken.trials if taken else search.calibration.training
    sensitivities, count = search.sensitivities_beside(taken), len(taken.effects) if taken else 0
    known = {each.effect.name for each in taken.effects} if taken else set()
    closed = {each.effect.name for each in taken.effects if not each.effect.repeats} if taken else set()
    screened = tuple(
        each for each in screen(likelihood, sensitivities, search.entries) if each.effect.name not in closed
    )
    alternatives = score_alternatives(likelihood, trials)
    needed = gates.needed(likelihood.heterogeneity_sd)
    if not screened:
        return SelectionRound(screened, alternatives, (), None, RoundOutcome.WEAK)
    if len(known) >= gates.most or count >= gates.most + _MOST_REPEATS:
        return SelectionRound(screened, alternatives, (), None, RoundOutcome.ENOUGH)
    starts = _starts_at_prior(search, needed) if search.at_prior and not taken else []
    likely = screened if screened[0].bic_gain >= _LEAST_SCREENED_GAIN else ()
    ranked = _fit_candidates(search, taken, starts, [(each, trials) for each in likely])
    if not ranked:
        return SelectionRound(screened, alternatives, (), None, RoundOutcome.WEAK)
    ranked = _ordered(_at_other_optima(search, taken, _ordered(_validated(search, taken, ranked, needed)), needed))
    tied: tuple[str, ...] = ()
    if ranked[0].newest.bic_gain >= needed:
        before = first_gain if taken else 0.0
        ranked, tied = _least_contested(search, ranked, screened, before, needed)
        tried = {each.newest.name for each in ranked}
        others = [(each, trials) for each in screened if each.effect.name not in tried and each.bic_gain >= needed]
        if tied and others:  # beside a weaker true effect, the tied effects may differ
            more = _validated(search, taken, _fit_candidates(search, taken, others[:_MOST_OTHERS], ()), needed)
            ranked, tied = _least_contested(search, _ordered([*ranked, *more]), screened, before, needed)
    best = ranked[0]
    left = [each for each in search.entries if each.effect.name not in closed]
    p_value = chance_probability(likelihood, sensitivities, left, best.newest.bic_gain, search.seed + count)
    if not taken and best.newest.bic_gain >= needed:
        alternatives = refit_alternatives(best, best.validation, alternatives, search.calibration, search.base)

    def ended(stop: RoundOutcome) -> SelectionRound:
        return SelectionRound(
            screened, alternatives, tuple(ranked), p_value, stop, tied if stop is RoundOutcome.TIE else ()
        )

    if best.newest.bic_gain < needed or not is_nonzero(best, count):
        return ended(RoundOutcome.WEAK)
    if p_value > gates.p_value:
        return ended(RoundOutcome.CHANCE)
    if (
        taken
        and best.newest.likelihood_gain
        < (gates.further_elsewhere if _is_confirmed(best, needed) else gates.further) * first_gain
    ):
        return ended(RoundOutcome.SMALL)
    if tied:
        return ended(RoundOutcome.TIE)
    return ended(RoundOutcome.NO_TRANSFER if best.refuted else RoundOutcome.ACCEPTED)


def _is_confirmed(best: JointFit, needed: float) -> bool:
    """Return whether the held-out trials clearly confirm the newest effect, and its family is not that of the first."""
    first, seen = best.effects[0].effect, best.validation
    return (
        seen is not None and not best.refuted
        and seen.predicted >= _CONFIRMING_FACTOR * needed and best.newest.effect.family is not first.family
    )  # fmt: skip


def _least_contested(
    search: Search, ranked: Sequence[JointFit], screened: Sequence[FittedEffect], first_gain: float, needed: float
) -> tuple[list[JointFit], tuple[str, ...]]:
    """Return the fits in the order of the round, and the names of the tied effects.

    If the best effects tie, a third effect that ties with none and passes the gates is moved to the front, because the
    tied effects may differ beside it; the names are then empty. Without such an effect, the order does not change.
    """
    tied = _tied(search, ranked, screened)
    least = search.gates.further * max(first_gain, ranked[0].newest.likelihood_gain)
    for place, each in enumerate(ranked if tied else ()):
        fits = each.newest.bic_gain >= needed and not each.refuted and each.newest.likelihood_gain >= least
        if place and each.newest.name not in tied and fits:
            order = [each, *ranked[:place], *ranked[place + 1 :]]
            if not _tied(search, order, screened):
                return order, ()
    return list(ranked), tied


def _tied(search: Search, ranked: Sequence[JointFit], screened: Sequence[FittedEffect]) -> tuple[str, ...]:
    """Return the names of the best effect and of all effects that explain the data as well; empty without a tie.

    Two effects that are both present may have equal gains, but each keeps its gain beside the other. An effect that
    keeps most of its gain beside the best effect therefore does not tie with it.
    """
    best, lead = ranked[0], search.gates.lead
    tried = {each.newest.name for each in ranked}
    alone = {each.newest.name: each.newest.bic_gain for each in ranked[1:] if explains_as_well(best, each, lead)} | {
        each.effect.name: each.bic_gain
        for each in screened if each.effect.name not in tried and each.bic_gain > best.newest.bic_gain - lead
    }  # fmt: skip
    if not alone:
        return ()
    beside = screen(best.likelihood, search.sensitivities_beside(best), search.entries)
    achieved = {each.effect.name: each.bic_gain for each in beside}
    needed = search.gates.needed(best.likelihood.heterogeneity_sd)
    alternatives = [
        name for name, bic_gain in alone.items() if achieved[name] < max(needed, _INDEPENDENT_SHARE * bic_gain)
    ]
    return (best.newest.name, *alternatives) if alternatives else ()


def _at_other_optima(search: Search, taken: JointFit | None, ranked: list[JointFit], needed: float) -> list[JointFit]:
    """Return the fits, with the first one replaced by another local optimum of the same effect if it is refuted.

    For example, a breathing motion that shows only in a short dwell fits at several frequencies; the held-out trials
    choose among them. If they refute all optima, or the effect has no further optima, the fits do not change.
    """
    best = ranked[0]
    each = next(each for each in search.entries if each.effect is best.newest.effect)
    places = [name for name in each.effect.parameters if name != SIZE]
    if not best.refuted or best.newest.bic_gain < needed or not each.has_local_optima:
        return ranked
    likelihood, sensitivities = (taken.likelihood if taken else search.base), search.sensitivities_beside(taken)
    found = local_optima(likelihood, sensitivities, search.entries, each.effect, places[0])
    starts = [
        optimum
        for optimum in found[: _MOST_OPTIMA + 1]
        if optimum.bic_gain > (1 - _FIT_MARGIN_SHARE) * found[0].bic_gain
    ]
    trials = taken.trials if taken else search.calibration.training
    others = [other for optimum in starts for other in _fit_candidates(search, taken, [(optimum, trials)], ())]
    as_well = [other for other in others if other.newest.bic_gain > best.newest.bic_gain - search.gates.lead]
    held = [other for other in _validated(search, taken, as_well, needed) if other.validation and not other.refuted]
    return [max(held, key=lambda other: other.combined_gain), *ranked[1:]] if held else ranked


def _ordered(ranked: Sequence[JointFit]) -> list[JointFit]:
    """Return fits sorted by combined gain; refuted and unvalidated fits come last if any fit passed validation."""
    ordered = sorted(ranked, key=lambda each: -each.combined_gain)
    if any(each.validation and not each.refuted for each in ordered):
        ordered.sort(key=lambda each: each.validation is None or each.refuted)
    return ordered


def _validated(search: Search, taken: JointFit | None, ranked: Sequence[JointFit], needed: float) -> list[JointFit]:
    """Return all fits; those that reach the required BIC gain and are near the best are validated."""
    top = max((each.newest.bic_gain for each in ranked), default=0.0)
    least = max(needed, top - max(_FIT_MARGIN, _FIT_MARGIN_SHARE * top))
    found = []
    for each in ranked:
        seen = validate(each, search.calibration, taken) if each.newest.bic_gain >= least else None
        refuted = seen is not None and not transfers(seen, search.gates)
        found.append(replace(each, validation=seen, refuted=refuted))
    return found


def _starts_at_prior(search: Search, needed: float) -> list[_Start]:
    """Return starting points of joint fits for effects that the calibrated base model may hide.

    The effects are screened with the base model at its prior values.
    """
    trials, sensitivities = search.at_prior, search.sensitivities_at_prior()
    at_prior = JointLikelihood([trial.whitened for trial in trials])
    behind = 2 * float(search.base.evidence.max() - at_prior.evidence.max())
    seen = screen(at_prior, sensitivities, search.entries)
    likely = [each for each in seen if each.bic_gain - behind > needed - _IMITATION_MARGIN][: _MOST_FITTED - 1]
    lag = unusual_lag_s(search.calibration)
    lag_starts = [replace(each, values={**each.values, SIZE: lag}) for each in seen if each.effect.is_lag and lag]
    return [(each, trials) for each in (*likely, *lag_starts)]


def _fit_candidates(
    search: Search, taken: JointFit | None, certain: Sequence[_Start], screened: Sequence[_Start]
) -> list[JointFit]:
    """Return one joint fit per effect, the largest BIC gain first.

    All `certain` starts are fitted, and at most four of `screened`, which are sorted by gain; those far behind the best
    fit so far are skipped. A lag effect whose total lag is usual for the sensor is left out.
    """
    usual_lag_s = channel_description(search.calibration.given.channel).usual_lag_s
    before = taken.likelihood_gain if taken else 0.0
    found: dict[str, JointFit] = {}
    for count, (each, trials) in enumerate([*certain, *screened]):
        best = max((fit.newest.bic_gain for fit in found.values()), default=-math.inf)
        if count >= len(certain) + _MOST_FITTED:
            break
        far = max(
            _FIT_MARGIN,
            (_FIT_MARGIN_SHARE_NONCONVEX if search.has_local_optima(each.effect) else _FIT_MARGIN_SHARE) * best,
        )
        if count >= len(certain) and each.bic_gain < best - far:
            continue
        start = [*(taken.effects if taken else ()), search.start(each)]
        joint = fit_jointly(start, search.calibration, search.base, trials if not taken else None)
        if each.effect.is_lag and _total_lag_s(joint) < (1 + UNUSUAL_LAG_FACTOR) * usual_lag_s:
            continue  # within the usual lag of sensors
        likelihood_gain = max(joint.likelihood_gain - before, 0.0)
        bic_gain = likelihood_gain - len(each.effect.parameters) * search.bic_penalty
        if each.name not in found or bic_gain > found[each.name].newest.bic_gain:
            found[each.name] = joint.with_newest(likelihood_gain, bic_gain)
    return sorted(found.values(), key=lambda fit: -fit.newest.bic_gain)


def _total_lag_s(joint: JointFit) -> float:
    """Return the total lag of the readings (s): lag of the newest effect plus calibrated lag of the sensor."""
    return joint.newest.values[SIZE] + float(np.median([trial.lag_s for trial in joint.trials]))
