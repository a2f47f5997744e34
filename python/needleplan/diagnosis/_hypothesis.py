"""A set of effects at fitted values, and the evidence of the data around this point."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np
from scipy.special import log_ndtr, logsumexp

from needleplan.diagnosis._base_law import LAW_COUNTS, Law, base_laws
from needleplan.diagnosis._blocks import Indices
from needleplan.diagnosis._constants import (
    AMPLITUDE_SCALES,
    FAR_LEVEL,
    FORMULA_ERRORS,
    LAW_SCALES,
    NEGLIGIBLE,
    SCALE_ROUNDS,
    TOLERANCE_SCALES,
)
from needleplan.diagnosis._effect_law import effect_laws, law_tolerance, rms
from needleplan.diagnosis._evidence import LinearModel
from needleplan.diagnosis._factors import eliminated, swept
from needleplan.diagnosis._problem import Problem, formula_errors, other_length, shared_base
from needleplan.diagnosis._reversal import blended_by, reversal_laws
from needleplan.diagnosis._tangents import Coordinate, coordinates_of, in_trial, linearised, prior_width
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models.effects import SIZE
from needleplan.signals import Array

__all__ = ["Extra", "Hypothesis", "log_tail", "nuisances"]


@dataclass(frozen=True)
class Extra:
    """A nonparametric component beside the effects: its columns and its approximate output, one array per trial."""

    name: str
    columns: tuple[Array, ...]
    outputs: tuple[Array, ...]
    scale: float
    """Prior standard deviation of the coefficients."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects at fitted values, the trials calibrated beside them, and the linear model around this point."""

    problem: Problem
    effects: tuple[FittedEffect, ...]
    trials: tuple[CalibratedTrial, ...]
    linear: LinearModel
    coordinates: tuple[Coordinate, ...]
    """Parameter of each of the first columns of the linear model."""

    multiples: tuple[float, ...]
    """RMS of each effect in all trials, in units of the noise RMS."""

    units: tuple[float, ...]
    """Change of each amplitude's fit coordinate whose output has the RMS of the noise."""

    blend: Array = field(default_factory=lambda: np.zeros(0))
    """Coefficients of the law of reversal around which the model is linear, shape (modes,)."""

    first_blend: int = 0
    """Index of the first column of the law of reversal. Its coefficients are full values, not changes from `blend`."""

    outputs: tuple[tuple[Array, ...], ...] = ()
    """Output of each effect by trial."""

    groups: Mapping[Law, Indices] = field(default_factory=dict)
    """Columns of the linear model of the tolerance of each law."""

    scales: Mapping[Law, float] = field(default_factory=dict)
    """Scale of each of these tolerances."""

    extra: Extra | None = None
    """Nonparametric component beside the effects, if there is one."""

    cosines: tuple[Indices, ...] = ()
    """Columns of the linear model of the law of each effect along depth, time and speed; empty if it has none."""

    @classmethod
    def at(
        cls,
        problem: Problem,
        effects: tuple[FittedEffect, ...],
        trials: tuple[CalibratedTrial, ...],
        extra: Extra | None = None,
        formula_error: float = FORMULA_ERRORS[-1],
        scales: Mapping[Law, float] | None = None,
    ) -> Hypothesis:
        """Linearise the model around effects and trials; tolerances without a given scale have the scale 1."""
        coordinates = coordinates_of(effects, len(trials))
        beside = [in_trial(effects, trial, number) for number, trial in enumerate(trials)]
        trials = tuple(
            trial if trial.shared is not None else replace(trial, shared=nuisances(problem, trial, n, beside[n]))
            for n, trial in enumerate(trials)
        )
        shared = [trial.shared for trial in trials if trial.shared is not None]
        blend = blended_by(trials[0].model)
        first = trials[0].whitened.base.shape[1]
        blocks = [
            problem.block(trial, n, own[:, first : first + len(blend)] @ blend)
            for n, (trial, own) in enumerate(zip(trials, shared, strict=True))
        ]
        width = shared[0].shape[1]
        counts = {Law.REVERSAL: width - first - sum(LAW_COUNTS.values()), **LAW_COUNTS} if width > first else {}
        ends = np.cumsum([first, *counts.values()])
        groups = {law: np.arange(*each) for law, each in zip(counts, pairwise(ends), strict=True)}
        if groups:  # the last of the modes is the memory, first of shaft and tip, then of the tip alone
            groups[Law.MEMORY] = first + len(blend) * np.array([1, 2]) - 1
            groups[Law.REVERSAL] = np.setdiff1d(groups[Law.REVERSAL], groups[Law.MEMORY])
        scales = {law: (scales or {}).get(law, 1.0) for law in (*groups, *([Law.EFFECTS] if effects else []))}
        ones = np.ones(width)
        for law, group in groups.items():
            unit = problem.settings.reversal_law if law in (Law.REVERSAL, Law.MEMORY) else 1.0
            ones[group] = (unit * scales[law]) ** -2
        if extra is not None:
            free = law_tolerance(extra.outputs, trials, problem.settings)
            own = [np.column_stack(each) for each in zip(extra.columns, free, strict=True)]
            shared = [
                np.hstack([shared[number], problem.whiten(trial, number, own[number])])
                for number, trial in enumerate(trials)
            ]
            prior = np.full(extra.columns[0].shape[1], extra.scale**-2)
            ones = np.concatenate([ones, prior, np.ones(free[0].shape[1])])
        if not effects:
            linear = LinearModel(blocks, shared, ones, formula_error)
            return cls(problem, (), trials, linear, (), (), (), blend, first, (), groups, scales, extra)
        local = [linearised(effects, coordinates, trial, n) for n, trial in enumerate(trials)]
        noise = problem.calibration.noise.rms
        multiples = tuple(rms([outputs[index] for outputs, _ in local]) / noise for index in range(len(effects)))
        sizes = [coordinates.index(Coordinate(index, SIZE)) for index in range(len(effects))]
        units = tuple(noise / max(rms([tangents[row] for _, tangents in local]), 1e-300) for row in sizes)
        laws, cosines = effect_laws(effects, trials, problem.settings, coordinates, local)
        bases: list[Array] = [
            np.hstack([problem.whiten(trial, n, np.column_stack([*local[n][1], laws[n]])), shared[n]])
            for n, trial in enumerate(trials)
        ]
        precision = [_prior_precision(effects[index], name, units[index]) for index, name, _ in coordinates]
        before = bases[0].shape[1] - len(ones)
        precision += [scales[Law.EFFECTS] ** -2] * (before - len(precision)) + ones.tolist()
        groups = {law: before + group for law, group in groups.items()}
        groups[Law.EFFECTS] = np.arange(len(coordinates), before)
        outputs = tuple(tuple(own) for own, _ in local)
        errors = formula_errors(problem, trials, outputs)
        blocks = [replace(block, errors=each) for block, each in zip(blocks, errors, strict=True)]
        linear = LinearModel(blocks, bases, np.array(precision), formula_error)
        return cls(
            problem, effects, trials, linear, coordinates, multiples, units, blend, before + first, outputs,
            groups, scales, extra, tuple(np.arange(each.start, each.stop) + len(coordinates) for each in cosines),
        )  # fmt: skip

    def law_variance(self, index: int, h: int) -> float:
        """Return the mean squared deviation of an effect's law, in squared units of its amplitude's fit coordinate.

        A law that deviates by a share of the output on average has an amplitude that is uncertain by this share.
        """
        which, row = self.cosines[index], self.coordinates.index(Coordinate(index, SIZE))
        noise = self.problem.noise_scale.variance(self.linear.energy)[h]
        second = self.linear.inverse[h][np.ix_(which, which)] * noise + np.outer(*2 * [self.linear.mean[h, which]])
        energy = sum(float(each[:, row] @ each[:, row]) for each in self.linear.basis)
        return sum(float(np.sum((each[:, which].T @ each[:, which]) * second)) for each in self.linear.basis) / energy

    def again(self, effects: tuple[FittedEffect, ...], trials: tuple[CalibratedTrial, ...]) -> Hypothesis:
        """Return the hypothesis linearised around other values of the same effects and of the base."""
        return Hypothesis.at(self.problem, effects, trials, self.extra, self.formula_error, self.scales)

    def with_levels(self, problem: Problem) -> Hypothesis:
        """Return the hypothesis with the heterogeneities that a problem sums over; the rest of the problem is equal."""
        if problem.levels is self.problem.levels:
            return self
        return replace(self, problem=problem, linear=self.linear.with_levels(problem.levels))

    @property
    def beside_model(self) -> Indices:
        """Columns of the laws of the base that are no part of its model: reversal of the tip alone, then all others."""
        modes = len(self.blend)
        tip = self.first_blend + modes + np.arange(modes + 1)
        return np.concatenate([tip, *(self.groups[law] for law in LAW_COUNTS)])

    @property
    def formula_error(self) -> float:
        """Standard deviation of the errors of the formulas, as a share of the local change of the outputs."""
        return self.linear.share

    def with_scales(self, scales: Mapping[Law, float]) -> Hypothesis:
        """Return the hypothesis with other scales of its tolerances; those that it does not have are left out."""
        scales = {law: scales.get(law, own) for law, own in self.scales.items()}
        linear = self.linear.with_precision(self.precision_with(scales))
        return replace(self, linear=linear, scales=scales)

    def precision_with(self, scales: Mapping[Law, float]) -> Array:
        """Return the prior precision of all coefficients with other scales of the tolerances."""
        found = self.linear.precision.copy()
        for law, group in self.groups.items():
            found[group] *= (self.scales[law] / scales[law]) ** 2
        return found

    def with_best_scales(self) -> Hypothesis:
        """Return the hypothesis with the scale of each tolerance that has the largest evidence."""
        h, noise = self.best, self.problem.noise_scale
        scales = dict(self.scales)
        best = self.linear.evidence_with(self.linear.precision, h, noise)
        for _ in range(SCALE_ROUNDS):
            before = scales
            for law in self.scales:
                for scale in LAW_SCALES if law is Law.EFFECTS else TOLERANCE_SCALES:
                    if scale != scales[law]:
                        there = {**scales, law: scale}
                        evidence = self.linear.evidence_with(self.precision_with(there), h, noise)
                        if evidence > best:
                            best, scales = evidence, there
            if scales == before:
                break
        return self.with_scales(scales)

    def with_best_tolerances(self) -> Hypothesis:
        """Return the hypothesis with the largest evidence: first choose the error of the formulas, then the scales."""
        found = [self]
        if any(block.errors is not None and block.errors.size for block in self.linear.blocks):
            others = [share for share in FORMULA_ERRORS if share != self.formula_error]
            found += [replace(self, linear=self.linear.with_share(share)) for share in others]
        return max(found, key=lambda hypothesis: hypothesis.log_evidence).with_best_scales()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects that the given model lacks."""
        return tuple(effect.name for effect in self.effects if not effect.given)

    @cached_property
    def _marginal(self) -> tuple[Array, Array]:
        """Normal matrices of coordinates and residual, with priors, the others integrated out, and spread."""
        return self.linear.marginal(len(self.coordinates))

    @cached_property
    def _at_values(self) -> Array:
        """Log of prior times likelihood at each heterogeneity with the effects at their values, shape (t,)."""
        rest, spread = self._marginal
        likelihood = self.problem.noise_scale.log_likelihood(rest[:, -1, -1])
        return np.asarray(self.problem.log_prior_h + self.linear.logs - 0.5 * spread + likelihood)

    @property
    def best_here(self) -> int:
        """Index of the most probable heterogeneity with the effects at their values."""
        return int(self._at_values.argmax())

    @cached_property
    def near(self) -> Indices:
        """Indices of the heterogeneities that are not far from `best_here`: the others have no weight."""
        return np.flatnonzero(self._at_values > self._at_values.max() - FAR_LEVEL)

    @cached_property
    def by_heterogeneity(self) -> Array:
        """Log of prior times likelihood at each heterogeneity, effects integrated out, shape (t,).

        Amplitudes are integrated with each scale of their prior; other parameters have a flat density within its width.
        It is -inf where it is not `near`.
        """
        if not self.coordinates:
            return self._at_values
        near, names = self.near, [name for _, name, _ in self.coordinates]
        others = [row for row, name in enumerate(names) if name != SIZE]
        sizes = [row for row, name in enumerate(names) if name == SIZE]
        (normal, spread), order = self._marginal, np.array([*others, *sizes, -1])
        rest, more = eliminated(normal[near][:, order[:, None], order], len(others))
        rest[:, :-1, :-1] -= np.diag(self.linear.precision[sizes])
        logs = (self.problem.log_prior_h + self.linear.logs - 0.5 * spread)[near] - 0.5 * more
        for row in others:  # a flat density, whose width bounds that of the posterior
            index, name, _ = self.coordinates[row]
            logs = logs + 0.5 * math.log(2 * math.pi) - math.log(prior_width(self.effects[index], name))
        found: Array = np.full(len(self.problem.levels), -math.inf)
        found[near] = logs + self._amplitudes(rest)
        return found

    def _amplitudes(self, rest: Array) -> Array:
        """Return the log-likelihood with all amplitudes integrated out, shape (t,).

        `rest` has the normal matrices of amplitudes and residual at this point, without priors of the amplitudes, and
        with all other coefficients integrated out.
        """
        noise, count = self.problem.noise_scale, len(self.effects)
        sizes = [effect.effect.parameters[SIZE] for effect in self.effects]
        here = np.array([what.coordinate(each.values[SIZE]) for what, each in zip(sizes, self.effects, strict=True)])
        signs = np.array([1 if what.lower >= 0 else -1 if what.upper <= 0 else 0 for what in sizes])
        # all products of the scales of the priors, (effects, scales, 1), along the last axes but one
        scales = np.array(list(product(AMPLITUDE_SCALES, repeat=count))).T * np.array(self.units)[:, None]
        prior = (1 / scales**2)[:, :, None]
        normal = np.repeat(rest.transpose(1, 2, 0)[:, :, None], scales.shape[1], axis=2)
        normal[range(count), range(count)] += prior
        normal[:-1, -1] -= here[:, None, None] * prior
        normal[-1, :-1] -= here[:, None, None] * prior
        normal[-1, -1] += np.einsum("e,est->st", here**2, prior)
        found, spread = swept(normal, count)
        least = found[-1, -1]
        variances = noise.variance(least) * np.maximum(found[range(count), range(count)], 1e-300)
        ratios = (here[:, None, None] + found[:-1, -1]) / np.sqrt(variances)
        tails = log_tail(signs[:, None, None], ratios).sum(axis=0)
        logs = noise.log_likelihood(least) - 0.5 * (spread - np.log(prior).sum(axis=0)) + tails
        return np.asarray(logsumexp(logs, axis=0) - count * math.log(len(AMPLITUDE_SCALES)))

    @cached_property
    def log_evidence(self) -> float:
        """Log evidence, heterogeneity summed over."""
        return float(logsumexp(self.by_heterogeneity))

    @cached_property
    def levels(self) -> Indices:
        """Indices of the heterogeneities that the data permit."""
        return np.flatnonzero(self.by_heterogeneity > self.by_heterogeneity.max() - NEGLIGIBLE)

    @cached_property
    def noise_variance(self) -> float:
        """Most probable variance of the noise at the best heterogeneity, in units of its estimate."""
        return float(self.problem.noise_scale.variance(self.linear.energy)[self.best])

    @property
    def best(self) -> int:
        """Index of the most probable heterogeneity."""
        return int(self.by_heterogeneity.argmax())

    @cached_property
    def height(self) -> float:
        """Log posterior density at the present parameter values and best heterogeneity; a fit maximises this number."""
        energy, volume = self._at_point
        here = self.problem.noise_scale.log_likelihood(energy) + volume
        # The flat prior of a place and the prior of an amplitude replace the normal ones of the linear model.
        return float((here + self.problem.log_prior_h[self.near]).max()) + sum(
            self._log_density(index, name) for index, name, _ in self.coordinates
        )

    @cached_property
    def _at_point(self) -> tuple[Array, Array]:
        """Squared residual and log volume at the present parameter values, for each heterogeneity of `near`."""
        count, blend = len(self.coordinates), np.arange(len(self.blend)) + self.first_blend
        fixed = np.concatenate([np.arange(count), blend]).astype(np.intp)
        return self.linear.at_point(fixed, np.concatenate([np.zeros(count), self.blend]), self.near)

    @property
    def promise(self) -> float:
        """Rise of the log-likelihood by the best step of the linear model, at the heterogeneity `best_here`."""
        count, h = len(self.coordinates), self.best_here
        return self.rise_to(float(eliminated(self._marginal[0][h : h + 1], count)[0][0, 0, 0]))

    @property
    def hope(self) -> float:
        """Log evidence that a fit from the present parameter values would reach if the model were linear."""
        return self.log_evidence + self.promise

    def rise_to(self, energy: float) -> float:
        """Return the log-likelihood of a squared residual minus the present one, at the heterogeneity `best_here`."""
        here = self._at_point[0][np.searchsorted(self.near, self.best_here)]
        log = self.problem.noise_scale.log_likelihood
        return float(log(np.array(energy)) - log(here))

    def _log_density(self, index: int, name: str) -> float:
        """Return the log prior density of a coordinate at its present value."""
        effect = self.effects[index]
        if name == SIZE:
            amplitude = effect.effect.parameters[SIZE]
            signed = amplitude.lower >= 0 or amplitude.upper <= 0
            return _log_amplitude_density(self.multiples[index], signed=signed) - math.log(self.units[index])
        return -math.log(prior_width(effect, name))


def nuisances(problem: Problem, trial: CalibratedTrial, number: int, effects: Sequence[FittedEffect]) -> Array:
    """Return the whitened columns with coefficients that all trials share, without the effects, shape (n, columns).

    The columns are the deviations of the base parameters, and the tolerances of the laws of reversal, depth, force,
    speed and entry.
    """
    laws = base_laws(trial, effects, problem.reach, problem.largest_n, problem.settings)
    reversal = problem.whiten(trial, number, reversal_laws(trial, effects))
    return np.hstack([shared_base(trial), reversal, other_length(trial), problem.whiten(trial, number, laws)])


def _log_amplitude_density(multiple: float, *, signed: bool) -> float:
    """Return the log prior density of an amplitude in noise RMS; `signed` if only one sign is permitted."""
    by_scale = -0.5 * (multiple / AMPLITUDE_SCALES) ** 2 - np.log(AMPLITUDE_SCALES) - 0.5 * math.log(2 * math.pi)
    return float(logsumexp(by_scale)) - math.log(len(AMPLITUDE_SCALES)) + (math.log(2) if signed else 0.0)


def log_tail(sign: Array, ratio: Array) -> Array:
    """Return the log of twice the probability of the permitted sign; 0 where both signs are permitted."""
    return np.where(sign == 0, 0.0, math.log(2) + log_ndtr(np.where(sign == 0, 0.0, sign * ratio)))


def _prior_precision(effect: FittedEffect, name: str, unit: float) -> float:
    """Return the precision of a normal prior that is about as wide as the prior of a coordinate."""
    if name != SIZE:
        return 12 / prior_width(effect, name) ** 2
    return float((AMPLITUDE_SCALES[-1] * unit) ** -2)
