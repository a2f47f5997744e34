"""The posterior probabilities of sets of effects, with or without a nonparametric component."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from needleplan.diagnosis._base_law import Law
from needleplan.diagnosis._blocks import HETEROGENEITY_SDS
from needleplan.diagnosis._components import ComponentEvidence, Components
from needleplan.diagnosis._constants import (
    ALIKE,
    BESIDE,
    CHILDREN,
    FAR,
    GAINED,
    HOPELESS,
    KNOWN_NOISE,
    LED,
    LOST,
    MORE_SEARCHES,
    MOST_EFFECTS,
    NOISE_SDS,
    PARENTS,
    REPETITIONS,
    SINGLES,
    STRONG,
)
from needleplan.diagnosis._decision import Names
from needleplan.diagnosis._fit import fit_hypothesis, linearised_trials, start_point
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._posterior import Posterior
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._refinement import contenders
from needleplan.diagnosis._screening import Child, Screening
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect, Library
from needleplan.diagnosis.channels import channel_description
from needleplan.models.effects import SIZE

__all__ = ["search"]


@dataclass
class _Search:
    """State of a search: screened and fitted sets with their log posteriors."""

    problem: Problem
    screening: Screening
    fitted: dict[Names, Hypothesis] = field(default_factory=dict)
    scores: dict[Names, float] = field(default_factory=dict)
    extended: set[Names] = field(default_factory=set)
    unexplained: float = -math.inf
    """Screened log posterior of the empty set with its best component: sets of effects far below it are not fitted."""

    refitted: float = -math.inf
    """The same after a fit: sets that cannot reach it are not extended."""

    def may_explain(self, names: Names) -> bool:
        """Return whether a set with further effects may be as probable as the empty set with its best component.

        Further effects seldom gain more than the first ones, so that a set gains at most as many times as much as a set
        may have effects.
        """
        gain = self.fitted[names].log_evidence - self.fitted[()].log_evidence  # with what further steps promise
        return self.scores[()] + (MOST_EFFECTS + REPETITIONS) * gain > self.refitted

    def repeats(self, names: Names) -> bool:
        """Return whether a set contains an effect that may occur several times."""
        return any(entry.effect.repeats and entry.effect.name in names for entry in self.screening.entries)

    @property
    def best(self) -> Names:
        """Names of the best fitted set."""
        return max(self.fitted, key=lambda names: self.scores[names])

    @property
    def highest(self) -> float:
        """Log posterior of the best fitted set, or of the empty set with its best component, whichever is larger."""
        return max(self.unexplained, self.scores[self.best])

    @property
    def explained(self) -> bool:
        """Whether the best fitted set leaves no more than noise: other sets can be as good, but hardly better.

        Tissue whose heterogeneity is at its limit stands for something else, and explains nothing.
        """
        fitted, noise = self.fitted[self.best], self.problem.noise_scale
        spread = NOISE_SDS * math.sqrt(2 / noise.count + 2 / noise.freedom)
        residual_variance = float(fitted.linear.energy[fitted.best]) / noise.count
        below_limit = bool(self.problem.sds[fitted.best] < HETEROGENEITY_SDS.max())
        return below_limit and noise.freedom >= KNOWN_NOISE and residual_variance < 1 + spread

    def add(self, hypothesis: Hypothesis) -> None:
        """Keep a fitted set if its score is higher than the scores of earlier fits of the same effects.

        If a fit ended early, its log evidence includes the promised gain of a further step. The score of a set of
        effects is without this gain.
        """
        names = tuple(sorted(hypothesis.names))
        score = self.screening.log_prior(len(names)) + hypothesis.log_evidence - (hypothesis.promise if names else 0.0)
        if names not in self.fitted or score > self.scores[names]:
            self.fitted[names], self.scores[names] = hypothesis, score

    def _fit(self, child: Child, least: float = -math.inf) -> Hypothesis:
        """Return the best fit of a set with one more effect.

        If the lag of the base imitates this effect, a delay, the lag is reset to the usual one before the fit.
        """
        if child.also is not None:
            first = self._fit(child.also)
            return max(
                first, self._fit(replace(child, also=None), first.log_evidence), key=lambda fit: fit.log_evidence
            )
        problem, parent, starts = self.problem, child.beside, child.starts
        effects, trials = parent.effects, parent.trials
        # below this log evidence a set has no weight
        least = max(least, self.highest - self.screening.log_prior(len(parent.names) + 1) - LOST)
        if self.screening.absorbed(starts[0].effect, parent):
            usual_s = channel_description(problem.calibration.given.channel).usual_lag_s
            less = tuple(replace(trial, lag_s=usual_s) for trial in trials)
            bases = less, self.screening.at_given(parent)
            points = [start_point(problem, [*effects, one], base, like=parent) for one in starts for base in bases]
            best = max(points, key=lambda point: point.log_evidence)  # a step of a delay is far from linear
            return fit_hypothesis(problem, best.effects, best.trials, least=least, like=parent)
        (_, start), *others = self._by_hope(parent, contenders(starts, parent), trials)
        fitted = fit_hypothesis(problem, [*effects, start], trials, least=least, like=parent, held=child.held)
        for hope, start in others[: MORE_SEARCHES - 1]:
            if hope > fitted.log_evidence:  # a start that promises more than the fit reached
                other = fit_hypothesis(problem, [*effects, start], trials, least=least, like=parent, held=child.held)
                fitted = max(fitted, other, key=lambda fit: fit.log_evidence)
        return self._best_optimum(fitted, child, least) if len(starts) > 1 else fitted

    def _by_hope(
        self, parent: Hypothesis, starts: Sequence[FittedEffect], trials: Sequence[CalibratedTrial]
    ) -> list[tuple[float, FittedEffect]]:
        """Return the starts with the evidence that a step of the whole linear model promises, the largest first."""
        if len(starts) == 1:
            return [(math.inf, starts[0])]
        points = [start_point(self.problem, [*parent.effects, start], trials, like=parent) for start in starts]
        hopes = [point.hope for point in points]
        return [(hopes[index], starts[index]) for index in np.argsort(hopes)[::-1].tolist()]

    def _best_optimum(self, fitted: Hypothesis, child: Child, least: float) -> Hypothesis:
        """Return the fit of an effect with local optima, or a better one from another start.

        A strong effect that is missing distorts the base of the parent, beside which the start was sought. So it is
        sought again beside the base of the fit, as long as this gains. A fit is given up if it hardly reaches the log
        evidence `least`.
        """
        for _ in range(MORE_SEARCHES):
            if fitted.log_evidence < child.beside.log_evidence + STRONG:
                break
            problem, own = fitted.problem, fitted.effects[-1]
            without = fitted.again(fitted.effects[:-1], linearised_trials(problem, fitted.effects[:-1], fitted.trials))
            _, start = self._by_hope(without, contenders([own, *child.starts], without), without.trials)[0]
            if _same_point(start, own):
                break
            effects = [*fitted.effects[:-1], start]
            other = fit_hypothesis(
                self.problem, effects, without.trials, least=max(fitted.log_evidence, least), like=fitted
            )
            if other.log_evidence < fitted.log_evidence + GAINED:
                break
            fitted = other
        return fitted

    @staticmethod
    def _names(child: Child) -> Names:
        """Return the names of the set of a candidate."""
        return tuple(sorted((*child.beside.names, child.effect.name)))

    def extend(self, parent: Hypothesis, most: int) -> None:
        """Screen all effects that can be added to the set `parent`, and fit at most `most` of the candidates.

        A candidate is fitted if its best possible log posterior reaches that of the best set within `HOPELESS` nats.
        The best candidate of each screening is fitted in any case if its gain is strong. Further strong candidates are
        fitted if the residual is above the noise, and their gain is comparable with the lead of the best set over
        `parent`.
        """
        self.extended.add(tuple(sorted(parent.names)))
        fits = 0
        for child in self.screening.children(parent):
            if not child.starts:
                continue
            names = self._names(child)
            if names not in self.fitted and child.score > self.scores.get(names, -math.inf):
                self.scores[names] = child.score
            lead = self.highest - self.scores[tuple(sorted(parent.names))]
            strong = child.strong and (child.leads or (child.most > ALIKE * lead and not self.explained))
            hopeful = strong or child.hope > self.highest - HOPELESS
            if fits < most and names not in self.fitted and hopeful and not self._may_be_an_error(child):
                self._try(child)
                fits += 1

    def _may_be_an_error(self, child: Child) -> bool:
        """Return whether a further effect gains so little that it may be an error of another one's formula.

        The answer would leave it out by equation (9).
        """
        parent, further = tuple(sorted(child.beside.names)), child.effect.name
        score, every = self.scores[parent], {*parent, further}
        gains = [
            score - max(other for names, other in self.scores.items() if {*names} <= every - {member})
            for member in {*parent} - {further}
        ]
        hope = max(child.hope, child.also.hope if child.also else -math.inf)
        return bool(gains) and hope - score < self.problem.settings.formula_share * max(gains)

    def _try(self, child: Child) -> None:
        """Fit a set with one more effect, and its subsets if it becomes the best.

        If the effect has a value for each trial, and these agree, the set with one value for all takes its place.
        """
        fitted = self._fit(child)
        if shared := self.screening.shared(fitted.effects[-1], agreeing=True):
            self.scores.pop(self._names(child), None)
            fitted = fit_hypothesis(self.problem, [*fitted.effects[:-1], shared], fitted.trials, like=fitted)
        self.add(fitted)
        names = tuple(sorted(fitted.names))
        if names == self.best:
            self._converge(names)
            self._refit_subsets(self.fitted[names])

    def _add_rival(self, hypothesis: Hypothesis) -> None:
        """Keep a fitted set, and fit it on if it is near the best one."""
        self.add(hypothesis)
        names = tuple(sorted(hypothesis.names))
        if self.scores[names] > self.scores[self.best] - FAR:
            self._converge(names)

    def _converge(self, names: Names) -> None:
        """Fit a set again as long as it gains by steps that its linear model promises."""
        here = self.fitted[names]
        for _ in range(MORE_SEARCHES):
            if here.promise < GAINED:
                break
            further = fit_hypothesis(self.problem, here.effects, here.trials, like=here)
            self.add(further)
            if further.log_evidence < here.log_evidence + GAINED:
                break
            here = further

    def exchange(self) -> None:
        """Replace each effect of the best set by its imitators, and fit these sets.

        The screening of a smaller set underestimates the gain of an imitator, because the base of that set takes up a
        part of the gap. If another set becomes the best, its effects are exchanged too. If the base has tolerances of
        its laws, they take up this part, and the exchange changes no answers.
        """
        done: set[Names] = set()
        while (names := self.best) not in done:
            done.add(names)
            fitted = self.fitted[names]
            for index, effect in enumerate(fitted.effects):
                if effect.given:
                    continue
                rest = fitted.effects[:index] + fitted.effects[index + 1 :]
                parent = fit_hypothesis(self.problem, rest, fitted.trials, like=fitted, most_steps=0)
                children = self.screening.children(parent)
                gain = max((child.gain for child in children if child.effect.name == effect.name), default=math.inf)
                for child in children:
                    if child.starts and child.gain > max(ALIKE * gain, 0.0) and self._names(child) not in self.fitted:
                        self._try(child)

    def _refit_subsets(self, child: Hypothesis) -> None:
        """Fit simpler sets from the same point, so that no effect wins by a better fit alone.

        Each simpler set lacks one effect, or has one value for all trials where an effect had a value for each
        trial. If one of the smaller sets becomes the best, its subsets are fitted too.
        """
        least = self.highest - self.screening.log_prior(len(child.names) - 1) - LOST
        for index, left_out in enumerate(child.effects):
            if left_out.given:
                continue
            trials, rest = child.trials, child.effects[:index] + child.effects[index + 1 :]
            if left_out.effect.is_lag:  # the lag of the base takes its place
                trials = tuple(replace(trial, lag_s=trial.lag_s + left_out.values[SIZE]) for trial in trials)
            self._add_rival(fit_hypothesis(self.problem, rest, trials, like=child, least=least))
            if shared := self.screening.shared(left_out):
                effects = [*child.effects[:index], shared, *child.effects[index + 1 :]]
                self._add_rival(fit_hypothesis(self.problem, effects, child.trials, like=child))
        if 0 < len(self.best) < len(child.names):
            self._refit_subsets(self.fitted[self.best])


def _same_point(one: FittedEffect, other: FittedEffect) -> bool:
    """Return whether two fits of an effect have the same places, times and rates."""
    return replace(one, values={**one.values, SIZE: other.values[SIZE]}) == other


def search(
    problem: Problem,
    library: Library,
    components: Components,
    empty: Hypothesis,
) -> Posterior:
    """Return the posterior of sets of up to three different effects, each with or without one component.

    An effect that repeats may occur several times, with up to `MOST_EFFECTS` + `REPETITIONS` effects in all.
    `empty` is the fitted empty set.

    This is a beam search. The sets of each size are ranked by their log posterior, and the best of them are extended
    by one effect: the first (of single effects the first two, unless the best set explains the data down to the
    noise), and all sets within a margin of the first. Sets that hardly gain over the empty set are not extended.
    """
    state = _Search(problem, Screening.of(problem, library))
    state.add(empty)
    alone = components.evidence(empty)
    refitted = _refitted_component(state, components, alone)
    state.unexplained = state.scores[()] + _log_component(problem, components) + max(alone.log_gains.values())
    state.refitted = max([state.unexplained, *refitted.values()])
    state.extend(empty, SINGLES)
    for size in range(1, MOST_EFFECTS + REPETITIONS):
        sets = [names for names in state.fitted if len(names) == size and (size < MOST_EFFECTS or state.repeats(names))]
        parents = sorted(sets, key=lambda names: -state.scores[names])
        for rank, names in enumerate(parents[:PARENTS]):
            if state.fitted[names].log_evidence < empty.log_evidence + LED or not state.may_explain(names):
                continue
            always = 1 if state.explained or size > 1 else 2
            margin = FAR if size == 1 else HOPELESS
            if rank < always or state.scores[names] > state.scores[parents[0]] - margin:
                state.extend(state.fitted[names], CHILDREN)
    # a subset of a set that was extended may have become the best
    while state.best not in state.extended and state.may_explain(state.best):
        state.extend(state.fitted[state.best], CHILDREN)
    if Law.DEPTH not in empty.groups:
        state.exchange()
    return _with_components(state, components, alone, refitted)


def _log_component(problem: Problem, components: Components) -> float:
    """Return the log prior of one kind of component."""
    return math.log(problem.settings.further_cause / len(components.components))


def _with_components(
    state: _Search, components: Components, alone: ComponentEvidence, refitted: Mapping[str, float]
) -> Posterior:
    """Add the hypotheses with a component, and return the normalised posterior.

    `alone` is the evidence of the components for the empty set that was fitted first, and `refitted` the log posterior
    of this set with the strongest one.
    """
    problem, screening = state.problem, state.screening
    logs: dict[tuple[Names, str], float] = {}
    best = max(state.scores.values())
    near = sorted(
        (names for names in state.fitted if state.scores[names] > best - BESIDE),
        key=lambda names: -state.scores[names],
    )
    for names, score in state.scores.items():
        logs[names, ""] = score + math.log(1 - problem.settings.further_cause)
    for names in {(), *near}:
        hypothesis = state.fitted[names]
        evidence = alone if hypothesis is alone.hypothesis else components.evidence(hypothesis)
        for name, gain in evidence.log_gains.items():
            logs[names, name] = state.scores[names] + _log_component(problem, components) + gain
        again = names in near[:1] and evidence is not alone
        fits = [*([] if names else [refitted]), *([_refitted_component(state, components, evidence)] if again else [])]
        for name, score in [entry for fit in fits for entry in fit.items()]:
            logs[names, name] = max(logs.get((names, name), -math.inf), score)
    total, empty = float(logsumexp(list(logs.values()))), state.fitted[()]
    return Posterior(
        problem, screening.entries, components, state.fitted, {key: value - total for key, value in logs.items()},
        empty.linear.project(screening.columns, np.array([empty.best])), screening.units,
    )  # fmt: skip


def _refitted_component(state: _Search, components: Components, evidence: ComponentEvidence) -> dict[str, float]:
    """Return the log posterior of a hypothesis that is fitted together with its strongest component, by its name.

    Without this fit, the log posterior is the estimate with the base model of the hypothesis without a component. The
    result is empty if no component gains `STRONG` nats. `fit_hypothesis` gives the evidence at the best place and scale
    of the component; `offset` converts it to the average over places and scales.
    """
    problem, hypothesis = state.problem, evidence.hypothesis
    strongest = components.strongest(evidence, STRONG)
    if strongest is None:
        return {}
    extra, offset = strongest
    fitted = fit_hypothesis(problem, hypothesis.effects, hypothesis.trials, extra, like=hypothesis)
    prior = _log_component(problem, components) + state.screening.log_prior(len(hypothesis.names))
    return {extra.name: prior + fitted.log_evidence + offset}
