"""Base and effects together, by the simulator itself and not by columns: the fit on which a decision rests.

In turn, each trial's base is calibrated beside the effects as they are, and the effects' parameters, common to all
trials, take a step of Gauss and Newton with the base projected out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case, fit_case
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.space import Space
from needleplan.models import Model, Scale, simulate
from needleplan.models.effects import SIZE, Effect, Reach
from needleplan.signals import Array, Motion

__all__ = ["Added", "Joint", "added_output", "cases_with", "effect_columns", "refit", "whole_model"]

_STEP = 1e-3
_STEP_LINEAR = 0.05
_DONE = 0.05
_CLIMBS = 3.0
_LONG = 4
"""A fit that still climbs by so much a round may take so many times as many rounds."""

_WORTH = 0.5
"""Gain that a step must promise to be tried again, shorter, where it led downhill."""


@dataclass(frozen=True)
class Added:
    """An effect with the values of its parameters, size among them."""

    effect: Effect
    values: Mapping[str, float]
    within: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Where its parameters are looked for: beyond, another effect may hide in it."""


@dataclass(frozen=True)
class Joint:
    """Base and effects, fitted together."""

    added: tuple[Added, ...]
    cases: tuple[Case, ...]
    """Training trials, their base calibrated beside the effects."""

    space: Space
    """With the effects' parameters as shared nuisances."""

    gain: float
    """Twice the log likelihood over the base alone."""

    covariance: Array
    """Of the parameters' coordinates (see `names`), with the base projected out."""

    names: tuple[tuple[int, str], ...]
    """Which effect and parameter each coordinate is of."""

    def sd(self, which: int, name: str) -> float:
        """Return the standard deviation of a parameter, in its unit, first order."""
        index = self.names.index((which, name))
        each = self.added[which]
        what = each.effect.parameters[name]
        return float(
            np.sqrt(max(self.covariance[index, index], 0.0)) * _slope(what.scale, each.values[name], what.typical)
        )


def added_output(added: Sequence[Added], model: Model, motion: Motion) -> Array:
    """Return what effects add to the output of a model along a motion, shape (samples,)."""
    plain = simulate(model, motion).output
    return np.asarray((simulate(whole_model(added, model), motion).output - plain).ravel())


def whole_model(added: Sequence[Added], model: Model) -> Model:
    """Return the model with the effects."""
    for each in added:
        model = each.effect.apply(model, each.values)
    return model


def cases_with(added: Sequence[Added], calibration: Calibration, cases: Sequence[Case]) -> tuple[Case, ...]:
    """Return trials with the base calibrated beside effects that are held."""
    return tuple(
        fit_case(
            case.model, case.record, calibration.noise, calibration.free,
            whole=lambda model: whole_model(added, model),
            start_lag_s=case.lag_s, about=calibration.given,
        )
        for case in cases
    )  # fmt: skip


def refit(
    start: Sequence[Added],
    calibration: Calibration,
    base: Space,
    cases: Sequence[Case] | None = None,
) -> Joint:
    """Fit effects and base together from `start`; `base` is the space of the base alone.

    The base begins as in `cases`, by default as it was calibrated alone.
    """
    added = tuple(start)
    names = tuple((index, name) for index, each in enumerate(added) for name in _free(each))
    added = _moved(added, names, np.zeros(len(names)))  # what was screened may lie outside of what can be
    cases = tuple(cases or calibration.training)
    rounds = measurand_of(calibration.model.channel).rounds
    tried = _tried(added, cases)
    if tried != added:
        added, rounds = tried, 2 * rounds
    best: Joint | None = None
    move, share, promised = np.zeros(len(names)), 1.0, 0.0
    for count in range(_LONG * rounds):
        cases = cases_with(added, calibration, cases)
        columns = [case.whiten(effect_columns(added, names, case.model, case.motion)) for case in cases]
        shared = Space([replace(case.block, shared=each) for case, each in zip(cases, columns, strict=True)])
        matrix, target = shared.shared_normal(shared.best)
        ridge = 1e-6 * np.diag(np.diag(matrix) + 1e-12)
        covariance = np.asarray(np.linalg.inv(matrix + ridge), float)
        # The likelihood where the fit stands now, not where a step would lead to by the linearisation.
        gain = 2 * float(shared.evidence_alone.max() - base.evidence.max())
        rise = gain - best.gain if best else np.inf
        if best is None or rise > 0:
            best = Joint(added, cases, shared, gain, covariance, names)
            move, share = _allowed(added, names, matrix + ridge, target), 1.0
            promised = float(move @ target)
        else:
            share /= 3
            promised /= 3
        if promised < (_DONE if share == 1 else _WORTH) or (count + 1 >= rounds and rise < _CLIMBS):
            break
        added, cases = _moved(best.added, names, share * move), best.cases
    assert best is not None
    return best


