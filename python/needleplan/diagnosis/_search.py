"""The posterior probabilities of sets of effects, with or without a nonparametric component."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from needleplan.diagnosis._base_law import Law
from needleplan.diagnosis._components import Beside, Components
from needleplan.diagnosis._decision import Names
from needleplan.diagnosis._evidence import Columns
from needleplan.diagnosis._fit import at_points, fit_hypothesis, linearised_trials, shared_values, visible_laws
from needleplan.diagnosis._hypothesis import AMPLITUDE_SCALES, TOLERANCE_SCALES, Hypothesis, log_tail
from needleplan.diagnosis._posterior import FAR, MOST_EFFECTS, Posterior, log_prior
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis.calibration import UNUSUAL_LAG_FACTOR, CalibratedTrial
from needleplan.diagnosis.catalogue import (
    VALID_RATIOS,
    CatalogueEntry,
    FittedEffect,
    Library,
)
from needleplan.diagnosis.channels import channel_description
from needleplan.models.effects import SIZE, Effect, Family
from needleplan.signals import Array, AveragedMotion

__all__ = ["search"]

# Sizes from which an effect is fitted that a parameter of the base imitates, in units of what the base imitates.
_SHARES = (0.6, 1.0, 2.0, 4.0)
# Noncentrality of the largest amplitude of the prior below which the base model absorbs an effect.
_INVISIBLE = 30.0
# Least RMS of a column (output per amplitude): columns that do not act keep a finite unit, whose square is finite too.
_INVISIBLE_POWER = 1e-100
# Log evidence of a candidate that cannot be: its sign or its amplitude is not permitted.
_IMPOSSIBLE = -50.0
# Sets that are extended, candidates fitted for each of them, and single effects fitted at first.
_PARENTS, _CHILDREN, _SINGLES = 3, 3, 6
# Values of the first parameter from which an effect with local optima is fitted.
_STARTS = 5
# Factor by which an amplitude may be below the grid of the play of a drive.
_GRID_MARGIN = 1.3
# Largest number of repetitions of an effect.
_REPETITIONS = 3
# Deficit (nats) of the screened log posterior from which a set is not fitted.
_HOPELESS = 4.0
# Deficit (nats) of the log posterior from which a fit is given up; later steps change it by a few nats.
_LOST = 12.0

# Best possible and screened log posterior of a further effect, starts of its fit, and scales of the tolerances.
_Child = tuple[float, float, list[FittedEffect], Mapping[Law, float]]


@dataclass
class _Search:
    """State of a search: screened and fitted sets with their log posteriors."""

    problem: Problem
    entries: tuple[CatalogueEntry, ...]
    columns: Columns
    units: Array
    """Amplitude of each column whose output has the RMS of the noise, shape (m,)."""

    signs: Array
    references: Array
    """Amplitude at which the sensitivity of each column holds, shape (m,); NaN for linear effects."""

    fitted: dict[Names, Hypothesis] = field(default_factory=dict)
    scores: dict[Names, float] = field(default_factory=dict)
    unexplained: float = -math.inf
    """Log posterior of the best component beside the empty set: sets of effects far below it are not fitted."""

    def log_prior(self, count: int) -> float:
        """Return the log prior of one set of `count` effects."""
        return log_prior(self.problem.settings, len(self.entries), count)

    def repeats(self, names: Names) -> bool:
        """Return whether a set contains an effect that may occur several times."""
        return any(entry.effect.repeats and entry.effect.name in names for entry in self.entries)

    @property
    def best(self) -> Names:
        """Names of the best fitted set."""
        return max(self.fitted, key=lambda each: self.scores[each])

    @property
    def highest(self) -> float:
        """Log posterior of the best fitted set, or of the best component beside the empty set."""
        return max(self.unexplained, self.scores[self.best])

    def add(self, hypothesis: Hypothesis) -> None:
        """Keep a fitted set if it is better than what is known of its effects.

        What the linear model promises of a further step of a fit that ended early does not count for effects.
        """
        names = tuple(sorted(hypothesis.names))
        score = self.log_prior(len(names)) + hypothesis.log_evidence - (hypothesis.promise if names else 0.0)
        if names not in self.fitted or score > self.scores[names]:
            self.fitted[names], self.scores[names] = hypothesis, score

    def children(self, parent: Hypothesis) -> list[_Child]:
        """Return each further effect: best possible and screened log posterior, starts, scales; the best first."""
        every = [self._screened(each) for each in self._variants(parent)]
        best = [max(each, key=lambda one: one[0]) for each in zip(*every, strict=True)]
        return sorted(best, key=lambda each: -each[0])

    @staticmethod
    def _variants(parent: Hypothesis) -> list[Hypothesis]:
        """Return a set with its own tolerances of the base's laws; the empty set also with the least ones.

        A tolerance is large where an effect is missing, and then hides it.
        """
        least = dict.fromkeys(parent.scales, TOLERANCE_SCALES[0])
        return [parent] if parent.effects or parent.scales == least else [parent, parent.with_scales(least)]

    def _screened(self, parent: Hypothesis) -> list[_Child]:
        projected = parent.linear.project(self.columns, parent.levels)
        gains = self._gains(projected.slope, projected.curvature, parent.linear.energy[parent.levels])
        h = parent.by_heterogeneity[parent.levels]
        weighted = h[:, None] + gains
        found: list[_Child] = []
        reach = self.problem.reach
        for entry in self.entries:
            again = parent.names.count(entry.effect.name)
            if (again and not entry.effect.repeats) or (not again and len(set(parent.names)) >= MOST_EFFECTS):
                continue
            if any(entry.excludes(each.effect) for each in parent.effects):
                continue
            part = slice(entry.first, entry.last)
            reached = (AMPLITUDE_SCALES[-1] * self.units[part]) ** 2 * projected.curvature[int(h.argmax()), part]
            if reached.max() < _INVISIBLE:
                found.append((-math.inf, -math.inf, [], parent.scales))
                continue
            every = logsumexp(weighted[:, part], axis=0)
            index = entry.first + int(every.argmax())
            evidence = float(logsumexp(every)) - math.log(len(entry.grid))
            t = int(weighted[:, index].argmax())
            amplitude = projected.slope[t, index] / max(projected.curvature[t, index], 1e-300)
            prior = self.log_prior(len(parent.effects) + 1)
            starts = [self._start(entry, index, float(amplitude))]
            if local := bool(entry.effect.nearby(starts[0].values, reach, 1.0)):
                starts += [self._start(entry, entry.first + each, 0.0) for each in _by_first(entry, every)]
            score = prior + evidence
            # A fit gains more than the grid: somewhat for most effects, several times for one with local optima.
            hope = score + (2.0 if local else 0.3) * max(float(gains[t, index]), 0.0)
            if entry.effect.by_trial:
                gain, starts = self._by_trial(entry, parent)
                score = prior + float(h.max()) + gain
                hope = score + 2.0 * max(gain, 0.0)
            if sizes := self._absorbed(entry.effect, parent):
                # A parameter of the base imitates this effect, so that the screened gain says little.
                hope = math.inf
                starts = [self._start(entry, entry.first, size) for size in sizes]
            found.append((hope, score, starts, parent.scales))
        return found

    def _by_trial(self, entry: CatalogueEntry, parent: Hypothesis) -> tuple[float, list[FittedEffect]]:
        """Return the screened log evidence of an effect of which every trial has values of its own, and starts of fits.

        The amplitude is that of the grid; the trials' own parameters have their best values on the grid, at the prior
        probability of one point.
        """
        slope, curvature = parent.linear.by_trial(self.columns, slice(entry.first, entry.last), parent.best)
        sizes = np.array([values[SIZE] for values in entry.grid])
        saved = 2 * slope * sizes - curvature * sizes**2  # squared residual that each point takes away in each trial
        groups = shared_values(entry.effect, entry.grid)
        least = np.array([saved[:, group].max(axis=1).sum() for group in groups])
        noise, energy = self.problem.noise_scale, float(parent.linear.energy[parent.best])
        each = noise.log_likelihood(np.maximum(energy - least, 0.0)) - noise.log_likelihood(np.array(energy))
        each -= len(saved) * np.log([len(group) for group in groups])
        first = next(iter(entry.grid[0]))
        starts: list[FittedEffect] = []
        seen: set[float] = set()
        for which in np.argsort(-each, kind="stable").tolist():
            group = groups[which]
            points = [entry.grid[int(group[int(own[group].argmax())])] for own in saved]
            if points[0][first] not in seen and len(starts) < _STARTS:
                seen.add(points[0][first])
                starts.append(at_points(self._start(entry, entry.first + int(group[0]), 0.0), points))
        return float(logsumexp(each)) - math.log(len(groups)), starts

    def _gains(self, slope: Array, curvature: Array, energy: Array) -> Array:
        """Return the log evidence ratio of each column, its amplitude integrated out, shape (t, m).

        `energy` is that of the set without the column, shape (t,).
        """
        noise, found = self.problem.noise_scale, []
        before = noise.log_likelihood(energy)[:, None]
        sd = np.sqrt(noise.variance(energy))[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            amplitude = np.where(curvature > 0, slope / curvature, 0.0)
        for scale in AMPLITUDE_SCALES:
            variance = (scale * self.units) ** 2
            precision = curvature + 1 / variance
            tail = log_tail(self.signs, slope / np.sqrt(precision) / sd)
            gain = noise.log_likelihood(np.maximum(energy[:, None] - slope**2 / precision, 0.0)) - before
            found.append(gain - 0.5 * np.log1p(variance * curvature) + tail)
        gains = logsumexp(found, axis=0) - math.log(len(AMPLITUDE_SCALES))
        ratio = amplitude / self.references
        outside = np.isfinite(self.references) & ~((ratio > VALID_RATIOS[0]) & (ratio < VALID_RATIOS[1]))
        for entry in self.entries:
            part = slice(entry.first, entry.last)
            small = self.references[part] <= np.nanmin(self.references[part], initial=np.inf)
            outside[:, part] &= ~(small & (ratio[:, part] < VALID_RATIOS[1]) & (ratio[:, part] > 0))  # nearly linear
            if entry.effect.is_lag:
                outside[:, entry.first : entry.last] |= amplitude[:, entry.first : entry.last] < self._least_lag_s
        return np.where(outside | (curvature <= 0), _IMPOSSIBLE, gains)

    @property
    def _least_lag_s(self) -> float:
        """Lag (s) below which a lag is that of a usual sensor, read anywhere in the sample interval."""
        usual_s = channel_description(self.problem.calibration.given.channel).usual_lag_s
        motions = [trial.motion for trial in self.problem.trials]
        sampled_s = max(each.sampled_s if isinstance(each, AveragedMotion) else 0.0 for each in motions)
        return UNUSUAL_LAG_FACTOR * usual_s + sampled_s / 2

    def _absorbed(self, effect: Effect, parent: Hypothesis) -> list[float]:
        """Return start values of the amplitude of a delay that the base imitates by its lag, else none."""
        usual_s = channel_description(self.problem.calibration.given.channel).usual_lag_s
        if effect.is_lag and (lag_s := float(np.median([t.lag_s for t in parent.trials]))) > usual_s:
            return sorted({max(lag_s * share, self._least_lag_s) for share in _SHARES})
        return []

    def _start(self, entry: CatalogueEntry, index: int, amplitude: float) -> FittedEffect:
        bounds = entry.bounds()
        if entry.effect.is_lag:
            bounds[SIZE] = (self._least_lag_s, entry.effect.parameters[SIZE].upper)
        sizes = [values[SIZE] for values in entry.grid if SIZE in values]
        if entry.effect.family is Family.DRIVE and sizes:  # a smaller play is below the resolution of the depth
            bounds[SIZE] = (min(sizes) / _GRID_MARGIN, entry.effect.parameters[SIZE].upper)
        if entry.sign and entry.sign * amplitude < 0:
            amplitude = entry.sign * 1e-3 * entry.effect.parameters[SIZE].typical
        values = dict(entry.grid[index - entry.first])
        return FittedEffect(entry.effect, {**values, SIZE: amplitude or values.get(SIZE, 0.0)}, bounds)

    def _fit(self, parent: Hypothesis, starts: list[FittedEffect], scales: Mapping[Law, float]) -> Hypothesis:
        """Return the best fit of a set with one more effect; what the base imitates of it is taken from the base."""
        problem, effects, trials = self.problem, parent.effects, parent.trials
        # below this log evidence a set has no weight
        least = self.highest - self.log_prior(len(effects) + 1) - _LOST
        if self._absorbed(starts[0].effect, parent):
            usual_s = channel_description(problem.calibration.given.channel).usual_lag_s
            less = tuple(replace(trial, lag_s=usual_s) for trial in trials)
            points = [
                fit_hypothesis(problem, [*effects, start], each, most_steps=0)
                for each in (less, self._at_given(parent)) for start in starts
            ]  # fmt: skip
            best = max(points, key=lambda each: each.log_evidence)
            return fit_hypothesis(problem, best.effects, best.trials)
        found = fit_hypothesis(
            problem, [*effects, starts[0]], trials, others=starts[1:], least=least,
            formula_error=parent.formula_error, scales=scales,
        )  # fmt: skip
        if not visible_laws(parent, trials[0].laws):
            return found
        # A missing effect distorts the base and its laws, and the fit from there finds another optimum: start anew too.
        other = fit_hypothesis(
            problem, [*effects, starts[0]], self._at_given(parent), others=starts[1:],
            least=max(least, found.log_evidence),
        )  # fmt: skip
        return max(found, other, key=lambda each: each.log_evidence)

    def _at_given(self, parent: Hypothesis) -> tuple[CalibratedTrial, ...]:
        """Return the trials linearised at the given base, beside the effects of a set."""
        given = self.problem.calibration.given
        lag_s = channel_description(given.channel).usual_lag_s
        trials = [replace(trial, lag_s=lag_s, model=given, laws=None) for trial in parent.trials]
        return linearised_trials(self.problem, parent.effects, trials)

    def extend(self, parent: Hypothesis, most: int) -> None:
        """Screen all further effects beside a set, and fit the best of them."""
        done = 0
        for hope, score, starts, scales in self.children(parent):
            if not starts:
                continue
            names = tuple(sorted((*parent.names, starts[0].name)))
            if names not in self.fitted and score > self.scores.get(names, -math.inf):
                self.scores[names] = score
            if done < most and names not in self.fitted and hope > self.highest - _HOPELESS:
                child = self._fit(parent, starts, scales)
                self.add(child)
                done += 1
                if names == self.best:
                    self._refit_subsets(child, self.highest - self.log_prior(len(parent.effects)) - _LOST)

    def _refit_subsets(self, child: Hypothesis, least: float) -> None:
        """Fit the set without each of its effects from the same point, so that no effect wins by a better fit alone.

        Below the log evidence `least` a fit is given up.
        """
        for index, left_out in enumerate(child.effects):
            trials, rest = child.trials, child.effects[:index] + child.effects[index + 1 :]
            if left_out.effect.is_lag:  # the lag of the base takes its place
                trials = tuple(replace(each, lag_s=each.lag_s + left_out.values[SIZE]) for each in trials)
            self.add(fit_hypothesis(
                self.problem, rest, trials, formula_error=child.formula_error, scales=child.scales,
                least=least if rest else -math.inf,
            ))  # fmt: skip


def _by_first(entry: CatalogueEntry, scores: Array) -> list[int]:
    """Return the best grid points of the best values of the first parameter, such as the frequency."""
    best: dict[float, int] = {}
    for index in np.argsort(-scores).tolist():
        best.setdefault(next(iter(entry.grid[index].values())), index)
    return list(best.values())[1:_STARTS]


def search(problem: Problem, library: Library, components: Components, empty: Hypothesis, floor: float) -> Posterior:
    """Return the posterior of sets of up to three effects, each with or without one component.

    Sets far below the log posterior `floor` (not normalised) are not fitted. `empty` is the fitted empty set.
    """
    calibration, trials = problem.calibration, problem.trials
    entries = library.entries([trial.motion for trial in trials])
    raw = [library.sensitivities(calibration.model, trial.motion, entries) for trial in trials]
    count = sum(map(len, raw))
    powers = np.sqrt(sum(np.einsum("nm,nm->m", each, each) for each in raw) / count)
    signs = np.concatenate([np.full(len(each.grid), each.sign) for each in entries])
    references = np.array([values.get(SIZE, np.nan) for each in entries for values in each.grid])
    whitened = [trial.whiten(each) for trial, each in zip(trials, raw, strict=True)]
    for entry in entries:
        if entry.effect.is_lag:  # the effect lengthens the calibrated lag; a second lag in series would differ
            for trial, each in zip(trials, whitened, strict=True):
                each[:, entry.first] = trial.lag_sensitivity
    columns = Columns(empty.linear.blocks, [
        problem.decorrelated(number, each) for number, each in enumerate(whitened)
    ])  # fmt: skip
    units = calibration.noise.rms / np.maximum(powers, _INVISIBLE_POWER)
    state = _Search(problem, entries, columns, units, signs, references)
    state.add(empty)
    alone = components.beside(empty)
    gain = state.scores[()] + _log_component(problem, components) + max(alone.log_gains.values())
    state.unexplained = max(gain, floor)
    state.extend(empty, _SINGLES)
    for size in range(1, MOST_EFFECTS + _REPETITIONS):
        known = [each for each in state.fitted if len(each) == size and (size < MOST_EFFECTS or state.repeats(each))]
        parents = sorted(known, key=lambda each: -state.scores[each])
        for place, names in enumerate(parents[:_PARENTS]):
            if place < 2 or state.scores[names] > state.scores[parents[0]] - FAR:
                state.extend(state.fitted[names], _CHILDREN)
    return _with_components(state, components, alone)


def _log_component(problem: Problem, components: Components) -> float:
    """Return the log prior of one kind of component."""
    return math.log(problem.settings.further_cause / len(components.components))


def _with_components(state: _Search, components: Components, alone: Beside) -> Posterior:
    """Add the hypotheses with a component and normalise. `alone` is beside the empty set that was fitted first."""
    problem = state.problem
    logs: dict[tuple[Names, str], float] = {}
    best = max(state.scores.values())
    near = sorted(
        (each for each in state.fitted if state.scores[each] > best - FAR), key=lambda each: -state.scores[each]
    )
    for names, score in state.scores.items():
        logs[names, ""] = score + math.log(1 - problem.settings.further_cause)
    for names in {(), *near}:
        here = state.fitted[names]
        beside = alone if here is alone.hypothesis else components.beside(here)
        for name, gain in beside.log_gains.items():
            logs[names, name] = state.scores[names] + _log_component(problem, components) + gain
        if not names or names == near[0]:
            _refit_component(state, components, beside, logs)
    total, empty = float(logsumexp(list(logs.values()))), state.fitted[()]
    return Posterior(
        problem, state.entries, components, state.fitted, {key: value - total for key, value in logs.items()},
        empty.linear.project(state.columns, np.array([empty.best])), state.units, total,
    )  # fmt: skip


# Gain (nats) of a component from which it is fitted together with the base model and the effects.
_STRONG = 10.0


def _refit_component(
    state: _Search, components: Components, beside: Beside, logs: dict[tuple[Names, str], float]
) -> None:
    """Fit the strongest component beside a set together with the base model, and raise its log posterior."""
    problem, here = state.problem, beside.hypothesis
    found = components.strongest(beside, _STRONG)
    if found is None:
        return
    extra, offset = found
    names = tuple(sorted(here.names))
    fitted = fit_hypothesis(
        problem, here.effects, here.trials, extra, formula_error=here.formula_error, scales=here.scales
    )
    prior = _log_component(problem, components) + state.log_prior(len(names))
    score = prior + (fitted.log_evidence + offset)
    logs[names, extra.name] = max(logs.get((names, extra.name), -math.inf), score)
