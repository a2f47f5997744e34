"""Joint fits of the base model and effects, by simulation.

The fit alternates two steps. First the base model is recalibrated to each trial with the effects held. Then the
parameters of the effects, which all trials share, take a Gauss-Newton step with the base model projected out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.diagnosis.calibration import CalibratedTrial, Calibration, calibrate_trial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.likelihood import Gates, JointLikelihood
from needleplan.models import Model, Scale, simulate
from needleplan.models.effects import SIZE, Reach
from needleplan.signals import Array, Motion

__all__ = [
    "DIRECTION",
    "TWO_SIDED_95",
    "HeldOutValidation",
    "JointFit",
    "amplitude_interval",
    "effect_sensitivities",
    "effects_output",
    "fit_jointly",
    "is_nonzero",
    "is_within_bounds",
    "model_with_effects",
    "recalibrated_trials",
    "transfers",
]

# Relative change of a logarithmic parameter for numerical sensitivities.
_LOG_STEP = 1e-3
# Change of a linear parameter for numerical sensitivities, in units of its typical value.
_LINEAR_STEP = 0.05
# Expected likelihood gain of a full step below which the fit ends.
_LEAST_GAIN = 0.05
# Likelihood gain of a round above which a fit continues beyond its usual number of rounds.
_CLIMBING_GAIN = 3.0
# Largest number of rounds of a fit, as a multiple of the usual number.
_LONG_FACTOR = 4
# Expected likelihood gain of a shortened step below which it is not tried.
_RETRY_GAIN = 0.5
# Scales of the neighbourhood that a nonlinear effect searches before a fit, coarse to fine.
_SCALES = (1.0, 0.5, 0.25)
# Largest change of the logarithm of a parameter in one step.
_LONGEST = 0.4
# Predicted held-out gain below which the transfer test is waived.
_LEAST_PREDICTED = 2.0
# Largest drop of the held-out gain below zero that is accepted if the transfer test is waived.
_MOST_HARM = 4.0
# Name of the parameter that gives an amplitude its direction.
DIRECTION = "direction_rad"
# Two-sided 95 % quantile of the standard normal distribution.
TWO_SIDED_95 = 1.959964
# Number of points on the confidence ellipse of an amplitude with a direction.
_ELLIPSE_POINTS = 720


@dataclass(frozen=True)
class HeldOutValidation:
    """How well effects predict the held-out trials.

    The base model is recalibrated to each trial, the effects are held at their fitted values. "Before" means the base
    model alone, or with the effects of earlier rounds.
    """

    predicted: float
    """Drop of the weighted residual energy that the effects predict for these trials."""

    achieved: float
    """Drop of the weighted residual energy that the effects achieve."""

    likelihood_gain: float
    """Twice the log-likelihood gain over "before"; each of the two likelihoods uses its own best heterogeneity."""

    before_rms: float
    after_rms: float
    floor_rms: float
    """RMS of the sensor noise; `before_rms` and `after_rms` are the residual RMS before and with the effects."""

    shrink: float
    """Share of the residual energy above the noise that the effects remove; NaN if there is no such energy."""

    gap_sds: float
    """Residual energy above the noise without the effects, in standard deviations of the noise energy."""

    whiteness_before: float
    whiteness_after: float
    """p-value of the Ljung-Box test on the whitened residuals with the effects; `whiteness_before` without them."""

    @property
    def transfer(self) -> float:
        """Ratio of achieved to predicted gain: about 1 for a true effect, NaN if no gain is predicted."""
        return self.achieved / self.predicted if self.predicted > 0 else float("nan")


@dataclass(frozen=True)
class JointFit:
    """Base model and effects, fitted together to the training trials."""

    effects: tuple[FittedEffect, ...]
    trials: tuple[CalibratedTrial, ...]
    """Training trials, with the base model calibrated jointly with the effects."""

    likelihood: JointLikelihood
    """Likelihood with the effects' parameters as nuisance parameters that all trials share."""

    likelihood_gain: float
    """Twice the log-likelihood gain of all effects over the base model alone."""

    covariance: Array
    """Covariance of the fit coordinates, with the base model projected out, shape (coordinates, coordinates)."""

    coordinates: tuple[tuple[int, str], ...]
    """For each fit coordinate: index of the effect and name of the parameter."""

    validation: HeldOutValidation | None = None
    """Validation of the newest effect, compared with the earlier effects; None if it was not validated."""

    refuted: bool = False
    """Whether the validation refutes the newest effect."""

    @property
    def newest(self) -> FittedEffect:
        """The effect that was added last; its gains are relative to the fit of the earlier effects."""
        return self.effects[-1]

    @property
    def combined_gain(self) -> float:
        """BIC gain of the newest effect in training plus its likelihood gain on the held-out trials."""
        return self.newest.bic_gain + (self.validation.likelihood_gain if self.validation else 0.0)

    def with_newest(self, likelihood_gain: float, bic_gain: float) -> JointFit:
        """Return a copy with the given gains of the newest effect over the fit of the earlier effects."""
        newest = replace(self.newest, likelihood_gain=likelihood_gain, bic_gain=bic_gain)
        return replace(self, effects=(*self.effects[:-1], newest))

    def sd(self, which: int, name: str) -> float:
        """Return the linearised standard deviation of parameter `name` of `effects[which]`, in the parameter's unit."""
        index = self.coordinates.index((which, name))
        each = self.effects[which]
        what = each.effect.parameters[name]
        return float(np.sqrt(max(self.covariance[index, index], 0.0)) * what.slope(each.values[name]))