def _tried(added: tuple[Added, ...], cases: Sequence[Case]) -> tuple[Added, ...]:
    """Return effects with the last one moved to where it fits best of what it wants to have tried, the base linear.

    As large as it is tried, and not as large as the column would want it: such effects are not linear in their size.
    """
    *before, last = added
    reach = Reach.of([case.motion for case in cases])
    space: Space | None = None
    for scale in _SCALES:
        grid = last.effect.nearby(last.values, reach, scale)
        if not grid:
            break
        if space is None:
            space = Space([replace(case.block, residual=_beside(before, case)) for case in cases])
        columns = [
            case.whiten(last.effect.columns(whole_model(before, case.model), case.motion, grid)) for case in cases
        ]
        scores, sizes = space.scores(columns), np.array([each[SIZE] for each in grid])
        evidence = 2 * space.evidence[:, None] + 2 * scores.slope * sizes - scores.curvature * sizes**2
        last = replace(last, values=grid[int(evidence.max(axis=0).argmax())])
    return (*before, last)


_SCALES = (1.0, 0.5, 0.25)
"""From far to near."""


def _beside(added: Sequence[Added], case: Case) -> Array:
    """Return the whitened residual of a base without effects, once there are some."""
    if not added:
        return case.block.residual
    return np.asarray(case.block.residual - case.whiten(added_output(added, case.model, case.motion)))


def _free(added: Added) -> tuple[str, ...]:
    return tuple(name for name, what in added.effect.parameters.items() if what.free)


def effect_columns(added: Sequence[Added], names: Sequence[tuple[int, str]], model: Model, motion: Motion) -> Array:
    """Return how the output depends on each coordinate, shape (samples, len(names)); `names` as in `Joint`."""
    plain = added_output(added, model, motion)
    found = []
    for index, name in names:
        step = _STEP if added[index].effect.parameters[name].scale is Scale.LOG else _STEP_LINEAR
        if name == SIZE:
            # In a tenth of a percent of the size itself: an effect may only just be there.
            what = added[index].effect.parameters[SIZE]
            step = _STEP * max(abs(added[index].values[SIZE]), 1e-3 * what.typical) / what.typical
            step = step if what.scale is Scale.LINEAR else _STEP
        moved = _moved(added, ((index, name),), np.array([step]))
        if moved[index].values[name] == added[index].values[name]:  # at the end of its range
            step = -step
            moved = _moved(added, ((index, name),), np.array([step]))
        found.append((added_output(moved, model, motion) - plain) / step)
    return np.column_stack(found) if found else np.zeros((len(plain), 0))


def _allowed(added: Sequence[Added], names: Sequence[tuple[int, str]], matrix: Array, target: Array) -> Array:
    """Return the step of Gauss and Newton, shortened as a whole, in which what is at a bound does not go beyond it.

    Parameters trade with one another: to shorten or end the step of one alone would spoil what the others do.
    """
    free = np.ones(len(names), bool)
    while True:
        move = np.zeros(len(names))
        move[free] = np.linalg.solve(matrix[np.ix_(free, free)], target[free])
        there = _moved(added, names, 1e-6 * np.sign(move))
        stuck = np.array([
            there[index].values[name] == added[index].values[name] and move[row] != 0
            for row, (index, name) in enumerate(names)
        ], bool)  # fmt: skip
        if not stuck.any():
            break
        free &= ~stuck
    logs = [
        abs(float(each)) for each, (index, name) in zip(move, names, strict=True)
        if added[index].effect.parameters[name].scale is Scale.LOG
    ]  # fmt: skip
    return np.asarray(move * min(1.0, _LONGEST / max(max(logs, default=0.0), 1e-12)))


_LONGEST = 0.4


def _moved(added: Sequence[Added], names: Sequence[tuple[int, str]], move: Array) -> tuple[Added, ...]:
    changed = [dict(each.values) for each in added]
    for (index, name), step in zip(names, move, strict=True):
        what = added[index].effect.parameters[name]
        value = changed[index][name]
        if what.scale is Scale.LOG:
            each = max(min(float(step), _LONGEST), -_LONGEST)
            new = value * float(np.exp(each))
        else:
            new = value + float(step) * what.typical
        low, high = added[index].within.get(name, (what.lower, what.upper))
        changed[index][name] = min(max(new, low, what.lower), high, what.upper)
    return tuple(replace(each, values=values) for each, values in zip(added, changed, strict=True))


def _slope(scale: Scale, value: float, typical: float) -> float:
    return value if scale is Scale.LOG else typical
