"""Alternatives to the known effects: smooth functions, steps and waves; and the validation on held-out trials.

A known effect is named only if it explains the data better than every nonparametric alternative, each with the BIC
penalty of its degrees of freedom. If an alternative wins, the gap and its axis are known, but not its cause.

Alternatives are scored with the base model as calibrated without effects. In heterogeneous tissue this favours the
effects, because the base model is recalibrated for each of them. Two alternatives that resemble common effects are
therefore fitted like effects: the square of the pushing force, which resembles a nonlinear sensor or a buckling shaft,
and a step at the same time in all trials, which resembles a drift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from needleplan.diagnosis.calibration import CalibratedTrial, Calibration, calibrate_trial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import GapAxis, SmoothBasis, channel_description
from needleplan.diagnosis.data import with_measured
from needleplan.diagnosis.joint_fit import (
    HeldOutValidation,
    JointFit,
    effects_output,
    fit_jointly,
    model_with_effects,
    recalibrated_trials,
)
from needleplan.diagnosis.likelihood import Gates, JointLikelihood, WhitenedTrial
from needleplan.models import Channel, Model, constant, ljung_box, parameter, simulate
from needleplan.models.effects import SIZE, Enters, Family, Memoryless, TermEffect
from needleplan.signals import Array, Motion

__all__ = [
    "EARLIEST_STEP_S",
    "AlternativeModel",
    "refit_alternatives",
    "score_alternatives",
    "smooth_bases",
    "smooth_sensitivities",
    "validate",
    "winning_alternative",
]

# Relative standard deviation of a noise variance that was estimated from one minute of noise.
_NOISE_VARIANCE_SD = 0.03
# Time (s) after the start of a trial within which no step in time is considered.
EARLIEST_STEP_S = 0.5
# The same limit as a share of the trial's duration; the larger of both applies.
_EARLIEST_STEP_SHARE = 0.05
# Least ratio of gains, or squared correlation, of an alternative and an effect for which it is refitted.
_LIKENESS = 0.5
# Half width (s) of the window in which the time of a step is refined to one sample.
_STEP_WINDOW_S = 0.2
# Heterogeneity standard deviations to try for homogeneous tissue: only 0.
_HOMOGENEOUS = np.zeros(1)


def validate(joint: JointFit, calibration: Calibration, before: JointFit | None = None) -> HeldOutValidation | None:
    """Compare a fit with an earlier fit on the held-out trials; return None if there are none.

    `before` is the earlier fit; the default is the base model alone.
    """
    if not calibration.held_out:
        return None
    held = before.effects if before else ()

    def with_held(model: Model) -> Model:
        return model_with_effects(held, model)

    earlier = recalibrated_trials(held, calibration, calibration.held_out) if held else calibration.held_out
    after = recalibrated_trials(joint.effects, calibration, earlier)
    best = joint.likelihood.best
    last = JointLikelihood([trial.whitened for trial in after])
    # The same heterogeneity with and without the effects: a base model that imitates an effect by a doubled cutting
    # force would double the heterogeneity too, and hide the missing effect.
    first = JointLikelihood([_with_heterogeneity_of(trial, like) for trial, like in zip(earlier, after, strict=True)])
    # Predicted gain: data simulated with the effects, explained by the model without them.
    channel = calibration.model.channel
    exact = [
        calibrate_trial(
            trial.model, with_measured(trial.record, channel, _where_measured(trial, each.predicted)),
            calibration.noise, calibration.free, whole=with_held, start_lag_s=trial.lag_s, about=calibration.given,
        )
        for trial, each in zip(earlier, after, strict=True)
    ]  # fmt: skip
    without = JointLikelihood([_with_heterogeneity_of(trial, like) for trial, like in zip(exact, after, strict=True)])
    predicted = max(without.energy(best) - _prior_energy(after), 0.0)
    achieved = first.energy(best) - last.energy(best)
    floor = float(sum(trial.whitened.samples - trial.whitened.base_sensitivities.shape[1] for trial in earlier))
    gap = first.energy(best) - floor
    return HeldOutValidation(
        predicted,
        achieved,
        2 * float(last.evidence.max() - JointLikelihood([trial.whitened for trial in earlier]).evidence.max()),
        _residual_rms(earlier),
        _residual_rms(after),
        calibration.noise.rms,
        min(achieved / gap, 1.0) if gap > 0 else float("nan"),
        gap / (2 * floor + (_NOISE_VARIANCE_SD * floor) ** 2) ** 0.5,
        _whiteness(earlier),
        _whiteness(after),
    )


def _with_heterogeneity_of(trial: CalibratedTrial, like: CalibratedTrial) -> WhitenedTrial:
    """Return the whitened trial with the heterogeneity modes of `like`, a trial of the same motion."""
    return replace(trial.whitened, modes=like.whitened.modes, variances=like.whitened.variances)


def _where_measured(trial: CalibratedTrial, values: Array) -> Array:
    """Return the values with NaN at samples without a measurement."""
    return np.where(np.isfinite(trial.measured), values, np.nan)


def _prior_energy(trials: Sequence[CalibratedTrial]) -> float:
    """Return the summed squares of the deviations of calibrated parameters from their priors, in prior sds."""
    return float(sum((trial.whitened.residual[int(trial.rows.sum()) :] ** 2).sum() for trial in trials))


def _residual_rms(trials: Sequence[CalibratedTrial]) -> float:
    left: Array = np.concatenate([trial.measured - trial.predicted for trial in trials])
    return float(np.sqrt(np.nanmean(left**2)))


def _whiteness(trials: Sequence[CalibratedTrial]) -> float:
    return ljung_box([trial.whitened.residual[: int(trial.rows.sum())] for trial in trials])[1]


@dataclass(frozen=True)
class AlternativeModel:
    """A nonparametric alternative with its gain (twice the log-likelihood), degrees of freedom and BIC gain."""

    name: str
    axis: GapAxis
    likelihood_gain: float
    degrees_of_freedom: int
    bic_gain: float
    time_s: float | None = None
    """Time (s) of a step that is common to all trials; None for other alternatives."""

    held_out_difference: float = 0.0
    """Held-out likelihood gain of the alternative minus that of the best effect; 0 if not validated."""

    @property
    def combined_gain(self) -> float:
        """BIC gain in training plus `held_out_difference`."""
        return self.bic_gain + self.held_out_difference


def winning_alternative(
    alternatives: Sequence[AlternativeModel], gates: Gates, *, likelihood_gain: float, bic_gain: float,
    degrees_of_freedom: int, lead: float, held_out_difference: float = 0.0,
) -> AlternativeModel | None:  # fmt: skip
    """Return the first alternative that wins against effects with the given gains; None if no alternative wins.

    An alternative with at most one degree of freedom more than the effects wins if its combined gain exceeds `bic_gain`
    - `lead`. For a validated alternative, `held_out_difference` (the held-out gain of all effects minus that of the
    best effect) is added to `bic_gain`. Any alternative wins if its BIC gain exceeds `bic_gain` + `gates.lead` and
    `likelihood_gain` is below the share `gates.share_of_alternative` of its likelihood gain.
    """
    for alternative in alternatives:
        simple = alternative.degrees_of_freedom <= degrees_of_freedom + 1
        if (
            simple
            and alternative.combined_gain
            > bic_gain + (held_out_difference if alternative.held_out_difference else 0.0) - lead
        ):
            return alternative
        if (
            alternative.bic_gain > bic_gain + gates.lead
            and likelihood_gain < gates.share_of_alternative * alternative.likelihood_gain
        ):
            return alternative
    return None


def smooth_sensitivities(trials: Sequence[CalibratedTrial]) -> list[Array]:
    """Return one whitened array per trial, shape (n, df), with all bases whose `beside_effects` is true."""
    found = [basis for basis in smooth_bases(trials).values() if basis.beside_effects]
    raw = [np.column_stack(each) for each in zip(*(basis.functions for basis in found), strict=True)]
    return [trial.whiten(each) for trial, each in zip(trials, raw, strict=True)]


def smooth_bases(trials: Sequence[CalibratedTrial]) -> Mapping[str, SmoothBasis]:
    """Return the smooth bases of the trials' channel by name."""
    return channel_description(trials[0].model.channel).smooth_bases(trials)


