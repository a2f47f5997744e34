"""Effects at fitted values: their output beside one another, and its derivatives by their parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect, with_effects
from needleplan.models import Model, Parameter, Scale, simulate
from needleplan.models.effects import SIZE, TermEffect
from needleplan.signals import Array, Motion

__all__ = [
    "Coordinate",
    "coordinates_of",
    "in_trial",
    "is_added",
    "linearised",
    "output_beside",
    "prior_width",
    "relative_step",
    "shifted",
]

# Relative steps of numerical derivatives.
_STEP = 1e-3
# Change of a linear parameter, in units of its typical value, for a numerical derivative.
_LINEAR_STEP = 0.05
# Terms that depend on the output of the model without them.
_OF_THE_OUTPUT = ("gain_error", "relaxation")


class Coordinate(NamedTuple):
    """A fitted parameter of a set of effects."""

    effect: int
    """Index of the effect."""

    name: str
    trial: int | None = None
    """Index of the only trial that has this value; None if all trials share it."""


def coordinates_of(effects: Sequence[FittedEffect], trials: int) -> tuple[Coordinate, ...]:
    """Return the coordinates of a set of effects: one for each free parameter, or one for each trial."""
    found: list[Coordinate] = []
    for index, each in enumerate(effects):
        for name, what in each.effect.parameters.items():
            if what.free and name in each.effect.by_trial:
                found += [Coordinate(index, name, trial) for trial in range(trials)]
            elif what.free:
                found.append(Coordinate(index, name))
    return tuple(found)


def in_trial(effects: Sequence[FittedEffect], trial: CalibratedTrial, number: int) -> list[FittedEffect]:
    """Return the effects with the values of the trial with this number; in a reference those of the given model."""
    return [each.in_trial(number) for each in effects if each.given or not trial.is_reference]


def output_beside(model: Model, effects: Sequence[FittedEffect], motion: Motion) -> Array:
    """Return the output of a model with effects, one axis after the other, shape (axes * samples,)."""
    return simulate(with_effects(model, effects), motion).output.ravel()


def linearised(
    effects: Sequence[FittedEffect], coordinates: Sequence[Coordinate], trial: CalibratedTrial, number: int
) -> tuple[list[Array], list[Array]]:
    """Return the output of each effect beside the others, and the derivative of the output by each coordinate.

    The values are those of this trial, which is the one with this number. What a reference lacks has no output there.
    """

    def output(changed: Sequence[FittedEffect]) -> Array:
        return output_beside(trial.model, in_trial(changed, trial, number), trial.motion)

    effects = [each.in_trial(number) for each in effects]
    absent = [trial.is_reference and not each.given for each in effects]
    whole = output(effects)
    outputs = [
        np.zeros_like(whole) if absent[index] else whole - output([*effects[:index], *effects[index + 1 :]])
        for index in range(len(effects))
    ]
    tangents = []
    for index, name, only in coordinates:
        if absent[index] or only not in (None, number):
            tangents.append(np.zeros_like(whole))
            continue
        each = effects[index]
        what = each.effect.parameters[name]
        value = each.values[name]
        step = _numerical_step(what, name, value)
        moved = shifted(each, name, step)
        if moved.values[name] == value:
            step, moved = -step, shifted(each, name, -step)
        there = output([*effects[:index], moved, *effects[index + 1 :]])
        tangents.append((there - whole) / step)
    return outputs, tangents


def relative_step(model: Model, name: str) -> float:
    """Return the relative change of a positive parameter for a numerical derivative; at its upper bound a decrease."""
    return _STEP if getattr(model, name) * (1 + _STEP) <= model.parameters()[name].upper else -_STEP


def _numerical_step(what: Parameter, name: str, value: float) -> float:
    """Return the change of a fit coordinate for a numerical derivative."""
    if what.scale is Scale.LOG:
        return _STEP
    if name == SIZE:
        return _STEP * max(abs(value), 1e-3 * what.typical) / what.typical
    return _LINEAR_STEP


def shifted(effect: FittedEffect, name: str, step: float, trial: int | None = None) -> FittedEffect:
    """Return an effect with one fit coordinate moved, within the bounds of the parameter; in one trial if given."""
    if trial is not None:
        value = shifted(effect.in_trial(trial), name, step).values[name]
        own = tuple({**each, name: value} if number == trial else each for number, each in enumerate(effect.own))
        return replace(effect, own=own, values={**effect.values, **own[0]})
    what = effect.effect.parameters[name]
    value = effect.values[name]
    new = value * math.exp(step) if what.scale is Scale.LOG else value + step * what.typical
    low, high = effect.bounds.get(name, (what.lower, what.upper))
    new = min(max(new, low, what.lower), high, what.upper)
    return replace(effect, values={**effect.values, name: new})


def prior_width(effect: FittedEffect, name: str) -> float:
    """Return the width of the uniform prior of a parameter in its fit coordinate: the range of the library's grid."""
    what = effect.effect.parameters[name]
    if what.unit == "rad":
        return 2 * math.pi
    low, high = effect.bounds.get(name, (what.lower, what.upper))
    if what.scale is Scale.LOG:
        return max(math.log(high / low), 0.1)
    return max(what.coordinate(high) - what.coordinate(low), 1e-6)


def is_added(effect: FittedEffect) -> bool:
    """Return whether the output of an effect is added to that of the model, whatever that is."""
    return isinstance(effect.effect, TermEffect) and effect.name not in _OF_THE_OUTPUT
