"""Fit of a set of effects and of the base models of all trials, together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from needleplan.diagnosis._base_law import LAW_COUNTS, Law, base_forces, full_cutting, law_columns, law_functions
from needleplan.diagnosis._constants import (
    CONTENDS,
    CONVERGED,
    EARLIEST_S,
    FIT_LEVELS,
    HELD_PROMISE,
    LEAST_PROMISE,
    LONGEST,
    LONGEST_LAG_S,
    MOST_STEPS,
    PRIOR_SD,
    SHORTEST,
)
from needleplan.diagnosis._hypothesis import Extra, Hypothesis
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._reversal import blended, tip_reversal
from needleplan.diagnosis._tangents import in_trial, is_added, shifted
from needleplan.diagnosis.calibration import CalibratedTrial, calibrate_trial
from needleplan.diagnosis.catalogue import FittedEffect, with_effects
from needleplan.diagnosis.channels import channel_description
from needleplan.models import Model, Scale
from needleplan.models.effects import SIZE
from needleplan.models.friction import ShaftAndTip
from needleplan.signals import Array

__all__ = [
    "fit_hypothesis",
    "linearised_trials",
    "start_point",
    "visible_laws",
]


def fit_hypothesis(
    problem: Problem,
    start: Sequence[FittedEffect],
    begin: Sequence[CalibratedTrial],
    extra: Extra | None = None,
    most_steps: int = MOST_STEPS,
    least: float = -math.inf,
    like: Hypothesis | None = None,
    held: bool = False,
) -> Hypothesis:
    """Fit effects and base models to all trials together by Gauss-Newton steps, beginning at the trials `begin`.

    After a step, the fit is given up if it hardly reaches the log evidence `least`, by what the linear model promises
    within the bounds of the parameters. The fit begins with the tolerances of the hypothesis `like`, by default with
    the largest formula error and all scales 1. If the tolerances are `held`, a first stage keeps them, and is not given
    up.
    """
    here = start_point(problem, start, begin, extra, like)
    if not most_steps:
        return here.with_levels(problem).with_best_tolerances()
    if held:
        here = _climbed(here, most_steps, held=True)
    here = _settled(here, most_steps, least)
    if here.hope > least + CONTENDS and _is_stale(here):
        trials = linearised_trials(problem, here.effects, here.trials, blend=here.blend, again=True)
        here = here.again(here.effects, trials)
        here = _settled(here, most_steps // 2, least)
    return here.with_levels(problem)


def start_point(
    problem: Problem,
    start: Sequence[FittedEffect],
    begin: Sequence[CalibratedTrial],
    extra: Extra | None = None,
    like: Hypothesis | None = None,
) -> Hypothesis:
    """Return the hypothesis at the start of a fit, with the tolerances and the likely heterogeneities of `like`.

    The parameters are those of `fit_hypothesis`.
    """
    effects = tuple(shifted(each, SIZE, 0.0) for each in start)
    few, given = problem, (like.formula_error, like.scales) if like else ()
    if like:
        likely = np.argsort(-like.by_heterogeneity)[:FIT_LEVELS]
        few = problem.with_levels(np.intersect1d([0, *like.problem.levels[likely]], problem.levels))
    return Hypothesis.at(few, effects, linearised_trials(problem, effects, begin), extra, *given)


def _is_stale(here: Hypothesis) -> bool:
    """Return whether the sensitivities of the base were computed at another point, or beside other effects."""
    if not all(is_added(effect) for effect in here.effects):
        return True
    return any(trial.has_moved(here.problem.calibration) for trial in here.trials)


def _settled(here: Hypothesis, most_steps: int, least: float) -> Hypothesis:
    """Return the hypothesis after steps, and further ones as long as other tolerances are better at their end."""
    for steps in (most_steps, most_steps // 2):
        here = _climbed(here, steps, least)
        best = here.with_best_tolerances()
        settled = best.scales == here.scales and best.formula_error == here.formula_error
        here = best
        if settled or here.promise < LEAST_PROMISE or here.hope < least:
            break
    return here


def _climbed(here: Hypothesis, most_steps: int, least: float = -math.inf, *, held: bool = False) -> Hypothesis:
    """Return the hypothesis after Gauss-Newton steps.

    Before each of the first two the tolerances are chosen, unless they are `held`.
    """
    share, negligible = 1.0, HELD_PROMISE if held else LEAST_PROMISE
    for step in range(most_steps):
        if step < 2 and not held:
            here = here.with_best_scales() if step else here.with_best_tolerances()
        h = here.best_here
        move, energy = _step(here, h)
        promised = here.rise_to(energy)
        forbidden = here.promise - promised  # the evidence contains what the bounds of the parameters forbid
        hope = here.log_evidence - forbidden + promised
        if share * (2 - share) * promised < negligible or (step and hope < least):
            break
        laws = _laws(here, move)
        if laws is not None and here.trials[0].laws is None and visible_laws(here, laws):
            trials = linearised_trials(
                here.problem, here.effects, here.trials, blend=here.blend, laws=laws, again=True
            )  # fmt: skip
            here = here.again(here.effects, trials)  # without the laws, the density would fall along the step
            continue
        change = move[here.first_blend :][: len(here.blend)] - here.blend
        moved, blend = _moved(here, share * move), here.blend + share * change
        steps = [share * base_step for base_step in here.linear.base_steps(h, move)]
        there = here.again(moved, linearised_trials(here.problem, moved, here.trials, steps, blend, laws))
        rise = there.height - here.height
        here, share = (there, 1.0) if rise > 0 else (here, share / 2)
        if abs(rise) < CONVERGED or share < SHORTEST:
            break
    return here


def linearised_trials(
    problem: Problem,
    effects: tuple[FittedEffect, ...],
    trials: Sequence[CalibratedTrial],
    steps: Sequence[Array] | None = None,
    blend: Array | None = None,
    laws: Array | None = None,
    *,
    again: bool = False,
) -> tuple[CalibratedTrial, ...]:
    """Return the trials linearised beside the effects, at base parameters moved by `steps` and a law of reversal.

    `laws` are coefficients of the other laws of the base, whose output the base parameters change too; by default those
    that the trials were linearised with. A trial that moved little keeps its sensitivities, unless they are computed
    `again`.
    """
    calibration = problem.calibration
    found = []
    for number, trial in enumerate(trials):
        model, lag_s = trial.model, trial.lag_s
        beside = in_trial(effects, trial, number)
        if steps is not None:
            model, lag_s = _moved_base(problem, trial, steps[number])
        if blend is not None and isinstance(model, ShaftAndTip):
            model = blended(model, blend)
        whole = partial(with_effects, effects=beside)
        near = None if again else trial.moved(model, lag_s, calibration, whole)
        if near is not None:
            found.append(near)
            continue
        own = trial.laws if laws is None else laws
        there = calibrate_trial(
            model, trial.record, calibration.noise, calibration.free, fixed=True,
            whole=whole, start_lag_s=lag_s, about=calibration.given,
            beside=None if own is None else _law_output(problem, replace(trial, model=model), own, beside),
        )  # fmt: skip
        found.append(replace(there, laws=own))
    return tuple(found)


def _laws(here: Hypothesis, move: Array) -> Array | None:
    """Return the coefficients, after a step, of the base's laws that are no part of its model; None without laws."""
    return move[here.beside_model] if Law.DEPTH in here.groups else None