def score_alternatives(likelihood: JointLikelihood, trials: Sequence[CalibratedTrial]) -> tuple[AlternativeModel, ...]:
    """Return all alternatives with their gains over the model of `likelihood`, the largest BIC gain first.

    If this model contains effects, the bases that compete with the first effect only are left out.
    """
    bic_penalty = float(np.log(likelihood.samples))
    found = []
    with_effects = likelihood.blocks[0].shared.shape[1] > 0
    for name, basis in smooth_bases(trials).items():
        if with_effects and not basis.beside_effects:
            continue
        likelihood_gain = likelihood.basis_gains(
            [trial.whiten(each) for trial, each in zip(trials, basis.functions, strict=True)]
        )
        df = basis.functions[0].shape[1]
        found.append(AlternativeModel(name, basis.axis, likelihood_gain, df, likelihood_gain - df * bic_penalty))
    found += [_best_step(likelihood, trials, bic_penalty), _best_period(likelihood, trials, bic_penalty)]
    return tuple(sorted(found, key=lambda each: -each.bic_gain))


def _best_step(likelihood: JointLikelihood, trials: Sequence[CalibratedTrial], bic_penalty: float) -> AlternativeModel:
    """Return the step in time with the largest BIC gain, either common to all trials or in a single trial."""
    begins = [
        float(trial.motion.time_s[0] + max(EARLIEST_STEP_S, _EARLIEST_STEP_SHARE * np.ptp(trial.motion.time_s)))
        for trial in trials
    ]
    grids = [np.arange(begin, trial.motion.time_s[-1] - 0.4, 0.4) for begin, trial in zip(begins, trials, strict=True)]
    total = sum(map(len, grids))
    sensitivities, first = [], 0
    for trial, grid in zip(trials, grids, strict=True):
        each = np.zeros((len(trial.motion), total))
        each[:, first : first + len(grid)] = trial.motion.time_s[:, None] >= grid
        first += len(grid)
        sensitivities.append(trial.whiten(trial.on_each_axis(each)))
    gains, _ = likelihood.scores(sensitivities).gains()
    common_times = np.arange(max(begins), trials[0].motion.time_s[-1] - 0.4, 0.4)
    after = [np.asarray(trial.motion.time_s[:, None] >= common_times, float) for trial in trials]
    shared, _ = likelihood.scores(
        [trial.whiten(trial.on_each_axis(each)) for trial, each in zip(trials, after, strict=True)]
    ).gains()
    alone, all_ = float(gains.max()) - 3 * bic_penalty, float(shared.max()) - 2 * bic_penalty
    if all_ >= alone:
        time_s = float(common_times[shared.argmax() % len(common_times)])
        return AlternativeModel("step in time", GapAxis.TIME, float(shared.max()), 2, all_, time_s)
    return AlternativeModel("step in one trial", GapAxis.TIME, float(gains.max()), 3, alone)


