"""Screening of further effects beside a set: probability by one linear column, and start values of a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import logsumexp

from needleplan.diagnosis._base_law import Law
from needleplan.diagnosis._constants import (
    AMPLITUDE_SCALES,
    CLOCK_RAD,
    DELAY_SHARES,
    DISTORTED,
    FORMULA_ERRORS,
    GRID_MARGIN,
    IMPOSSIBLE,
    INVISIBLE,
    MOST_EFFECTS,
    STARTS,
    STRONG,
    TOLERANCE_SCALES,
    UNUSUAL_LAG_FACTOR,
    VALID_RATIOS,
)
from needleplan.diagnosis._evidence import Columns
from needleplan.diagnosis._fit import linearised_trials, visible_laws
from needleplan.diagnosis._hypothesis import Hypothesis, log_tail
from needleplan.diagnosis._posterior import log_prior
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._refinement import at_points, shared_values
from needleplan.diagnosis._tangents import is_added
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import CatalogueEntry, FittedEffect, Library
from needleplan.diagnosis.channels import channel_description
from needleplan.models import Model
from needleplan.models.effects import SIZE, Effect, Family
from needleplan.signals import Array, AveragedMotion

__all__ = ["Child", "Screening"]

# Least RMS of a column (output per amplitude): columns that do not act keep a finite unit, whose square is finite too.
_INVISIBLE_POWER = 1e-100


@dataclass(frozen=True)
class Child:
    """Candidate of the search: an effect to add to the hypothesis `beside`, with its screened evidence."""

    effect: Effect
    hope: float
    """Best possible log posterior."""

    score: float
    """Screened log posterior."""

    gain: float
    """Screened log ratio (nats) of the evidence with the effect to the evidence of `beside` alone."""

    starts: list[FittedEffect]
    """Start values for the fit of the effect, the best first; empty if the data do not show the effect."""

    beside: Hypothesis
    held: bool
    """Whether the tolerances are held in the first stage of the fit, because `beside` is at the given base."""

    several: bool = False
    """Whether a fit may gain several times what the linear columns say, since the effect is far from linear."""

    leads: bool = False
    """Whether a screening gave this effect the best score."""

    also: Child | None = None
    """The same effect beside the given base, from which it is fitted too: it is strong there, or far from linear."""

    @property
    def most(self) -> float:
        """Screened gain (nats), here or beside the given base, whichever is larger."""
        return self.gain if self.also is None else max(self.gain, self.also.gain)

    @property
    def strong(self) -> bool:
        """Whether the effect gains much, here or beside the given base."""
        return self.most > STRONG


@dataclass(frozen=True)
class Screening:
    """All effects of a library as linear columns beside the base of a problem."""

    problem: Problem
    library: Library
    entries: tuple[CatalogueEntry, ...]
    columns: Columns
    units: Array
    """Amplitude of each column whose output has the RMS of the noise, shape (m,)."""

    @classmethod
    def of(cls, problem: Problem, library: Library) -> Self:
        """Return the columns of all effects beside the calibrated base."""
        entries = library.entries([trial.motion for trial in problem.trials])
        columns, powers = _columns_of(problem, library, entries, problem.trials, problem.calibration.model)
        return cls(
            problem, library, entries, columns, problem.calibration.noise.rms / np.maximum(powers, _INVISIBLE_POWER)
        )

    @cached_property
    def _apart(self) -> tuple[CatalogueEntry, ...]:
        """The first of the entries that share their columns, in the order of the columns."""
        return tuple(
            {entry.first: entry for entry in reversed(self.entries)}[first]
            for first in sorted({entry.first for entry in self.entries})
        )

    @cached_property
    def signs(self) -> Array:
        """Sign of the amplitude of each column, 0 if both are permitted, shape (m,)."""
        return np.concatenate([np.full(len(each.grid), each.sign) for each in self._apart])

    @cached_property
    def references(self) -> Array:
        """Amplitude at which the sensitivity of each column holds, shape (m,); NaN for linear effects."""
        return np.array([values.get(SIZE, np.nan) for each in self._apart for values in each.grid])

    def log_prior(self, count: int) -> float:
        """Return the log prior of one set of `count` effects."""
        return log_prior(self.problem.settings, len(self.entries), count)

    def children(self, parent: Hypothesis) -> list[Child]:
        """Return each further effect beside a set: first the best of each screening, then by hope.

        An effect is screened at up to three points, and the one with the largest hope counts: at `parent`; for the
        empty set, with the least tolerances too, because a missing effect enlarges tolerances, which then hide it; and
        at the given base with the least tolerances, because a missing effect distorts the base. The last one is taken
        if a law of the base is visible beside at most `DISTORTED` effects, or if the base has no laws, as that of
        paths.
        """
        least = dict.fromkeys(parent.scales, TOLERANCE_SCALES[0])
        every = [self._screened(parent, self.columns)]
        if not parent.names and parent.scales != least:
            every.append(self._screened(parent.with_scales(least), self.columns))
        distorted = len(parent.names) <= DISTORTED and visible_laws(parent, parent.trials[0].laws)
        if Law.DEPTH not in parent.groups or distorted:
            given = Hypothesis.at(
                self.problem, parent.effects, self.at_given(parent), formula_error=FORMULA_ERRORS[0], scales=least
            )
            every.append(self._screened(given, self._columns_at_given, held=True))
        best = []
        for each in zip(*every, strict=True):
            one, last = max(each, key=lambda one: one.hope), each[-1]
            both = last.held and not one.held and last.starts and (one.several or last.strong)
            best.append(replace(one, also=last) if both else one)
        leaders = [max(screened, key=lambda one: one.score).effect for screened in every if screened]
        best = [replace(each, leads=each.effect in leaders) for each in best]
        return sorted(best, key=lambda each: (not each.leads, -each.hope))

    @cached_property
    def _columns_at_given(self) -> Columns:
        """The columns of all effects beside the given base with the usual lag."""
        problem = self.problem
        return _columns_of(problem, self.library, self.entries, self._trials_at_given, problem.calibration.given)[0]

    @cached_property
    def _trials_at_given(self) -> tuple[CalibratedTrial, ...]:
        """The trials linearised at the given base with the usual lag, beside the effects of the given model."""
        problem, effects = self.problem, self.problem.calibration.effects
        trials = linearised_trials(problem, effects, self._given(problem.trials), again=True)
        return Hypothesis.at(problem, effects, trials).trials

    def _screened(self, parent: Hypothesis, columns: Columns, *, held: bool = False) -> list[Child]:
        projected = parent.linear.project(columns, parent.levels)
        gains = self._gains(projected.slope, projected.curvature, parent.linear.energy[parent.levels])
        h = parent.by_heterogeneity[parent.levels]
        weighted = h[:, None] + gains
        found: list[Child] = []
        reach = self.problem.reach
        for entry in self.entries:
            again = sum(effect.name == entry.effect.name for effect in parent.effects)
            if (again and not entry.effect.repeats) or (not again and len(set(parent.names)) >= MOST_EFFECTS):
                continue
            if any(entry.excludes(effect.effect) for effect in parent.effects):
                continue
            part = slice(entry.first, entry.last)
            reached = (AMPLITUDE_SCALES[-1] * self.units[part]) ** 2 * projected.curvature[int(h.argmax()), part]
            if reached.max() < INVISIBLE:
                found.append(Child(entry.effect, -math.inf, -math.inf, -math.inf, [], parent, held))
                continue
            every = logsumexp(weighted[:, part], axis=0)
            index = entry.first + int(every.argmax())
            evidence = float(logsumexp(every)) - math.log(len(entry.grid))
            t = int(weighted[:, index].argmax())
            amplitude = projected.slope[t, index] / max(projected.curvature[t, index], 1e-300)
            prior = self.log_prior(len(parent.names) + 1)
            starts = [self._start(entry, index, float(amplitude))]
            if local := bool(entry.effect.nearby(starts[0].values, reach, 1.0)):
                starts += [self._start(entry, entry.first + each, 0.0) for each in _by_first(entry, every)]
            score = prior + evidence
            # A fit gains more than the grid: somewhat for most effects, several times for one with local optima, or
            # whose output is not in proportion to the amplitude.
            several = local or entry.effect.by_trial != () or SIZE in entry.grid[0]
            hope = score + (2.0 if several else 0.3) * max(float(gains[t, index]), 0.0)
            if entry.effect.by_trial:
                ratio, starts = self._by_trial(entry, parent, columns)
                score = prior + float(h.max()) + ratio
                hope = score + 2.0 * max(ratio, 0.0)
            if sizes := self.absorbed(entry.effect, parent):
                # A parameter of the base imitates this effect, so that the screened gain says little.
                hope = math.inf
                starts = [self._start(entry, entry.first, size) for size in sizes]
            gain = score - prior - parent.log_evidence
            score -= parent.promise if parent.names else 0.0  # as of a fitted set
            found.append(Child(entry.effect, hope, score, gain, starts, parent, held, several))
        return found

    def _by_trial(
        self, entry: CatalogueEntry, parent: Hypothesis, columns: Columns
    ) -> tuple[float, list[FittedEffect]]:
        """Return the screened log evidence of an effect with separate values for every trial, and starts of fits.

        The amplitude is that of the grid; the trials' own parameters have their best values on the grid, at the prior
        probability of one point.
        """
        slope, curvature = parent.linear.by_trial(columns, slice(entry.first, entry.last), parent.best)
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
            if points[0][first] not in seen and len(starts) < STARTS:
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
            if least := self._least(entry.effect):
                outside[:, part] |= amplitude[:, part] < least
        return np.where(outside | (curvature <= 0), IMPOSSIBLE, gains)

    @property
    def _least_lag_s(self) -> float:
        """Lag (s) below which a lag is that of a usual sensor, read anywhere in the sample interval."""
        usual_s = channel_description(self.problem.calibration.given.channel).usual_lag_s
        motions = [trial.motion for trial in self.problem.trials]
        sampled_s = max(motion.sampled_s if isinstance(motion, AveragedMotion) else 0.0 for motion in motions)
        return UNUSUAL_LAG_FACTOR * usual_s + sampled_s / 2

    def _least(self, effect: Effect) -> float:
        """Return the amplitude below which an effect is another value of a parameter of the base; 0 without a limit.

        References show this value, so that beside them only a delay is limited, which the lag of each trial replaces.
        """
        if effect.is_lag:
            return self._least_lag_s
        shown = any(trial.is_reference for trial in self.problem.trials)
        return float(self.problem.calibration.given.values()[effect.imitated]) if effect.imitated and not shown else 0.0

    def absorbed(self, effect: Effect, parent: Hypothesis) -> list[float]:
        """Return start amplitudes (s) of a delay effect that the lag of the base imitates; empty for other effects."""
        usual_s = channel_description(self.problem.calibration.given.channel).usual_lag_s
        if effect.is_lag and (lag_s := float(np.median([t.lag_s for t in parent.trials]))) > usual_s:
            return sorted({max(lag_s * share, self._least_lag_s) for share in DELAY_SHARES})
        return []

    def _start(self, entry: CatalogueEntry, index: int, amplitude: float) -> FittedEffect:
        bounds = entry.bounds()
        if least := self._least(entry.effect):
            bounds[SIZE] = (least, entry.effect.parameters[SIZE].upper)
        sizes = [values[SIZE] for values in entry.grid if SIZE in values]
        if entry.effect.family is Family.DRIVE and sizes:  # a smaller play is below the resolution of the depth
            bounds[SIZE] = (min(sizes) / GRID_MARGIN, entry.effect.parameters[SIZE].upper)
        if entry.sign and entry.sign * amplitude < 0:
            amplitude = entry.sign * 1e-3 * entry.effect.parameters[SIZE].typical
        values = dict(entry.grid[index - entry.first])
        return FittedEffect(entry.effect, {**values, SIZE: amplitude or values.get(SIZE, 0.0)}, bounds)

    def shared(self, each: FittedEffect, *, agreeing: bool = False) -> FittedEffect | None:
        """Return the same phenomenon with angles that all trials share; None if they do already, or no effect has them.

        Such an effect is a breath with a phase of its own in each trial. The angles are the circular means of all
        trials but references, which show none. If they must be `agreeing`, the result is None if a trial differs by
        more than two standard deviations of the phase of a trial, which the tolerance of the shared effect holds.
        """
        found = [entry for entry in self.entries if entry.excludes(each.effect) and not entry.effect.by_trial]
        if not each.effect.by_trial or not found:
            return None
        shown = [own for own, trial in zip(each.own, self.problem.trials, strict=True) if not trial.is_reference]
        turns = {name: np.exp(1j * np.array([own[name] for own in shown])) for name in each.effect.by_trial}
        if agreeing and any(np.abs(np.angle(own / own.mean())).max() > 2 * CLOCK_RAD for own in turns.values()):
            return None
        angles = {name: float(np.angle(own.mean())) for name, own in turns.items()}
        return FittedEffect(found[0].effect, {**each.values, **angles}, each.bounds)

    def at_given(self, parent: Hypothesis) -> tuple[CalibratedTrial, ...]:
        """Return the trials linearised at the given base, beside the effects of a set.

        The columns that all trials share are the same beside all effects whose outputs are added.
        """
        found = linearised_trials(self.problem, parent.effects, self._given(parent.trials), again=True)
        if not all(is_added(effect) for effect in parent.effects):
            return found
        return tuple(replace(trial, shared=own.shared) for trial, own in zip(found, self._trials_at_given, strict=True))

    def _given(self, trials: Sequence[CalibratedTrial]) -> list[CalibratedTrial]:
        given = self.problem.calibration.given
        lag_s = channel_description(given.channel).usual_lag_s
        return [replace(trial, lag_s=lag_s, model=given, laws=None) for trial in trials]


def _by_first(entry: CatalogueEntry, scores: Array) -> list[int]:
    """Return the best grid points of the best values of the first parameter, such as the frequency."""
    best: dict[float, int] = {}
    for index in np.argsort(-scores).tolist():
        best.setdefault(next(iter(entry.grid[index].values())), index)
    return list(best.values())[1:STARTS]


def _columns_of(
    problem: Problem,
    library: Library,
    entries: tuple[CatalogueEntry, ...],
    trials: Sequence[CalibratedTrial],
    near: Model,
) -> tuple[Columns, Array]:
    """Return the columns of all effects beside a base near the model `near`, and their RMS before whitening."""
    count = max((each.last for each in entries), default=0)
    raw = [
        np.zeros((len(trial.output), count)) if trial.is_reference else
        library.sensitivities(near, trial.motion, entries) for trial in trials
    ]  # fmt: skip
    powers = np.sqrt(sum(np.einsum("nm,nm->m", each, each) for each in raw) / sum(map(len, raw)))
    whitened = [trial.whiten(each) for trial, each in zip(trials, raw, strict=True)]
    for entry in entries:
        if entry.effect.is_lag:  # the effect lengthens the calibrated lag; a second lag in series would differ
            for trial, each in zip(trials, whitened, strict=True):
                each[:, entry.first] = 0.0 if trial.is_reference else trial.lag_sensitivity
    blocks = [problem.block(trial, number) for number, trial in enumerate(trials)]
    return Columns(blocks, [problem.decorrelated(number, each) for number, each in enumerate(whitened)]), powers
