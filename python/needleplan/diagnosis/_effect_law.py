"""The law tolerance of the effects: a formula may be wrong along depth, time and speed, in a trial, and in its shape.

Each column is a change of the output, with a standard normal coefficient.
Mathematics: equation (4) of docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needleplan.diagnosis._constants import (
    CLOCK_RAD,
    EDGE_LAW,
    EDGES_MM,
    EFFECT_DEPTHS,
    EFFECT_SPEEDS,
    EFFECT_TIMES,
    OTHER_SCALE,
)
from needleplan.diagnosis._problem import UNIFORM
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis._tangents import Coordinate, in_trial, outputs_at, shifted
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import GapAxis
from needleplan.models import Scale, recurrence
from needleplan.models.effects import SIZE
from needleplan.signals import Array, Motion

__all__ = ["AXES", "COSINES", "effect_laws", "law_tolerance", "rms"]

AXES = {
    "puncture": GapAxis.DEPTH, "cutting_layer": GapAxis.DEPTH, "fresh_cutting": GapAxis.DEPTH,
    "cutting_with_depth": GapAxis.DEPTH, "friction_layer": GapAxis.DEPTH, "bump": GapAxis.DEPTH,
    "cutting_speed": GapAxis.SPEED, "stribeck": GapAxis.SPEED, "viscous": GapAxis.SPEED, "relaxation": GapAxis.DWELL,
    "drift": GapAxis.TIME, "thermal_drift": GapAxis.TIME, "bias": GapAxis.TIME, "path_damage": GapAxis.TIME,
    "respiration": GapAxis.TIME, "gain_error": GapAxis.FORCE,
    "inertia": GapAxis.ACCELERATION,
}  # fmt: skip
"""Axis of the law of effects of the axial force; effects that are not listed have no such axis."""

COSINES = EFFECT_DEPTHS + EFFECT_TIMES + EFFECT_SPEEDS
"""Number of cosines of an effect's law, along depth, time and speed."""

# Effects whose tolerance is that of the base's law of reversal: modulated, they would only make this law more flexible.
_UNMODULATED = ("bristle", "latency", "tissue_motion")


def effect_laws(
    effects: Sequence[FittedEffect],
    trials: Sequence[CalibratedTrial],
    settings: Settings,
    coordinates: Sequence[Coordinate],
    local: Sequence[tuple[list[Array], list[Array]]],
) -> tuple[list[Array], list[slice]]:
    """Return the columns L of equation (1), the law tolerances of all effects, one array per trial.

    Also returns which of them are the cosines of equation (4), for each effect. An array has the shape
    (axes * samples, functions). A column is a change of the output with a standard normal coefficient.
    Each effect has these columns:

    - the functions of `law_tolerance`;
    - the output change if one of its widths, times or speeds has another scale (`_other_scales`);
    - the derivative by each place, time and rate, scaled to the RMS of the effect's output;
    - the derivative by a phase that all trials share, in one trial alone.

    `local` holds for each trial the outputs of the effects and the derivatives of the output by the `coordinates`.
    """
    columns: list[list[Array]] = [[] for _ in trials]
    cosines: list[slice] = []
    for index, effect in enumerate(effects):
        outputs = [trial_outputs[index] for trial_outputs, _ in local]
        modulated = effect.name not in _UNMODULATED
        laws = law_tolerance(outputs, trials, settings, AXES.get(effect.name), modulated=modulated)
        first = sum(np.atleast_2d(each.T).shape[0] for each in columns[0])
        cosines.append(slice(first, first + modulated * COSINES))
        rows = [
            row for row, coordinate in enumerate(coordinates)
            if coordinate.effect == index and coordinate.name != SIZE
        ]  # fmt: skip
        to_output_rms = {row: rms(outputs) / max(rms([tangents[row] for _, tangents in local]), 1e-300) for row in rows}
        shared_phases = [
            row for row in rows
            if coordinates[row].trial is None and effect.effect.parameters[coordinates[row].name].unit == "rad"
        ]  # fmt: skip
        for number, (trial, (_, tangents)) in enumerate(zip(trials, local, strict=True)):
            changes = _other_scales(effects, index, trial, number)
            changes += [to_output_rms[row] * tangents[row] for row in rows]
            columns[number] += [laws[number], *(settings.law_along_axis * change for change in changes)]
            columns[number] += [
                CLOCK_RAD * tangents[row] * (number == single) for row in shared_phases for single in range(len(trials))
            ]
    return [np.column_stack(trial_columns) for trial_columns in columns], cosines