def _best_period(
    likelihood: JointLikelihood, trials: Sequence[CalibratedTrial], bic_penalty: float
) -> AlternativeModel:
    """Return the best sine wave along the depth, as a screw or a gear of the stage may cause it."""
    lengths = np.geomspace(0.6, 25.0, 60)
    parts = []
    for trial in trials:
        angle: Array = 2 * np.pi * trial.motion.depth_mm[:, None] / np.asarray(lengths, float)
        parts.append((trial.whiten(trial.on_each_axis(np.sin(angle))), trial.whiten(trial.on_each_axis(np.cos(angle)))))
    single = np.maximum(
        likelihood.scores([s for s, _ in parts]).gains()[0], likelihood.scores([c for _, c in parts]).gains()[0]
    )
    best = -np.inf
    for index in np.argsort(-single)[:4]:
        best = max(best, likelihood.basis_gains([np.column_stack([s[:, index], c[:, index]]) for s, c in parts]))
    return AlternativeModel("wave of the position", GapAxis.PERIOD, best, 3, best - 3 * bic_penalty)


@dataclass(frozen=True, kw_only=True)
class _PushSquared(Memoryless):
    """A term proportional to the square of the pushing force."""

    name: ClassVar[str] = "pushing_force_squared"
    size: float = parameter("1/N", -10, 10, "factor of the squared pushing force", typical=0.01)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        return np.asarray(np.maximum(plain, 0.0) ** 2)


