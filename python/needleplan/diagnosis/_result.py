"""The result of a diagnosis: answer, missing effects with intervals, corrected model, and where the gap is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from needleplan.artifacts import ShortRepr, digest
from needleplan.diagnosis._base_law import LAW_COUNTS, law_curves
from needleplan.diagnosis._blocks import TISSUE_KINDS
from needleplan.diagnosis._budget import (
    FindingKind,
    GapBudget,
    GapFinding,
    OtherLaw,
    OtherParameter,
    findings_of,
    gap_budget,
)
from needleplan.diagnosis._contradiction import closed_share
from needleplan.diagnosis._decision import DiagnosisDecision, Verdict
from needleplan.diagnosis._gap import Curves, GapPart, curves_along, gap_parts
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._posterior import Posterior
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis._tangents import Coordinate, unblended
from needleplan.diagnosis.calibration import Calibration, mean_model, noise_sds
from needleplan.diagnosis.catalogue import DetectionLimit, FittedEffect
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.data import CheckedData, measured_output
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel, Estimate, Model, Scale, simulate
from needleplan.models.effects import SIZE, with_effect
from needleplan.models.friction import ShaftAndTip
from needleplan.models.trials import mean_estimate
from needleplan.signals import Record

__all__ = ["Diagnosis", "detection_limits_of", "most_probable"]

# Two-sided 95 % quantile of the standard normal distribution.
_95 = 1.959964
# 20 % quantile of the standard normal distribution: the power of 0.8.
_QUANTILE_20 = -0.8416
# Share of the noise energy of an output of one noise RMS below which the base model absorbs an effect.
_ABSORBED = 1e-3


@dataclass(frozen=True)
class Diagnosis(ShortRepr):
    """Result of a diagnosis: where the gap is, which effects are missing, their amplitudes, and the corrected model.

    Attributes
    ----------
    decision
        The answer with its probability and reason (`because`), the sets among which the data do not decide (`tied`),
        and the axis of a gap that no effect explains.
    posterior
        Probabilities of all hypotheses, and the fitted sets.
    calibration
        The base model calibrated to each trial without effects, and the sensor noise.
    checked
        The recordings by role, averaged to the rate of the settings, and the data that are missing (`lacks`).
    settings
        Constants of model, priors and answers.
    recordings
        The recordings as given.
    remarks
        Remarks on recordings, base model, noise and heterogeneity.
    intervals
        Parameters of the given model's file with their intervals; empty if the model was given without its file.
    given
        The model as given, with its effects.
    laws
        Laws of the base that differ from the model's beside the most probable set.
    """

    decision: DiagnosisDecision
    posterior: Posterior
    calibration: Calibration
    checked: CheckedData
    settings: Settings
    recordings: tuple[Record, ...] = ()
    remarks: tuple[str, ...] = ()
    intervals: Mapping[str, Estimate] = field(default_factory=dict)
    given: Model = field(kw_only=True)
    laws: tuple[OtherLaw, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Answer of the diagnosis, as `decision.verdict`."""
        return self.decision.verdict

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects that are missing with the probability of a name, each once."""
        return self.decision.names

    @property
    def lacks_data(self) -> bool:
        """Whether effects fit best, but are not named because data are missing (`checked.lacks`)."""
        return self.verdict is Verdict.AMBIGUOUS and bool(self.checked.lacks and self.named.names)

    @property
    def named(self) -> Hypothesis:
        """The most probable set of effects, fitted; the empty set if nothing is missing."""
        return most_probable(self.posterior)

    @property
    def nothing(self) -> Hypothesis:
        """The hypothesis that no effect is missing, fitted."""
        return self.posterior.hypotheses[()]

    @property
    def heterogeneity(self) -> float:
        """Most probable standard deviation of the tissue's heterogeneity, as a share."""
        return float(self.named.problem.sds[self.named.best])

    @property
    def tissue(self) -> dict[str, float]:
        """Probabilities that the tissue is homogeneous, rough or smooth (the kinds of the model), which sum to 1."""
        problem = self.named.problem
        each = np.exp(self.named.by_heterogeneity - self.named.log_evidence)
        varies, smooth = problem.sds > 0, TISSUE_KINDS[problem.levels] == 1
        parts = {"homogeneous": ~varies, "rough": varies & ~smooth, "smooth": varies & smooth}
        return {kind: float(each[where].sum()) for kind, where in parts.items()}

    @property
    def likely(self) -> tuple[FittedEffect, ...]:
        """Effects of the most probable set, named or not, with estimates, RMS and share of the gap."""
        return tuple(each for each in self._fitted if not each.given)

    @cached_property
    def _fitted(self) -> tuple[FittedEffect, ...]:
        """All effects of the most probable set, those of the given model included, as `likely`."""
        best, noise = self.named, self.calibration.noise.rms
        scores = [_score(best, index) ** 2 for index in range(len(best.effects))]
        return tuple(
            replace(each, estimates=estimates, rms=noise * multiple, share=score / max(sum(scores), 1e-300))
            for each, estimates, multiple, score in zip(
                best.effects, _estimates(best), best.multiples, scores, strict=True
            )
        )

    @property
    def effects(self) -> tuple[FittedEffect, ...]:
        """The named effects with estimates, 95 % intervals, RMS and share of the gap."""
        return tuple(each for each in self.likely if each.name in self.names)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of base model, recordings and answer."""
        parents = "".join(
            sorted(recording.digest or digest(recording["time_s"].tobytes()) for recording in self.recordings)
        )
        curves = getattr(getattr(self.given, "base", self.given), "curves", None) or ""
        return digest(f"{self.given!r}{curves!r} {parents} {self.decision!r} {[each.added for each in self.likely]!r}")

    @cached_property
    def base(self) -> Model:
        """The given model with its mean calibrated parameters, fitted together with the most probable set.

        If the answer is CHANGED, the model has the laws that differ as curves, if it predicts the held-out trials
        better with them.
        """
        trials = self.named.trials[: len(self.calibration.training)]
        model = mean_model([unblended(trial.model) for trial in trials], self.calibration.free)
        given = [each.added for each in self._fitted if each.given]
        plain, changed = (with_effect(each, given) if given else each for each in (model, self._with_laws(model)))
        return changed if changed != plain and self.held_out_rms(changed) < self.held_out_rms(plain) else plain

    def _with_laws(self, model: Model) -> Model:
        """Return a base model with the laws that differ as curves; the model itself if none differs."""
        best, problem = self.named, self.named.problem
        differ = {finding.name for finding in self.findings if finding.kind is FindingKind.LAW}
        if self.verdict is not Verdict.CHANGED or not isinstance(model, ShaftAndTip) or not differ & {*LAW_COUNTS}:
            return model
        # The laws were estimated together.
        coefficients = {law: best.linear.mean[best.best, best.groups[law]] for law in LAW_COUNTS}
        curves = law_curves(model, coefficients, problem.reach, problem.largest_n, problem.settings)
        return replace(model, curves=curves.after(model.curves))

    @property
    def model(self) -> Model:
        """The calibrated base model, with `effects` added if the answer is NAMED; the given one if `keeps_given`."""
        if self.verdict is Verdict.NAMED:
            return self.merged()
        return self.given if self.keeps_given else self.base

    @cached_property
    def keeps_given(self) -> bool:
        """Whether the given model predicts better than the calibrated one, which a gap without a name may distort.

        They predict the held-out trials or, without any, the training trials.
        """
        if self.verdict in (Verdict.NAMED, Verdict.NONE, Verdict.UNDERPOWERED):
            return False
        return self.held_out_rms(self.given) < self.held_out_rms(self.base)

    def held_out_rms(self, model: Model) -> float:
        """Return the RMS of measured minus modelled output in the held-out trials or, without any, the training trials.

        Parameters
        ----------
        model
            A model of the channel of the diagnosis, which is not fitted.

        Returns
        -------
        float
            RMS over all samples and axes, in the unit of the channel.
        """
        gaps = [
            measured_output(each, model.channel) - simulate(model, each.motion()).output.ravel()
            for each in self.checked.held_out or self.checked.training
        ]
        return float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))

    def merged(self, *, anyway: bool = False) -> Model:
        """Return the base model with the effects that were found.

        Parameters
        ----------
        anyway
            If the answer is not NAMED, add the named effects, or, without any, those of the most probable set.

        Returns
        -------
        Model
            The base model with its effects, or the base model alone if none was found.

        Raises
        ------
        ModelError
            If the answer is not NAMED and `anyway` is false.
        """
        if self.verdict is Verdict.CHANGED:
            return self.model
        if self.verdict is not Verdict.NAMED and not anyway:
            rule = "only named effects are added to a model; use anyway=True (--merge-anyway) to add others"
            raise ModelError(Mistake("verdict", self.verdict, rule), "diagnosis")
        added = self.effects or self.likely
        return with_effect(self.base, [replace(each.added, found_by=self.digest) for each in added])

    def estimates(self) -> dict[str, Estimate]:
        """Return the free parameters of the base model: the mean over the training trials and its 95 % interval.

        The interval follows from the scatter of the trials, or from the noise if this gives a longer one.

        Returns
        -------
        dict of str to Estimate
            One estimate for each free parameter; with one training trial, its interval is the whole range.
        """
        what, trials = self.calibration.given.parameters(), self.named.trials[: len(self.calibration.training)]
        free = self.calibration.free
        sds = np.array([noise_sds(trial, free) for trial in trials])
        found = {}
        for number, name in enumerate(free):
            values = [getattr(trial.model, name) for trial in trials]
            # Trials of one noise have equal weights, so that the mean is that of the calibrated model.
            noise = float(np.sqrt(np.mean(sds[:, number] ** 2)))
            within = [noise * what[name].slope(value) for value in values]
            found[name] = mean_estimate(what[name], values, within if noise < 1 else None)
        return found

    @cached_property
    def budget(self) -> GapBudget:
        """What closes the gap of the given model: parameters, effects, laws; by trial and by role."""
        return gap_budget(self.given, self.calibration, self.named if self.shows_effects else self.nothing)

    @property
    def shows_effects(self) -> bool:
        """Whether the most probable set is named, or only missing data prevent a name."""
        return bool(self.names) or self.lacks_data

    @cached_property
    def parameters(self) -> tuple[OtherParameter, ...]:
        """The free parameters of the base in the data, beside their given values."""
        given, trials = self.calibration.given, len(self.calibration.training)
        return tuple(
            OtherParameter.of(name, each, float(getattr(given, name)), self.intervals.get(name), trials)
            for name, each in self.estimates().items()
        )

    @cached_property
    def findings(self) -> tuple[GapFinding, ...]:
        """Everything that closes a part of the gap: effects, or a family of them, then parameters and laws."""
        effects = {effect.name: (effect.effect.meaning, self.marginals[effect.name]) for effect in self.effects}
        return tuple(findings_of(self.decision, self.budget, self.parameters, self.laws, effects))

    @cached_property
    def marginals(self) -> Mapping[str, float]:
        """Probability that each effect is missing, whatever else is; the most probable first."""
        found: dict[str, float] = {}
        for value, names, _ in self.posterior.ranked:
            for name in set(names):
                found[name] = min(found.get(name, 0.0) + value, 1.0)
        return dict(sorted(found.items(), key=lambda each: -each[1]))

    @cached_property
    def shrink(self) -> float:
        """Share of the held-out residual energy above the noise that the named effects remove; at most 1.

        `closed_share` defines it. The share is NaN if no effect is named, no trial is held out, or the residual without
        effects is not above the noise.
        """
        trials = len(self.calibration.training), len(self.calibration.held_out)
        return closed_share(self.named, self.nothing, *trials)

    @cached_property
    def detection_limits(self) -> tuple[DetectionLimit, ...]:
        """For each effect, the amplitude that would have been named with a probability of 0.8."""
        return tuple(detection_limits_of(self.posterior))

    @cached_property
    def where(self) -> tuple[GapPart, ...]:
        """Parts of depth, speed, time and motion, and trials, with their shares of the gap, the largest first."""
        return gap_parts(self.nothing, self.named)

    @cached_property
    def course(self) -> Curves | None:
        """The output that no effect explains, along `decision.axis`; None without an axis, or for the tip's path."""
        axis = self.decision.axis
        if axis is None or self.given.channel is not Channel.FORCE:
            return None
        return curves_along(axis, self.named)


