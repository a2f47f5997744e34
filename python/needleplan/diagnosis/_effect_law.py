"""The law tolerance of the effects: a formula may be wrong along depth, time and speed, in a trial, and in its shape.

Each column is a change of the output, with a standard normal coefficient.
Mathematics: docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needleplan.diagnosis._problem import UNIFORM
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis._tangents import Coordinate, in_trial, outputs_at, shifted
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import GapAxis
from needleplan.models import Scale, recurrence
from needleplan.models.effects import SIZE
from needleplan.signals import Array, Motion

__all__ = ["AXES", "effect_laws", "law_tolerance", "rms"]

AXES = {
    "puncture": GapAxis.DEPTH, "cutting_layer": GapAxis.DEPTH, "fresh_cutting": GapAxis.DEPTH,
    "cutting_with_depth": GapAxis.DEPTH, "friction_layer": GapAxis.DEPTH, "bump": GapAxis.DEPTH,
    "stribeck": GapAxis.SPEED, "viscous": GapAxis.SPEED, "relaxation": GapAxis.DWELL,
    "drift": GapAxis.TIME, "thermal_drift": GapAxis.TIME, "bias": GapAxis.TIME, "path_damage": GapAxis.TIME,
    "respiration": GapAxis.TIME, "gain_error": GapAxis.FORCE,
    "inertia": GapAxis.ACCELERATION,
}  # fmt: skip
"""Axis of the law of effects of the axial force; effects that are not listed have no such axis."""

# Effects whose tolerance is that of the base's law of reversal: modulated, they would only make this law more flexible.
_UNMODULATED = ("bristle", "latency", "tissue_motion")
# Modulations of an effect's law along depth, time and speed.
_DEPTHS, _TIMES, _SPEEDS = 4, 3, 3
# Logarithm of the factor between the scales of which a law's shape is blended.
_OTHER = 0.9
# Standard deviation (rad) of the phase of a single trial beside that of all trials.
_CLOCK_RAD = 0.1
# Travels (mm) over which an effect at a depth may follow the tip, and standard deviation of each of these shares.
_EDGES_MM, _EDGE = (0.25, 0.5, 1.0), 0.5


def effect_laws(
    effects: Sequence[FittedEffect],
    trials: Sequence[CalibratedTrial],
    settings: Settings,
    coordinates: Sequence[Coordinate],
    local: Sequence[tuple[list[Array], list[Array]]],
) -> list[Array]:
    """Return the columns of the law tolerances of all effects by trial, (axes * samples, functions).

    `local` holds outputs of the effects and derivatives by the coordinates, by trial. Beside the functions of
    `law_tolerance`, the widths, times and speeds of an effect may be others, its places, times and rates may move, each
    as far as changes the output by its own RMS, and the phase of a single trial may differ.
    """
    found: list[list[Array]] = [[] for _ in trials]
    for index, each in enumerate(effects):
        outputs = [own[index] for own, _ in local]
        laws = law_tolerance(
            outputs, trials, settings, AXES.get(each.name), modulated=each.name not in _UNMODULATED
        )  # fmt: skip
        rows = [row for row, (which, name, _) in enumerate(coordinates) if which == index and name != SIZE]
        same = {row: rms(outputs) / max(rms([tangents[row] for _, tangents in local]), 1e-300) for row in rows}
        phases = [
            row for row in rows
            if coordinates[row].trial is None and each.effect.parameters[coordinates[row].name].unit == "rad"
        ]  # fmt: skip
        for number, (trial, (_, tangents)) in enumerate(zip(trials, local, strict=True)):
            others = [*_other_scales(effects, index, trial, number), *(same[row] * tangents[row] for row in rows)]
            found[number] += [laws[number], *(settings.law_along_axis * other for other in others)]
            found[number] += [
                _CLOCK_RAD * tangents[row] * (number == only) for row in phases for only in range(len(trials))
            ]
    return [np.column_stack(each) for each in found]


def _other_scales(effects: Sequence[FittedEffect], index: int, trial: CalibratedTrial, number: int) -> list[Array]:
    """Return the output changes if an effect's own widths, times or speeds were a factor shorter or longer.

    A law of another shape, such as a Gaussian instead of an exponential function, is a blend of these. What a
    reference lacks does not change.
    """
    each, beside = effects[index].in_trial(number), in_trial(effects, trial, number)
    names = [
        name for name, what in each.effect.parameters.items()
        if what.free and name != SIZE and what.scale is Scale.LOG and what.unit != "Hz"
    ]  # fmt: skip
    if trial.is_reference and not each.given:
        return [np.zeros(len(trial.output))] * (2 * len(names))
    if not names:
        return []
    points = [each, *(shifted(each, name, step) for name in names for step in (-_OTHER, _OTHER))]
    whole, *others = outputs_at(beside, beside.index(each), points, trial)
    return [other - whole for other in others]


def law_tolerance(
    outputs: Sequence[Array],
    trials: Sequence[CalibratedTrial],
    settings: Settings,
    axis: GapAxis | None = None,
    *,
    modulated: bool = True,
) -> list[Array]:
    """Return the columns of an effect's law tolerance by trial, each of prior variance 1, (axes * samples, functions).

    The columns are the effect's output times cosines of depth, time and speed, the output in each trial alone, and its
    first and second differences by a share of a sample interval, which delay and blur it. The
    argument of the cosines is the share of the effect's energy below a depth, time or speed: where the effect acts at
    one place, they resolve this place. An effect that is not `modulated`, such as a delay, has single
    trials only.
    """
    axes = len(outputs[0]) // len(trials[0].motion)
    energies = [(each**2).reshape(axes, -1).sum(axis=0) for each in outputs]
    found: list[list[Array]] = [[] for _ in trials]
    variables = (
        (GapAxis.DEPTH, "depth_mm", _DEPTHS),
        (GapAxis.TIME, "time_s", _TIMES),
        (GapAxis.SPEED, "velocity_mm_s", _SPEEDS),
    )
    for own_axis, variable, count in variables if modulated else ():
        sd = settings.law_along_axis if own_axis is axis else settings.law_tolerance
        values = [np.abs(getattr(trial.motion, variable)) for trial in trials]
        every, weights = np.concatenate(values), np.concatenate(energies)
        order = np.argsort(every)
        shares = np.cumsum(weights[order]) / max(float(weights.sum()), 1e-300)
        for own, each in zip(found, values, strict=True):
            place = np.interp(each, every[order], shares)
            own += [np.cos(math.pi * n * place) * sd / math.sqrt(n) for n in range(1, count + 1)]
    result = []
    for number, (own, output) in enumerate(zip(found, outputs, strict=True)):
        alone = [
            np.full(len(trials[number].motion), settings.trial_tolerance * (number == other))
            for other in range(len(trials))
        ]
        columns = output[:, None] * np.tile(np.column_stack([*own, *alone]), (axes, 1))
        slope: Array = np.asarray(np.gradient(output.reshape(axes, -1), axis=1), float)
        curve: Array = np.asarray(np.gradient(slope, axis=1), float)
        blur = [UNIFORM * slope, UNIFORM * curve] if modulated else []
        edges = _soft_edges(trials[number].motion, output) if axis is GapAxis.DEPTH else []
        result.append(np.column_stack([columns, *(each.ravel() for each in blur), *edges]))
    return result


def _soft_edges(motion: Motion, output: Array) -> list[Array]:
    """Return the changes of an output that follows the tip only after some travel, such as a membrane that tears."""
    travel = np.abs(np.diff(motion.depth_mm))
    found = []
    for length in _EDGES_MM:
        keep = np.exp(-travel / length)
        found.append(_EDGE * (recurrence(keep, (1 - keep) * output[1:], output[0]) - output))
    return found


def rms(parts: Sequence[Array]) -> float:
    """Return the RMS of several arrays together."""
    return math.sqrt(sum(float(each @ each) for each in parts) / sum(map(len, parts)))