def _other_scales(effects: Sequence[FittedEffect], index: int, trial: CalibratedTrial, number: int) -> list[Array]:
    """Return the output changes if a width, time or speed of one effect were shorter or longer by a factor.

    A law of another shape, such as a Gaussian instead of an exponential function, is a blend of these outputs. In a
    reference trial, an effect that the given model lacks has zero changes.
    """
    effect, present = effects[index].in_trial(number), in_trial(effects, trial, number)
    names = [
        name for name, parameter in effect.effect.parameters.items()
        if parameter.free and name != SIZE and parameter.scale is Scale.LOG and parameter.unit != "Hz"
    ]  # fmt: skip
    if trial.is_reference and not effect.given:
        return [np.zeros(len(trial.output))] * (2 * len(names))
    if not names:
        return []
    points = [effect, *(shifted(effect, name, step) for name in names for step in (-OTHER_SCALE, OTHER_SCALE))]
    output, *varied_outputs = outputs_at(present, present.index(effect), points, trial)
    return [varied - output for varied in varied_outputs]


def law_tolerance(
    outputs: Sequence[Array],
    trials: Sequence[CalibratedTrial],
    settings: Settings,
    axis: GapAxis | None = None,
    *,
    modulated: bool = True,
) -> list[Array]:
    """Return the output changes by which the law of one effect may be wrong, one array per trial.

    An array has the shape (axes * samples, functions); the coefficient of a column is standard normal. The columns are:

    - the output times cosines along depth, time and speed, equation (4). The argument is the share of the output's
      energy below a depth, time or speed, so that the cosines resolve the place where the effect acts;
    - the output in one trial alone;
    - a delay and a blur of the output by a share of a sample interval;
    - for an `axis` of depth, an output that follows the tip only after some travel.

    An effect that is not `modulated`, such as a delay, has no cosines, delay or blur. `outputs` are the outputs of the
    effect by trial, shape (axes * samples,). The cosines along `axis` have a larger standard deviation.
    """
    axes = len(outputs[0]) // len(trials[0].motion)
    energies = [(output**2).reshape(axes, -1).sum(axis=0) for output in outputs]
    modulations: list[list[Array]] = [[] for _ in trials]
    variables = (
        (GapAxis.DEPTH, "depth_mm", EFFECT_DEPTHS),
        (GapAxis.TIME, "time_s", EFFECT_TIMES),
        (GapAxis.SPEED, "velocity_mm_s", EFFECT_SPEEDS),
    )
    for variable_axis, variable, count in variables if modulated else ():
        sd = settings.law_along_axis if variable_axis is axis else settings.law_tolerance
        values = [np.abs(getattr(trial.motion, variable)) for trial in trials]
        pooled, weights = np.concatenate(values), np.concatenate(energies)
        order = np.argsort(pooled)
        shares = np.cumsum(weights[order]) / max(float(weights.sum()), 1e-300)
        for cosines, trial_values in zip(modulations, values, strict=True):
            energy_share = np.interp(trial_values, pooled[order], shares)
            cosines += [np.cos(math.pi * n * energy_share) * sd / math.sqrt(n) for n in range(1, count + 1)]
    result = []
    for number, (cosines, output) in enumerate(zip(modulations, outputs, strict=True)):
        alone = [
            np.full(len(trials[number].motion), settings.trial_tolerance * (number == single))
            for single in range(len(trials))
        ]
        columns = output[:, None] * np.tile(np.column_stack([*cosines, *alone]), (axes, 1))
        slope: Array = np.asarray(np.gradient(output.reshape(axes, -1), axis=1), float)
        curve: Array = np.asarray(np.gradient(slope, axis=1), float)
        blur = [UNIFORM * slope, UNIFORM * curve] if modulated else []
        edges = _soft_edges(trials[number].motion, output) if axis is GapAxis.DEPTH else []
        result.append(np.column_stack([columns, *(change.ravel() for change in blur), *edges]))
    return result


def _soft_edges(motion: Motion, output: Array) -> list[Array]:
    """Return the changes of the output if the effect follows the tip only after some travel, as a tearing membrane."""
    travel = np.abs(np.diff(motion.depth_mm))
    changes = []
    for length in EDGES_MM:
        keep = np.exp(-travel / length)
        changes.append(EDGE_LAW * (recurrence(keep, (1 - keep) * output[1:], output[0]) - output))
    return changes


def rms(parts: Sequence[Array]) -> float:
    """Return the RMS of several arrays together."""
    return math.sqrt(sum(float(part @ part) for part in parts) / sum(map(len, parts)))