def visible_laws(here: Hypothesis, laws: Array | None) -> bool:
    """Return whether other laws of the base with these coefficients are visible beside the noise."""
    if laws is None:
        return False
    outputs = np.concatenate([each[:, here.beside_model] @ laws for each in here.linear.basis])
    return float(outputs @ outputs) > here.problem.settings.visible_law**2 * len(outputs)


def _law_output(
    problem: Problem, trial: CalibratedTrial, laws: Array, effects: Sequence[FittedEffect] = ()
) -> Callable[[Model], Array]:
    """Return a function that gives the output, shape (samples,), that other laws of the base add to that of a model.

    The functions of the laws are those at the model of the trial. The forces that they multiply are those of the other
    model, beside the effects. The law of reversal of the tip alone is taken without the effects.
    """
    motion, there = trial.motion, trial.model
    assert isinstance(there, ShaftAndTip)
    shaft, tip = base_forces(there, effects, motion)
    count = len(laws) - sum(LAW_COUNTS.values())
    functions = law_functions(there, motion, shaft, tip, problem.reach, problem.largest_n, problem.settings)
    added, change = laws[count:][None] @ functions, tip_reversal(there, motion, laws[:count])

    def output(model: Model) -> Array:
        assert isinstance(model, ShaftAndTip)
        same = model.presliding_mm == there.presliding_mm
        if same and model.onset_mm == there.onset_mm:
            forces = shaft * (model.friction / there.friction), tip * (model.cutting / there.cutting)
        else:
            forces = base_forces(model, effects, motion)
        full = full_cutting(model, motion)
        bristle = change if same else tip_reversal(model, motion, laws[:count])
        return np.asarray(law_columns(added, *forces, full)[:, 0] + full / 2 * bristle)

    return output


