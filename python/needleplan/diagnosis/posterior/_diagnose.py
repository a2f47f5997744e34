"""The second edition of the diagnosis: `diagnose_posterior` and its result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from needleplan.artifacts import digest
from needleplan.diagnosis.calibration import (
    Calibration,
    calibrate,
    calibration_remarks,
    check_needle,
    mean_model,
)
from needleplan.diagnosis.catalogue import Library, require_base
from needleplan.diagnosis.data import CheckedData, SensorNoise, check_data, sensor_noise
from needleplan.diagnosis.likelihood import HETEROGENEITY_SDS, LARGEST_HETEROGENEITY
from needleplan.diagnosis.posterior._decision import PosteriorAnswer, PosteriorDecision, Ranked, decide
from needleplan.diagnosis.posterior._hypothesis import Hypothesis
from needleplan.diagnosis.posterior._problem import AXES, Problem
from needleplan.diagnosis.posterior._reversal import unblended
from needleplan.diagnosis.posterior._search import Posterior, search_tolerances
from needleplan.diagnosis.posterior._settings import Settings
from needleplan.models import Estimate, Model, Scale, mean_estimate
from needleplan.models.effects import SIZE, AddedEffect, effects_of, with_effect
from needleplan.signals import AveragedMotion, Motion, Record, averaged_motion

__all__ = [
    "AveragedRecord",
    "PosteriorDiagnosis",
    "averaged",
    "diagnose_posterior",
    "estimates_of",
    "held_out_shrink",
    "transfer_z",
]

# Two-sided 95 % quantile of the standard normal distribution.
_95 = 1.959964
# Degrees of freedom of a noise variance that was guessed from the scatter of the trials.
_UNKNOWN_NOISE = 1
# Share of the effects that must be visible for the answer NONE.
_VISIBLE_SHARE = 0.75


@dataclass(frozen=True)
class PosteriorDiagnosis:
    """Result of the second edition: decision, posterior, and what reports need of the most probable set."""

    decision: PosteriorDecision
    posterior: Posterior
    calibration: Calibration
    checked: CheckedData
    settings: Settings
    remarks: tuple[str, ...] = ()
    """Remarks on recordings, base model, noise and heterogeneity."""

    @property
    def named(self) -> Hypothesis:
        """The most probable set of effects, fitted; the empty set if nothing is missing."""
        return _most_probable(self.posterior)

    @cached_property
    def estimates(self) -> Mapping[str, Mapping[str, Estimate]]:
        """Parameters of the effects of `named` with 95 % intervals."""
        return estimates_of(self.named)

    @property
    def digest(self) -> str:
        """SHA-256 of base model, recordings and answer."""
        records = [each.record for each in self.named.trials]
        parents = "".join(sorted(each.digest or digest(each["time_s"].tobytes()) for each in records))
        return digest(f"{self.calibration.given!r} {parents} {self.decision!r} {self.estimates!r}")

    @property
    def model(self) -> Model:
        """The base model with its mean calibrated parameters, with the named effects added if the answer is NAMED."""
        trials = [unblended(trial.model) for trial in self.named.trials[: len(self.calibration.training)]]
        base = mean_model(trials, self.calibration.free)
        if self.decision.answer is not PosteriorAnswer.NAMED:
            return base
        return with_effect(base, [
            AddedEffect(each.name, each.values, self.estimates[each.name], self.digest, each.effect.version)
            for each in self.named.effects if each.name in self.decision.names
        ])  # fmt: skip

    def base_estimates(self) -> Mapping[str, Estimate]:
        """Return the free parameters of the base model: the mean over the training trials and its 95 % interval."""
        what, trials = self.calibration.given.parameters(), self.named.trials[: len(self.calibration.training)]
        return {
            name: mean_estimate(what[name], [getattr(trial.model, name) for trial in trials])
            for name in self.calibration.free
        }

    @cached_property
    def shrink(self) -> float:
        """Share of the held-out residual energy above the noise that effects fitted to the training trials remove."""
        return held_out_shrink(self.named, self.posterior.hypotheses[()], len(self.calibration.training))


def diagnose_posterior(
    model: Model, recordings: Sequence[Record], *, library: Library | None = None, settings: Settings | None = None
) -> PosteriorDiagnosis:
    """Return the posterior of missing effects, and the answer that follows from it.

    Parameters
    ----------
    model
        The base model, without effects.
    recordings
        Trials with the roles train, holdout and noise. All trials enter one likelihood.
    library
        Effects to look for; by default all effects of the model's channel.
    settings
        Constants of model, priors and answers.

    Returns
    -------
    PosteriorDiagnosis
        Decision, posterior, estimates.

    Raises
    ------
    DataError
        If the recordings are not usable.
    ModelError
        If the model has effects already, or no effects are known for its channel.
    """
    settings = settings or Settings()
    library = library or Library(effects_of(model.channel), model)
    require_base(model, library)
    used = [averaged(each, settings.rate_hz) for each in recordings]
    checked = check_needle(check_data(used, model.channel), model)
    calibration = calibrate(model, checked.training, checked.held_out, sensor_noise(model, checked))
    trials = (*calibration.training, *calibration.held_out)
    freedom = _noise_freedom(checked, calibration.noise)
    posterior = search_tolerances(Problem(calibration, trials, settings, freedom), library)
    axes = {each.name: each.axis for each in posterior.components.components}
    ranked = [Ranked(value, tuple(dict.fromkeys(names)), axes.get(which)) for value, names, which in posterior.ranked]
    best = _most_probable(posterior)
    decision = decide(
        ranked, settings, axes=AXES, powered=_powered(posterior), at_bound=_at_bound(best), transfer_z=transfer_z(best),
        transfers=len(best.effects) * len(best.trials), lacks=[str(each) for each in checked.lacks],
    )  # fmt: skip
    remarks = (*checked.remarks, *calibration_remarks(model, calibration), *_heterogeneity_remark(best))
    return PosteriorDiagnosis(decision, posterior, calibration, checked, settings, remarks)


def _noise_freedom(checked: CheckedData, noise: SensorNoise) -> float:
    """Return the number of samples that determined the noise variance, or next to none if no noise was recorded."""
    found = sum(len(each) - noise.order - 1 for each in checked.noise or checked.rest)
    return float(max(found, _UNKNOWN_NOISE))


def _heterogeneity_remark(hypothesis: Hypothesis) -> tuple[str, ...]:
    return (LARGEST_HETEROGENEITY,) if hypothesis.best == len(HETEROGENEITY_SDS) - 1 else ()


@dataclass(frozen=True)
class AveragedRecord(Record):
    """A recording whose samples are means; its motion keeps several instants where the speed changes."""

    averaged: AveragedMotion | None = None

    def motion(self) -> Motion:
        """Return the motion of the means."""
        return super().motion() if self.averaged is None else self.averaged


def averaged(record: Record, rate_hz: float) -> Record:
    """Return a recording averaged over blocks of equal length, such that its rate is at most `rate_hz`.

    Models are integrated over the sample intervals of the result, also if no samples are averaged.
    """
    interval = float(np.median(np.diff(record["time_s"])))
    block = max(math.ceil(1 / (interval * rate_hz) - 1e-6), 1) if interval > 0 else 1
    count = len(record) // block
    columns = {
        name: values[: count * block].reshape(count, block).mean(axis=1) for name, values in record.columns.items()
    }
    motion = averaged_motion(record.motion(), block) if "depth_mm" in record.columns and count > 1 else None
    return AveragedRecord(
        columns, record.trial, record.role, record.phase[: count * block : block], record.digest, record.notes, motion
    )


def _most_probable(posterior: Posterior) -> Hypothesis:
    """Return the most probable set, repetitions of an effect counted as one; the best repetitions of this set."""
    sets: dict[tuple[str, ...], float] = {}
    best: dict[tuple[str, ...], tuple[str, ...]] = {}
    for value, names, _ in posterior.ranked:
        kinds = tuple(dict.fromkeys(names))
        sets[kinds] = sets.get(kinds, 0.0) + value
        if names in posterior.hypotheses:
            best.setdefault(kinds, names)
    return posterior.hypotheses[best[max(best, key=lambda kinds: sets[kinds])]]


def _at_bound(hypothesis: Hypothesis) -> list[str]:
    """Return the effects whose amplitude equals a bound of its physical range other than 0."""
    found = []
    for each in hypothesis.effects:
        what, value = each.effect.parameters[SIZE], each.values[SIZE]
        if value and value in (what.lower, what.upper):
            found.append(each.name)
    return found


def _powered(posterior: Posterior) -> bool:
    """Return whether most effects of a relevant amplitude would have been named with the wanted power."""
    settings = posterior.problem.settings
    # A gain is normal with mean n/2 and variance n for the noncentrality n; it must exceed the prior odds of a name.
    needed = math.log(len(posterior.entries) * settings.named / (1 - settings.named) / settings.any_effect) + 3.0
    z = float(-_QUANTILE_20)
    least = (z + math.sqrt(z * z + 2 * needed)) ** 2
    curvature = posterior.screened.curvature[0]
    reached = (settings.relevant * posterior.units) ** 2 * curvature
    seen = [float(np.median(reached[each.first : each.last])) for each in posterior.entries]
    visible = [each for each in seen if each > 1e-3]
    return bool(visible) and float(np.mean([each >= least for each in visible])) >= _VISIBLE_SHARE


# 20 % quantile of the standard normal distribution: the power of 0.8.
_QUANTILE_20 = -0.8416


def estimates_of(hypothesis: Hypothesis) -> dict[str, dict[str, Estimate]]:
    """Return the parameters of each effect with 95 % intervals, averaged over the heterogeneity."""
    weights = np.exp(hypothesis.by_heterogeneity - hypothesis.log_evidence)
    scale = hypothesis.problem.noise_scale
    found: dict[str, dict[str, Estimate]] = {}
    for row, (index, name) in enumerate(hypothesis.coordinates):
        each = hypothesis.effects[index]
        what = each.effect.parameters[name]
        means = hypothesis.linear.mean[:, row]
        mean = float(weights @ means)
        own = hypothesis.linear.inverse[:, row, row] * scale.variance(hypothesis.linear.energy)
        variance = float(weights @ (own + (means - mean) ** 2))
        sd, value = math.sqrt(max(variance, 0.0)), each.values[name]
        if what.scale is Scale.LOG:
            low, high = value * math.exp(-_95 * sd), value * math.exp(min(_95 * sd, 50.0))
        else:
            low, high = value - _95 * sd * what.typical, value + _95 * sd * what.typical
        ends = max(low, what.lower), min(high, what.upper)
        found.setdefault(each.name, {})[name] = Estimate(value, sd * what.slope(value), *ends, what.unit, sd < 1)
    return found


def held_out_shrink(hypothesis: Hypothesis, empty: Hypothesis, training: int) -> float:
    """Return the share of held-out residual energy above the noise that the effects of the training trials remove."""
    h, linear = hypothesis.best, hypothesis.linear
    parts = linear.parts[:, h]
    if not hypothesis.effects or training >= len(parts):
        return math.nan
    f = len(linear.precision)
    fitted = np.linalg.solve(
        parts[:training, :f, :f].sum(axis=0) + np.diag(linear.precision), parts[:training, :f, f].sum(axis=0)
    )
    held = parts[training:].sum(axis=0)
    after = held[f, f] - 2 * fitted @ held[:f, f] + fitted @ held[:f, :f] @ fitted
    rest = empty.linear.parts[training:, h].sum(axis=0)
    before = rest[-1, -1]
    floor = sum(len(block.residual) - block.base.shape[1] for block in linear.blocks[training:])
    return float(min((before - after) / (before - floor), 1.0)) if before > floor else math.nan


def transfer_z(hypothesis: Hypothesis) -> float:
    """Return the largest two-sided deviation of one trial from the others along an effect, in standard deviations."""
    h, linear = hypothesis.best, hypothesis.linear
    parts, f = linear.parts[:, h], len(linear.precision)
    worst = 0.0
    whole = parts.sum(axis=0)
    for part in parts:
        inner = np.linalg.inv(whole[:f, :f] - part[:f, :f] + np.diag(linear.precision))
        others = inner @ (whole[:f, f] - part[:f, f])
        for row, (_, name) in enumerate(hypothesis.coordinates):
            if name == SIZE:
                own = part[row, :f]
                variance = float(part[row, row] + own @ inner @ own)
                if variance > 0:
                    score = float(part[row, f] - own @ others) / math.sqrt(variance * hypothesis.noise_variance)
                    worst = score if abs(score) > abs(worst) else worst
    return worst