_SQUARED = TermEffect(
    "pushing_force_squared", "square of the pushing force", Family.SENSOR, Enters.SENSOR, "F += size max(F, 0)^2",
    "The error of the force reading grows with the square of the pushing force.", "", term=_PushSquared,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _StepInTime(Memoryless):
    """A constant force that begins at one time."""

    name: ClassVar[str] = "step_in_time"
    size: float = parameter("N", -20, 20, "force added after the step", typical=0.01)
    time_s: float = constant("s", 0, 1e6, "time of the step in each trial")

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        return np.asarray(motion.time_s >= self.time_s, float)


_STEPPED = TermEffect(
    "step_in_time", "step in time", Family.SENSOR, Enters.SENSOR, "F += size (t >= time_s)",
    "Something slipped, in every trial at the same time.", "", term=_StepInTime,
)  # fmt: skip


def refit_alternatives(
    best: JointFit,
    seen: HeldOutValidation | None,
    alternatives: Sequence[AlternativeModel],
    calibration: Calibration,
    base: JointLikelihood,
) -> tuple[AlternativeModel, ...]:
    """Fit two alternatives like effects if they resemble the effect of `best`, and return all alternatives.

    The two are a step in time that is common to all trials, and the square of the pushing force, which is added to the
    given alternatives. The result is sorted by the combined gain, the largest first. `seen` is the validation of
    `best`. For channels other than the force, the given alternatives are returned unchanged.
    """
    if calibration.given.channel is not Channel.FORCE:
        return tuple(alternatives)
    found = [_refit_step(each, best, seen, calibration, base) for each in alternatives]
    squared = _refit_square(best, seen, calibration, base)
    return tuple(sorted([*found, *([squared] if squared else [])], key=lambda each: -each.combined_gain))


def _refit_step(
    alternative: AlternativeModel,
    best: JointFit,
    seen: HeldOutValidation | None,
    calibration: Calibration,
    base: JointLikelihood,
) -> AlternativeModel:
    """Refit and validate a step in time that is common to all trials; return other alternatives and weak steps as is.

    A step is weak if its gain is below half of the gain of `best`.
    """
    if alternative.time_s is None or alternative.likelihood_gain < _LIKENESS * best.likelihood_gain:
        return alternative
    joint = fit_jointly([_step_at(alternative.time_s)], calibration, base, best.trials)
    first = best.trials[0].motion.time_s
    begins = max(float(each.motion.time_s[0]) for each in best.trials) + EARLIEST_STEP_S
    coarse = np.arange(begins, first[-1] - _STEP_WINDOW_S, _STEP_WINDOW_S / 2)
    # Free heterogeneity absorbs a step at a wrong time, so the coarse search assumes homogeneous tissue.
    for heterogeneity_sds, times_s in ((_HOMOGENEOUS, coarse), (joint.likelihood.heterogeneity_sds, None)):
        here = joint.effects[0].values["time_s"]
        near = first[(np.abs(first - here) < _STEP_WINDOW_S) & (first > begins)] if times_s is None else times_s
        moved = fit_jointly(
            [_step_at(_best_step_time_s(joint, near, heterogeneity_sds))], calibration, base, joint.trials
        )
        joint = max(joint, moved, key=lambda each: each.likelihood_gain)
    likelihood_gain = max(joint.likelihood_gain, alternative.likelihood_gain)
    held_out_difference = _held_out_difference(joint, seen, calibration)
    return replace(
        alternative,
        likelihood_gain=likelihood_gain,
        bic_gain=likelihood_gain - alternative.degrees_of_freedom * base.bic_penalty,
        held_out_difference=held_out_difference,
    )


def _held_out_difference(joint: JointFit, seen: HeldOutValidation | None, calibration: Calibration) -> float:
    """Return the held-out gain of the alternative `joint` minus that of the validation `seen`; 0 if not validated."""
    there = validate(joint, calibration) if seen else None
    return there.likelihood_gain - seen.likelihood_gain if there and seen else 0.0


def _step_at(time_s: float) -> FittedEffect:
    return FittedEffect(_STEPPED, {SIZE: _STEPPED.parameters[SIZE].typical, "time_s": time_s})


def _best_step_time_s(joint: JointFit, times_s: Array, heterogeneity_sds: Array) -> float:
    """Return the time among `times_s` (s) at which the step of a joint fit fits best.

    The base model stays as it was fitted with the step. Calibrated without the step, it would imitate a large step.
    """
    step = joint.effects[0]
    sensitivities = [trial.whiten(np.asarray(trial.motion.time_s[:, None] >= times_s, float)) for trial in joint.trials]
    blocks = [
        replace(
            trial.whitened,
            residual=trial.whitened.residual + trial.whiten(effects_output([step], trial.model, trial.motion)),
        )
        for trial in joint.trials
    ]
    gains, _ = JointLikelihood(blocks, heterogeneity_sds).scores(sensitivities).gains()
    return float(times_s[gains.argmax()])


def _refit_square(
    best: JointFit, seen: HeldOutValidation | None, calibration: Calibration, base: JointLikelihood
) -> AlternativeModel | None:
    """Fit and validate the squared pushing force as an alternative; return None if it does not resemble `best`."""
    named = np.concatenate([effects_output(best.effects, trial.model, trial.motion) for trial in best.trials])
    plain = np.concatenate([simulate(trial.model, trial.motion).output for trial in best.trials])
    square = np.maximum(plain, 0.0) ** 2
    square_left = square - plain * float(square @ plain) / max(float(plain @ plain), 1e-300)
    named_left = named - plain * float(named @ plain) / max(float(plain @ plain), 1e-300)
    both = float(square_left @ named_left)
    energies = float(square_left @ square_left), float(named_left @ named_left)
    if both**2 < _LIKENESS * energies[0] * energies[1] or not energies[0]:
        return None
    start = FittedEffect(_SQUARED, {SIZE: both / energies[0]})
    joint = fit_jointly([start], calibration, base, best.trials)
    held_out_difference = _held_out_difference(joint, seen, calibration)
    return AlternativeModel(
        "pushing force squared",
        GapAxis.FORCE,
        joint.likelihood_gain,
        1,
        joint.likelihood_gain - base.bic_penalty,
        held_out_difference=held_out_difference,
    )