def effects_output(effects: Sequence[FittedEffect], model: Model, motion: Motion) -> Array:
    """Return the change of a model's output that the effects cause along a motion, shape (axes * samples,)."""
    plain = simulate(model, motion).output
    return np.asarray((simulate(model_with_effects(effects, model), motion).output - plain).ravel())


def model_with_effects(effects: Sequence[FittedEffect], model: Model) -> Model:
    """Return the model with the effects added at their fitted values."""
    for each in effects:
        model = each.effect.apply(model, each.values)
    return model


def recalibrated_trials(
    effects: Sequence[FittedEffect], calibration: Calibration, trials: Sequence[CalibratedTrial]
) -> tuple[CalibratedTrial, ...]:
    """Return the trials with the base model recalibrated to each trial, while the effects keep their values."""
    return tuple(
        calibrate_trial(
            trial.model, trial.record, calibration.noise, calibration.free,
            whole=lambda model: model_with_effects(effects, model),
            start_lag_s=trial.lag_s, about=calibration.given,
        )
        for trial in trials
    )  # fmt: skip


def fit_jointly(
    start: Sequence[FittedEffect],
    calibration: Calibration,
    base: JointLikelihood,
    trials: Sequence[CalibratedTrial] | None = None,
) -> JointFit:
    """Fit effects and base model together.

    `start` holds the effects with starting values. `base` is the likelihood of the base model alone. `trials` hold the
    starting values of the base model, by default its calibration without effects.
    """
    effects = tuple(start)
    coordinates = tuple((index, name) for index, each in enumerate(effects) for name in _free(each))
    effects = _moved(effects, coordinates, np.zeros(len(coordinates)))  # clips to the bounds: screening ignores some
    trials = tuple(trials or calibration.training)
    max_rounds = channel_description(calibration.model.channel).max_rounds
    tried = _tried(effects, trials)
    if tried != effects:
        effects, max_rounds = tried, 2 * max_rounds
    best: JointFit | None = None
    move, share, expected_gain = np.zeros(len(coordinates)), 1.0, 0.0
    for count in range(_LONG_FACTOR * max_rounds):
        trials = recalibrated_trials(effects, calibration, trials)
        sensitivities = [
            trial.whiten(effect_sensitivities(effects, coordinates, trial.model, trial.motion)) for trial in trials
        ]
        shared = JointLikelihood(
            [replace(trial.whitened, shared=each) for trial, each in zip(trials, sensitivities, strict=True)]
        )
        matrix, target = shared.shared_normal(shared.best)
        ridge = 1e-6 * np.diag(np.diag(matrix) + 1e-12)
        covariance = np.asarray(np.linalg.inv(matrix + ridge), float)
        # Gain of the present effects, without the linearised step that the evidence would include.
        likelihood_gain = 2 * float(shared.evidence_alone.max() - base.evidence.max())
        rise = likelihood_gain - best.likelihood_gain if best else np.inf
        if best is None or rise > 0:
            best = JointFit(effects, trials, shared, likelihood_gain, covariance, coordinates)
            move, share = _allowed(effects, coordinates, matrix + ridge, target), 1.0
            expected_gain = float(move @ target)
        else:
            share /= 3
            expected_gain /= 3
        if expected_gain < (_LEAST_GAIN if share == 1 else _RETRY_GAIN) or (
            count + 1 >= max_rounds and rise < _CLIMBING_GAIN
        ):
            break
        effects, trials = _moved(best.effects, coordinates, share * move), best.trials
    assert best is not None
    return best


