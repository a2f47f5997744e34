"""Effects at fitted values: their output beside one another, and its derivatives by their parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needleplan.diagnosis._constants import LINEAR_STEP, RELATIVE_STEP
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect, with_effects
from needleplan.models import Model, Parameter, Scale, simulate
from needleplan.models.effects import SIZE, TermEffect, effect_columns
from needleplan.models.friction import BlendedReversal, ShaftAndTip
from needleplan.signals import Array, Motion

__all__ = [
    "Coordinate",
    "coordinates_of",
    "in_trial",
    "is_added",
    "linearised",
    "output_beside",
    "outputs_at",
    "prior_width",
    "relative_step",
    "shifted",
    "unblended",
]

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
    return [effect.in_trial(number) for effect in effects if effect.given or not trial.is_reference]


def unblended(model: Model) -> Model:
    """Return the model with Dahl's law of reversal."""
    return ShaftAndTip(**model.values(), curves=model.curves) if isinstance(model, BlendedReversal) else model


def output_beside(model: Model, effects: Sequence[FittedEffect], motion: Motion) -> Array:
    """Return the output of a model with effects, one axis after the other, shape (axes * samples,)."""
    return simulate(with_effects(model, effects), motion).output.ravel()


def linearised(
    effects: Sequence[FittedEffect], coordinates: Sequence[Coordinate], trial: CalibratedTrial, number: int
) -> tuple[list[Array], list[Array]]:
    """Return the output of each effect beside the others, and the derivative of the output by each coordinate.

    The values are those of this trial, which is the one with this number. What a reference lacks has no output there.
    """
    effects = [effect.in_trial(number) for effect in effects]
    absent = [trial.is_reference and not effect.given for effect in effects]
    present = [each for each, gone in zip(effects, absent, strict=True) if not gone]
    outputs: list[Array] = []
    tangents: dict[int, Array] = {}
    for index, each in enumerate(effects):
        rows = [row for row, (which, _, only) in enumerate(coordinates) if which == index and only in (None, number)]
        if absent[index]:
            outputs.append(np.zeros(len(trial.output)))
            continue
        moved = [_moved(each, coordinates[row].name) for row in rows]
        there = outputs_at(present, present.index(each), [each, *(point for point, _ in moved)], trial)
        outputs.append(there[0])
        tangents |= {row: (own - there[0]) / step for row, own, (_, step) in zip(rows, there[1:], moved, strict=True)}
    none = np.zeros(len(trial.output))
    return outputs, [tangents.get(row, none) for row in range(len(coordinates))]


def outputs_at(
    present: Sequence[FittedEffect], index: int, points: Sequence[FittedEffect], trial: CalibratedTrial
) -> list[Array]:
    """Return the output of one of the effects of a trial at several values, beside the others.

    If all outputs are added, this needs no simulation of the model with all effects.
    """
    effect = points[0].effect
    if all(is_added(each) for each in (*present, points[0])):
        columns = effect_columns(effect, unblended(trial.model), trial.motion, [_shape_of(point) for point in points])
        return [each.values[SIZE] * column for each, column in zip(points, columns.T, strict=True)]
    before, after = present[:index], present[index + 1 :]
    plain = output_beside(trial.model, [*before, *after], trial.motion)
    return [output_beside(trial.model, [*before, point, *after], trial.motion) - plain for point in points]


def _shape_of(effect: FittedEffect) -> dict[str, float]:
    """Return the values of an effect without its amplitude."""
    return {name: value for name, value in effect.values.items() if name != SIZE}


def _moved(effect: FittedEffect, name: str) -> tuple[FittedEffect, float]:
    """Return an effect with one coordinate moved for a numerical derivative, and the step, negative at a bound."""
    value = effect.values[name]
    step = _numerical_step(effect.effect.parameters[name], name, value)
    moved = shifted(effect, name, step)
    return (shifted(effect, name, -step), -step) if moved.values[name] == value else (moved, step)


def relative_step(model: Model, name: str) -> float:
    """Return the relative change of a positive parameter for a numerical derivative; at its upper bound a decrease."""
    return (
        RELATIVE_STEP
        if getattr(model, name) * (1 + RELATIVE_STEP) <= model.parameters()[name].upper
        else -RELATIVE_STEP
    )


def _numerical_step(what: Parameter, name: str, value: float) -> float:
    """Return the change of a fit coordinate for a numerical derivative."""
    if what.scale is Scale.LOG:
        return RELATIVE_STEP
    if name == SIZE:
        return RELATIVE_STEP * max(abs(value), 1e-3 * what.typical) / what.typical
    return LINEAR_STEP


def shifted(effect: FittedEffect, name: str, step: float, trial: int | None = None) -> FittedEffect:
    """Return the effect with the fit coordinate of the parameter `name` increased by `step`.

    The fit coordinate is the logarithm of the value, or the value divided by its typical value if the scale is linear.
    The new value is clipped to the bounds of the parameter. If `trial` is given, only the value in this trial changes.
    """
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
