"""Fit of a set of effects and of the base models of all trials, together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needleplan.diagnosis.calibration import (
    EARLIEST_S,
    LAG,
    LONGEST_LAG_S,
    PRIOR_SD,
    CalibratedTrial,
    calibrate_trial,
)
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.likelihood import HETEROGENEITY_SDS
from needleplan.diagnosis.posterior._evidence import Columns, LinearModel
from needleplan.diagnosis.posterior._hypothesis import Extra, Hypothesis
from needleplan.diagnosis.posterior._problem import FORMULA_ERRORS, Problem
from needleplan.diagnosis.posterior._reversal import blended, unblended
from needleplan.diagnosis.posterior._tangents import shifted, with_effects
from needleplan.models import Model, Scale
from needleplan.models.effects import SIZE, effect_columns
from needleplan.signals import Array

__all__ = ["fit_hypothesis"]

# Steps of a fit.
_MOST_STEPS = 12
# Rise of the log posterior density, found and expected, below which a fit ends.
_CONVERGED, _LEAST_PROMISE = 0.1, 0.2
# Share of a step below which a fit ends.
_SHORTEST = 0.05
# Largest step of a logarithm, and of an angle (rad).
_LONGEST = 0.5
# Scales of the neighbourhood in which an effect with local optima is sought, coarse to fine.
_NEIGHBOURHOODS = (1.0, 0.5, 0.25)


def fit_hypothesis(
    problem: Problem,
    start: Sequence[FittedEffect],
    begin: Sequence[CalibratedTrial],
    extra: Extra | None = None,
    others: Sequence[FittedEffect] = (),
    most_steps: int = _MOST_STEPS,
    least: float = -math.inf,
    formula_error: float = FORMULA_ERRORS[-1],
) -> Hypothesis:
    """Fit effects and base models to all trials together by Gauss-Newton steps, beginning at the trials `begin`.

    `others` are further start values of the last effect. The fit is given up after a step if the log evidence, plus
    what the linear model promises, is below `least`.
    """
    effects = tuple(shifted(each, SIZE, 0.0) for each in start)
    effects = _nearby(problem, effects, begin, others) if effects and extra is None else effects
    here = Hypothesis.at(problem, effects, _linearised_trials(problem, effects, begin), extra, formula_error)
    share = 1.0
    for step in range(most_steps):
        if step < 2:
            here = here.with_best_formula_error()
        energy, volume = here.linear.at_zero(len(here.coordinates))
        h = int((problem.noise_scale.log_likelihood(energy) + volume + problem.log_prior_h).argmax())
        if share * (2 - share) * here.promise(h) < _LEAST_PROMISE:
            break
        move = _step(here, h)
        change = move[here.first_blend :][: len(here.blend)] - here.blend
        moved, blend = _moved(here, share * move), here.blend + share * change
        steps = [share * each for each in here.linear.base_steps(h, move)]
        there = Hypothesis.at(problem, moved, _linearised_trials(problem, moved, here.trials, steps, blend), extra,
                              here.formula_error)  # fmt: skip
        rise = there.height - here.height
        here, share = (there, 1.0) if rise > 0 else (here, share / 2)
        if abs(rise) < _CONVERGED or share < _SHORTEST or here.log_evidence + here.promise(h) < least:
            break
    return here.with_best_formula_error()


def _linearised_trials(
    problem: Problem,
    effects: tuple[FittedEffect, ...],
    trials: Sequence[CalibratedTrial],
    steps: Sequence[Array] | None = None,
    blend: Array | None = None,
) -> tuple[CalibratedTrial, ...]:
    """Return the trials linearised beside the effects, at base parameters moved by `steps` and a law of reversal."""
    calibration = problem.calibration
    found = []
    for number, trial in enumerate(trials):
        model, lag_s = trial.model, trial.lag_s
        if steps is not None:
            model, lag_s = _moved_base(problem, trial, steps[number])
        if blend is not None:
            model = blended(model, blend)
        found.append(calibrate_trial(
            model, trial.record, calibration.noise, calibration.free, modes=False, hold=(*calibration.free, LAG),
            whole=lambda model: with_effects(model, effects), start_lag_s=lag_s, about=calibration.given,
        ))  # fmt: skip
    return tuple(found)


def _moved_base(problem: Problem, trial: CalibratedTrial, step: Array) -> tuple[Model, float]:
    """Return base model and lag of a trial moved by a step in units of its normalised sensitivities."""
    free, rows = problem.calibration.free, int(trial.rows.sum())
    description = channel_description(trial.model.channel)
    what = trial.model.parameters()
    # The rows of priors hold 1 / (prior sd * norm) of each sensitivity.
    units = np.diag(trial.whitened.base_sensitivities[rows : rows + len(free) + 1, : len(free) + 1])
    sds = np.array([description.priors.get(name, PRIOR_SD) for name in free] + [max(description.usual_lag_s, 1e-9)])
    moves = step[: len(free) + 1] * units * sds
    moves[:-1] *= min(1.0, _LONGEST / max(float(np.abs(moves[:-1]).max(initial=0.0)), 1e-12))
    values = {}
    for name, move in zip(free, moves[:-1].tolist(), strict=True):
        value = what[name].value(what[name].coordinate(getattr(trial.model, name)) + move)
        values[name] = min(max(value, what[name].lower), what[name].upper)
    return trial.model.with_values(**values), float(np.clip(trial.lag_s + moves[-1], EARLIEST_S, LONGEST_LAG_S))


def _step(here: Hypothesis, h: int) -> Array:
    """Return the Gauss-Newton step of all shared coefficients at a heterogeneity; parameters at a bound stay there."""
    matrix, target = here.linear.posterior_precision[h], here.linear.target[h]
    count = len(here.coordinates)
    free = np.ones(len(target), bool)
    move: Array = np.zeros(len(target))
    for _ in range(count + 1):
        scale = 1 / np.sqrt(np.diag(matrix)[free])
        inner = scale[:, None] * matrix[np.ix_(free, free)] * scale + 1e-9 * np.eye(int(free.sum()))
        move[:] = 0.0
        move[free] = scale * np.linalg.solve(inner, scale * target[free])
        stuck = np.zeros(len(target), bool)
        for row, (index, name) in enumerate(here.coordinates):
            each = here.effects[index]
            if free[row] and shifted(each, name, 1e-6 * float(np.sign(move[row]))).values[name] == each.values[name]:
                stuck[row] = True
        if not (stuck & free).any():
            break
        free &= ~stuck
    longest = 0.0
    for row, (index, name) in enumerate(here.coordinates):
        what = here.effects[index].effect.parameters[name]
        if what.scale is Scale.LOG or what.unit == "rad":
            longest = max(longest, abs(float(move[row])))
    move[:count] *= min(1.0, _LONGEST / max(longest, 1e-12))
    return move


def _moved(here: Hypothesis, move: Array) -> tuple[FittedEffect, ...]:
    """Return the effects with all coordinates moved."""
    effects = list(here.effects)
    for (index, name), step in zip(here.coordinates, move[: len(here.coordinates)].tolist(), strict=True):
        effects[index] = shifted(effects[index], name, step)
    return tuple(effects)


def _nearby(
    problem: Problem,
    effects: tuple[FittedEffect, ...],
    trials: Sequence[CalibratedTrial],
    others: Sequence[FittedEffect],
) -> tuple[FittedEffect, ...]:
    """Return the effects, the last one moved to the best point of the grid that it states around its values.

    This is a start of a fit only: the effect is simulated beside the base alone, for many points at once.
    """
    *before, last = effects
    bases = [unblended(trial.model) for trial in trials]
    model: LinearModel | None = None
    for scale in _NEIGHBOURHOODS:
        starts = [last, *others] if scale == _NEIGHBOURHOODS[0] else [last]
        grid = [point for each in starts for point in each.effect.nearby(each.values, problem.reach, scale)]
        if not grid:
            break
        if model is None:
            blocks = [problem.block(trial, index) for index, trial in enumerate(trials)]
            model = LinearModel(blocks, [np.zeros((len(block.residual), 0)) for block in blocks], np.zeros(0))
        columns = Columns(model.blocks, [
            problem.whiten(trial, n, effect_columns(last.effect, base, trial.motion, grid))
            for n, (trial, base) in enumerate(zip(trials, bases, strict=True))
        ])  # fmt: skip
        every = np.arange(len(HETEROGENEITY_SDS))
        scores, sizes = model.project(columns, every), np.array([each[SIZE] for each in grid])
        volume = (model.logs + problem.log_prior_h)[:, None]
        energy = model.unfitted[:, None] - 2 * scores.slope * sizes + scores.curvature * sizes**2
        gains = volume + problem.noise_scale.log_likelihood(np.maximum(energy, 0.0))
        last = replace(last, values=grid[int(gains.max(axis=0).argmax())])
    return (*before, last)