def _tried(effects: tuple[FittedEffect, ...], trials: Sequence[CalibratedTrial]) -> tuple[FittedEffect, ...]:
    """Return the effects with the last effect moved to the best point of a grid around its present values.

    The base model is linearised; the last effect is evaluated at the amplitudes of the grid, without rescaling.
    """
    *before, last = effects
    reach = Reach.of([trial.motion for trial in trials])
    likelihood: JointLikelihood | None = None
    for scale in _SCALES:
        grid = last.effect.nearby(last.values, reach, scale)
        if not grid:
            break
        if likelihood is None:
            likelihood = JointLikelihood([replace(trial.whitened, residual=_beside(before, trial)) for trial in trials])
        sensitivities = [
            trial.whiten(last.effect.columns(model_with_effects(before, trial.model), trial.motion, grid))
            for trial in trials
        ]
        scores, amplitudes = likelihood.scores(sensitivities), np.array([each[SIZE] for each in grid])
        evidence = 2 * likelihood.evidence[:, None] + 2 * scores.slope * amplitudes - scores.curvature * amplitudes**2
        last = replace(last, values=grid[int(evidence.max(axis=0).argmax())])
    return (*before, last)


def _beside(effects: Sequence[FittedEffect], trial: CalibratedTrial) -> Array:
    """Return the whitened residual of a trial minus the whitened output of the effects, shape (n,)."""
    if not effects:
        return trial.whitened.residual
    return np.asarray(trial.whitened.residual - trial.whiten(effects_output(effects, trial.model, trial.motion)))


def _free(effect: FittedEffect) -> tuple[str, ...]:
    """Return the names of the free parameters of an effect."""
    return tuple(name for name, what in effect.effect.parameters.items() if what.free)


def effect_sensitivities(
    effects: Sequence[FittedEffect], coordinates: Sequence[tuple[int, str]], model: Model, motion: Motion
) -> Array:
    """Return the derivatives of the output with respect to the coordinates, shape (axes * samples, coordinates)."""
    plain = effects_output(effects, model, motion)
    found = []
    for index, name in coordinates:
        step = _LOG_STEP if effects[index].effect.parameters[name].scale is Scale.LOG else _LINEAR_STEP
        if name == SIZE:
            # Relative to the amplitude itself, because the effect may be small.
            what = effects[index].effect.parameters[SIZE]
            step = _LOG_STEP * max(abs(effects[index].values[SIZE]), 1e-3 * what.typical) / what.typical
            step = step if what.scale is Scale.LINEAR else _LOG_STEP
        moved = _moved(effects, ((index, name),), np.array([step]))
        if moved[index].values[name] == effects[index].values[name]:  # the parameter is at its upper bound
            step = -step
            moved = _moved(effects, ((index, name),), np.array([step]))
        found.append((effects_output(moved, model, motion) - plain) / step)
    return np.column_stack(found) if found else np.zeros((len(plain), 0))


def _allowed(
    effects: Sequence[FittedEffect], coordinates: Sequence[tuple[int, str]], matrix: Array, target: Array
) -> Array:
    """Return the Gauss-Newton step, shape (coordinates,); parameters that would leave their bounds are held.

    A step that is too long is shortened as a whole: parameters are correlated, so shortening one alone would worsen
    the fit.
    """
    free = np.ones(len(coordinates), bool)
    while True:
        move = np.zeros(len(coordinates))
        move[free] = np.linalg.solve(matrix[np.ix_(free, free)], target[free])
        there = _moved(effects, coordinates, 1e-6 * np.sign(move))
        stuck = np.array([
            there[index].values[name] == effects[index].values[name] and move[row] != 0
            for row, (index, name) in enumerate(coordinates)
        ], bool)  # fmt: skip
        if not stuck.any():
            break
        free &= ~stuck
    logs = [
        abs(float(each)) for each, (index, name) in zip(move, coordinates, strict=True)
        if effects[index].effect.parameters[name].scale is Scale.LOG
    ]  # fmt: skip
    return np.asarray(move * min(1.0, _LONGEST / max(max(logs, default=0.0), 1e-12)))