def _moved_base(problem: Problem, trial: CalibratedTrial, step: Array) -> tuple[Model, float]:
    """Return base model and lag of a trial moved by a step in units of its normalised sensitivities."""
    free = problem.calibration.free
    description = channel_description(trial.model.channel)
    what = trial.model.parameters()
    # The rows of priors hold 1 / (prior sd * norm) of each sensitivity.
    units = np.diag(trial.whitened.base[trial.readings :])
    sds = np.array([description.priors.get(name, PRIOR_SD) for name in free] + [max(description.usual_lag_s, 1e-9)])
    moves = step * units * sds
    moves[:-1] *= min(1.0, LONGEST / max(float(np.abs(moves[:-1]).max(initial=0.0)), 1e-12))
    values = {}
    for name, move in zip(free, moves[:-1].tolist(), strict=True):
        value = what[name].value(what[name].coordinate(getattr(trial.model, name)) + move)
        values[name] = min(max(value, what[name].lower), what[name].upper)
    return trial.model.with_values(**values), float(np.clip(trial.lag_s + moves[-1], EARLIEST_S, LONGEST_LAG_S))


def _step(here: Hypothesis, h: int) -> tuple[Array, float]:
    """Return the Gauss-Newton step of all shared coefficients at a heterogeneity, and the squared residual it leaves.

    Parameters at a bound stay there. If a logarithm or an angle would move too far, all parameters of effects move less
    far; the residual is that of the whole step.
    """
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
        for row, (index, name, trial) in enumerate(here.coordinates):
            each = here.effects[index] if trial is None else here.effects[index].in_trial(trial)
            if free[row] and shifted(each, name, 1e-6 * float(np.sign(move[row]))).values[name] == each.values[name]:
                stuck[row] = True
        if not (stuck & free).any():
            break
        free &= ~stuck
    energy = float(here.linear.unfitted[h] - target @ move)
    longest = 0.0
    for row, (index, name, _) in enumerate(here.coordinates):
        what = here.effects[index].effect.parameters[name]
        if what.scale is Scale.LOG or what.unit == "rad":
            longest = max(longest, abs(float(move[row])))
    move[:count] *= min(1.0, LONGEST / max(longest, 1e-12))
    return move, energy


def _moved(here: Hypothesis, move: Array) -> tuple[FittedEffect, ...]:
    """Return the effects with all coordinates moved."""
    effects = list(here.effects)
    for (index, name, trial), step in zip(here.coordinates, move[: len(here.coordinates)].tolist(), strict=True):
        effects[index] = shifted(effects[index], name, step, trial)
    return tuple(effects)