def most_probable(posterior: Posterior) -> Hypothesis:
    """Return the most probable set, repetitions of an effect counted as one; the best repetitions of this set."""
    sets: dict[tuple[str, ...], float] = {}
    best: dict[tuple[str, ...], tuple[str, ...]] = {}
    for value, names, _ in posterior.ranked:
        kinds = tuple(dict.fromkeys(names))
        sets[kinds] = sets.get(kinds, 0.0) + value
        if names in posterior.hypotheses:
            best.setdefault(kinds, names)
    return posterior.hypotheses[best[max(best, key=lambda kinds: sets[kinds])]]


def _score(hypothesis: Hypothesis, index: int) -> float:
    """Return the amplitude of an effect in standard deviations."""
    row = hypothesis.coordinates.index(Coordinate(index, SIZE))
    each = hypothesis.effects[index]
    here = each.effect.parameters[SIZE].coordinate(each.values[SIZE])
    return float(here / math.sqrt(hypothesis.linear.inverse[hypothesis.best, row, row]))


def _estimates(hypothesis: Hypothesis) -> list[dict[str, Estimate]]:
    """Return the parameters of each effect with 95 % intervals, averaged over the heterogeneity.

    An amplitude is known no better than its law; a delay no better than the usual lag, which may be of another kind.
    """
    weights = np.exp(hypothesis.by_heterogeneity - hypothesis.log_evidence)
    scale = hypothesis.problem.noise_scale
    found: list[dict[str, Estimate]] = [{} for _ in hypothesis.effects]
    for row, (index, name, trial) in enumerate(hypothesis.coordinates):
        if trial:  # the estimate of a parameter of which every trial has its own is that of the first trial
            continue
        each = hypothesis.effects[index]
        what = each.effect.parameters[name]
        means = hypothesis.linear.mean[:, row]
        mean = float(weights @ means)
        own = hypothesis.linear.inverse[:, row, row] * scale.variance(hypothesis.linear.energy)
        variance = float(weights @ (own + (means - mean) ** 2))
        if name == SIZE:
            variance += hypothesis.law_variance(index, hypothesis.best)
            if each.effect.is_lag:
                lag_s = channel_description(hypothesis.problem.calibration.given.channel).usual_lag_s
                variance += (lag_s / what.typical) ** 2
        sd, value = math.sqrt(max(variance, 0.0)), float(each.values[name])
        if what.scale is Scale.LOG:
            low, high = value * math.exp(-_95 * sd), value * math.exp(min(_95 * sd, 50.0))
        else:
            low, high = value - _95 * sd * what.typical, value + _95 * sd * what.typical
        ends = max(low, what.lower), min(high, what.upper)
        found[index][name] = Estimate(value, sd * what.slope(value), *ends, what.unit, sd < 1)
    return found


def detection_limits_of(posterior: Posterior) -> Iterator[DetectionLimit]:
    """Yield the detection limit of each effect: the amplitude that would have been named with a probability of 0.8."""
    settings, noise = posterior.problem.settings, posterior.problem.calibration.noise.rms
    # A gain is normal with mean n/2 and variance n for the noncentrality n; it must exceed the prior odds of a name.
    needed = math.log(len(posterior.entries) * settings.named / (1 - settings.named) / settings.any_effect) + 3.0
    least = (-_QUANTILE_20 + math.sqrt(_QUANTILE_20**2 + 2 * needed)) ** 2
    for entry in posterior.entries:
        part = slice(entry.first, entry.last)
        curvature, units = posterior.screened.curvature[0, part], posterior.units[part]
        multiples = np.sqrt(least / np.maximum(curvature * units**2, 1e-12))
        middle = int(np.argsort(multiples, kind="stable")[len(multiples) // 2])
        multiple = float(multiples[middle])
        yield DetectionLimit(
            entry.effect.name, multiple * float(units[middle]), entry.effect.parameters[SIZE].unit, multiple * noise,
            multiple, bool(curvature[middle] * units[middle] ** 2 > _ABSORBED), dict(entry.grid[middle]),
        )  # fmt: skip