def _moved(
    effects: Sequence[FittedEffect], coordinates: Sequence[tuple[int, str]], move: Array
) -> tuple[FittedEffect, ...]:
    """Return the effects with each coordinate moved by `move`; values and logarithmic steps are clipped."""
    changed = [dict(each.values) for each in effects]
    for (index, name), step in zip(coordinates, move, strict=True):
        what = effects[index].effect.parameters[name]
        value = changed[index][name]
        if what.scale is Scale.LOG:
            each = max(min(float(step), _LONGEST), -_LONGEST)
            new = value * float(np.exp(each))
        else:
            new = value + float(step) * what.typical
        low, high = effects[index].bounds.get(name, (what.lower, what.upper))
        changed[index][name] = min(max(new, low, what.lower), high, what.upper)
    return tuple(replace(each, values=values) for each, values in zip(effects, changed, strict=True))


def transfers(validation: HeldOutValidation, gates: Gates) -> bool:
    """Return whether the held-out trials confirm the effects: whether the achieved gain exceeds a threshold.

    The achieved gain of a true effect is normal with mean `predicted` and variance 4 `predicted`. The threshold is the
    smaller of a fixed share of the predicted gain and the 1 % quantile of that distribution, but at least 0. If
    `predicted` is below 2, the threshold is -4.
    """
    if validation.predicted < _LEAST_PREDICTED:
        return validation.achieved > -_MOST_HARM
    chance = validation.predicted - gates.transfer_sds * 2 * math.sqrt(max(validation.predicted, 0.0))
    return validation.achieved > max(0.0, min(gates.transfer * validation.predicted, chance))


def is_nonzero(joint: JointFit, which: int) -> bool:
    """Return whether the 95 % interval of an effect's amplitude excludes zero.

    The effect's depth, time or speed is held, because it is undefined for the amplitude zero.
    """
    kept = [row for row, (index, name) in enumerate(joint.coordinates) if index != which or name in (SIZE, DIRECTION)]
    # Scaled by the standard deviations, so that an undetermined parameter does not hide a well determined one.
    scale = np.sqrt(np.maximum(np.diag(joint.covariance), 1e-300))
    precision = np.linalg.pinv(joint.covariance / np.outer(scale, scale), hermitian=True)[np.ix_(kept, kept)]
    covariance = np.zeros_like(joint.covariance)
    covariance[np.ix_(kept, kept)] = np.linalg.pinv(precision, hermitian=True)
    covariance *= np.outer(scale, scale)
    low, high = amplitude_interval(covariance, joint, which)
    return low * high > 0


def is_within_bounds(joint: JointFit, which: int) -> bool:
    """Return whether the amplitude of an effect is inside its bounds; False if it equals a bound."""
    each = joint.effects[which]
    what, amplitude = each.effect.parameters[SIZE], each.values[SIZE]
    sd = joint.sd(which, SIZE)
    within = what.lower - 2 * sd <= amplitude <= what.upper + 2 * sd
    return bool(within and amplitude not in (what.lower, what.upper))


def amplitude_interval(covariance: Array, joint: JointFit, which: int) -> tuple[float, float]:
    """Return the linearised 95 % interval of an amplitude.

    An amplitude with a direction is a vector with two normally distributed components, even if the direction is
    undetermined. The interval holds the lengths of all vectors inside the confidence ellipse of the components.
    """
    each = joint.effects[which]
    amplitude, unit = each.values[SIZE], each.effect.parameters[SIZE].typical
    row = joint.coordinates.index((which, SIZE))
    if DIRECTION not in each.effect.parameters:
        sd = unit * float(np.sqrt(max(covariance[row, row], 0.0)))
        return amplitude - TWO_SIDED_95 * sd, amplitude + TWO_SIDED_95 * sd
    angle, rows = each.values[DIRECTION], [row, joint.coordinates.index((which, DIRECTION))]
    units = np.array([unit, each.effect.parameters[DIRECTION].typical])
    turn = np.array([[np.cos(angle), -amplitude * np.sin(angle)], [np.sin(angle), amplitude * np.cos(angle)]]) * units
    vector = amplitude * np.array([np.cos(angle), np.sin(angle)])
    values, axes = np.linalg.eigh(turn @ covariance[np.ix_(rows, rows)] @ turn.T)
    radii = TWO_SIDED_95 * np.sqrt(np.maximum(values, 0.0))
    round_ = np.linspace(0.0, 2 * np.pi, _ELLIPSE_POINTS, endpoint=False)
    edge = vector[:, None] + axes @ (radii[:, None] * np.array([np.cos(round_), np.sin(round_)]))
    lengths = np.hypot(*edge)
    inside = bool(((axes.T @ vector / np.maximum(radii, 1e-9 * abs(amplitude))) ** 2).sum() <= 1)
    low, high = (0.0 if inside else float(lengths.min())), float(lengths.max())
    return (low, high) if amplitude >= 0 else (-high, -low)
