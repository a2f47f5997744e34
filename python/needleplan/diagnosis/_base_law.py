"""The law tolerance of the base: friction and cutting force that depend otherwise on depth, force, direction and speed.

The axial force of the base is S + C, friction along the shaft and cutting force. Both laws are lumped: the density of
the friction is even, the cutting force comes up exponentially, and both depend on the direction by the bristle alone.
Each column here is S, C or their sum times a function of one variable, with a standard normal coefficient that all
trials share. Mathematics: equations (1) and (2) of docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from functools import cache, lru_cache

import numpy as np

from needleplan.diagnosis._constants import (
    BASE_DEPTHS,
    BASE_FORCES,
    BASE_SPEEDS,
    DEVIATES_FROM,
    DEVIATES_TO,
    ENTRY_CORRELATION,
    ENTRY_LEAST,
    ENTRY_MODES,
    NODES,
    RIM_LAW,
    RIMS_MM,
    SPEED_LAW,
)
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis._tangents import is_added, output_beside, relative_step
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models import simulate
from needleplan.models.effects import Reach
from needleplan.models.friction import LawCurves, ShaftAndTip, mean_speed
from needleplan.signals import Array, Motion

__all__ = [
    "LAW_COUNTS", "Law", "base_forces", "base_laws", "decaying", "full_cutting", "law_columns",
    "law_curves", "law_functions", "leading_modes",
]  # fmt: skip


class Law(StrEnum):
    """Law that has a tolerance with a scale of its own: those of the base, and those of the effects together."""

    REVERSAL = "reversal"
    MEMORY = "memory"
    DEPTH = "depth"
    FORCE = "force"
    SPEED = "speed"
    ENTRY = "entry"
    EFFECTS = "effects"


LAW_COUNTS = {
    Law.DEPTH: BASE_DEPTHS, Law.FORCE: BASE_FORCES + 2, Law.SPEED: 2 * BASE_SPEEDS,
    Law.ENTRY: ENTRY_MODES + len(RIMS_MM),
}  # fmt: skip
"""Number of functions of each law, in the order of the columns."""
_PLACES = np.linspace(math.log(ENTRY_LEAST), math.log(100.0), 90)


def law_columns(functions: Array, shaft_n: Array, tip_n: Array, full_n: Array) -> Array:
    """Return the change of the axial force (N) by each function of `law_functions`, shape (samples, functions).

    `shaft_n` is the friction along the shaft, `tip_n` the cutting force, and `full_n` the cutting force of a tip that
    is always loaded, shape (samples,) each.
    """
    return np.asarray((shaft_n * functions[0] + tip_n * functions[1] + full_n * functions[2]).T)


def base_laws(
    trial: CalibratedTrial, effects: Sequence[FittedEffect], reach: Reach, largest_n: float, settings: Settings
) -> Array:
    """Return the columns A of equation (1) for one trial, shape (samples, functions).

    A column is the change of the axial force (N) if the friction law or the cutting law of the base model deviates by
    one function of depth, force or speed. The friction S and cutting force C that the functions multiply are computed
    with the effects present. `reach` has the ranges of depth and speed of all trials; the functions of the force extend
    from -`largest_n` to `largest_n` (N). A base model without friction and cutting force has no columns.
    """
    model, motion = trial.model, trial.motion
    if not isinstance(model, ShaftAndTip):
        return np.zeros((len(trial.measured), 0))
    shaft, tip = base_forces(model, effects, motion)
    functions = law_functions(model, motion, shaft, tip, reach, largest_n, settings)
    return law_columns(functions, shaft, tip, full_cutting(model, motion))


def full_cutting(model: ShaftAndTip, motion: Motion) -> Array:
    """Return the cutting force (N) of a tip that is always loaded, shape (samples,)."""
    return np.asarray(-model.cutting * np.expm1(-np.maximum(motion.depth_mm, 0.0) / model.onset_mm))


def law_functions(
    model: ShaftAndTip, motion: Motion, shaft_n: Array, tip_n: Array, reach: Reach, largest_n: float, settings: Settings
) -> Array:
    """Return the functions by which the laws of the base may deviate, shape (3, functions, samples).

    Index 0 of the first axis multiplies the friction along the shaft, index 1 the cutting force, and index 2 the
    cutting force of a tip that is always loaded. `shaft_n` and `tip_n` are the first two forces (N), shape (samples,).
    The other parameters are described in `base_laws`.
    """
    depth = np.maximum(motion.depth_mm, 0.0)
    onsets, rims = _along_depth(depth.tobytes(), model.onset_mm)
    along = _cosines(depth / max(reach.depth_mm[1], model.onset_mm), BASE_DEPTHS)
    pushed = _cosines((np.clip((shaft_n + tip_n) / largest_n, -1.0, 1.0) + 1) / 2, BASE_FORCES)
    series = (np.asarray(values, float).tobytes() for values in (motion.velocity_mm_s, motion.depth_mm))
    speed = _along_speed(*series, reach.speed_mm_s)
    one, law, entry = np.ones(len(depth)), settings.base_law, settings.entry_law
    rows: list[tuple[Array | float, Array | float, Array | float]] = [
        *((law * function, 0.0, 0.0) for function in along),
        *((law * function, law * function, 0.0) for function in pushed),
        (law * np.sign(shaft_n), 0.0, 0.0),
        (0.0, -law, law),
        *((law * function, 0.0, 0.0) for function in speed),
        *((0.0, law * function, 0.0) for function in speed),
        *((0.0, entry * function, 0.0) for function in onsets),
        *((entry * function, 0.0, 0.0) for function in rims),
    ]
    return np.array([[one * factors[force] for factors in rows] for force in range(3)])


@lru_cache(maxsize=32)
def _along_depth(depth_mm: bytes, onset_mm: float) -> tuple[Array, Array]:
    """Return the deviations of cutting force and friction at the entry, as shares of these forces, by depth.

    The shapes are (modes, samples) and (lengths, samples). The depths are a byte string, so that the result can be
    cached: a fit repeats them. The arrays are read-only. Shares are bounded, because breathing tissue gives forces
    where the depth of the motion is 0.
    """
    depth = np.frombuffer(depth_mm)
    place = np.log(np.maximum(depth / onset_mm, ENTRY_LEAST))
    onsets = np.array([np.interp(place, _PLACES, mode) for mode in _modes()]) / -np.expm1(-np.exp(place))
    lengths = depth / np.array(RIMS_MM)[:, None]
    rims = np.asarray(RIM_LAW * -np.expm1(-lengths) / np.maximum(lengths, 1e-9))
    for deviations in (onsets, rims):
        deviations.flags.writeable = False
    return onsets, rims


def law_curves(
    model: ShaftAndTip, coefficients: Mapping[Law, Array], reach: Reach, largest_n: float, settings: Settings
) -> LawCurves:
    """Return the deviations of the laws of a base model, as curves of friction and cutting force.

    Parameters
    ----------
    model
        The base model.
    coefficients
        Coefficients of the functions of `law_functions`, by law; a law that is left out does not deviate.
    reach, largest_n, settings
        As in `base_laws`.

    Returns
    -------
    LawCurves
        The curves, which are added to those of the model.
    """
    own = {law: coefficients.get(law, np.zeros(count)) for law, count in LAW_COUNTS.items()}
    deepest, law = max(reach.depth_mm[1], model.onset_mm), settings.base_law
    depth = np.unique([*np.geomspace(ENTRY_LEAST * model.onset_mm, deepest, NODES), *np.linspace(0, deepest, NODES)])
    onsets, rims = _along_depth(depth.tobytes(), model.onset_mm)
    entry, speed = settings.entry_law * own[Law.ENTRY], np.geomspace(*reach.speed_mm_s, NODES)
    of_friction, of_cutting = law * own[Law.SPEED].reshape(2, -1) @ _speed_cosines(speed, reach.speed_mm_s)
    *by_force, direction, pulled = (law * own[Law.FORCE]).tolist()
    force = np.linspace(-largest_n, largest_n, NODES)
    along = law * own[Law.DEPTH] @ _cosines(depth / deepest, BASE_DEPTHS)
    return LawCurves(
        depth_mm=tuple(depth.tolist()),
        friction_by_depth=tuple((along + entry[ENTRY_MODES:] @ rims).tolist()),
        cutting_by_depth=tuple((entry[:ENTRY_MODES] @ onsets).tolist()),
        speed_mm_s=tuple(speed.tolist()),
        friction_by_speed=tuple(of_friction.tolist()),
        cutting_by_speed=tuple(of_cutting.tolist()),
        force_n=tuple(force.tolist()),
        both_by_force=tuple((np.array(by_force) @ _cosines((force / largest_n + 1) / 2, BASE_FORCES)).tolist()),
        friction_by_direction=direction,
        cutting_pulled=pulled,
    )


@lru_cache(maxsize=32)
def _along_speed(velocity_mm_s: bytes, depth_mm: bytes, reach_mm_s: tuple[float, float]) -> Array:
    """Return the cosines of the logarithm of the speed, times their standard deviations, shape (cosines, samples).

    The speed is averaged over the travel, within the range `reach_mm_s` of the trials.
    """
    speed = mean_speed(np.frombuffer(velocity_mm_s), np.frombuffer(depth_mm), reach_mm_s)
    cosines = _speed_cosines(speed, reach_mm_s)
    cosines.flags.writeable = False
    return cosines


def _speed_cosines(speed_mm_s: Array, reach_mm_s: tuple[float, float]) -> Array:
    slow, fast = np.log(reach_mm_s)
    return SPEED_LAW * _cosines(np.clip((np.log(speed_mm_s) - slow) / max(fast - slow, 1e-6), 0.0, 1.0), BASE_SPEEDS)


@cache
def _modes() -> Array:
    """Return the deviations of the rise of the cutting force with depth, at `_PLACES`, shape (modes, places)."""
    envelope, apart = decaying(np.exp(_PLACES)), math.sqrt(3) * np.abs(_PLACES[:, None] - _PLACES) / ENTRY_CORRELATION
    return leading_modes(np.outer(envelope, envelope) * (1 + apart) * np.exp(-apart), ENTRY_MODES).T


def decaying(places: Array) -> Array:
    """Return the standard deviation of a law's deviation: it grows from 0 and decays as the inverse place.

    The places are depths in onset lengths, or travels in presliding lengths.
    """
    return np.asarray(-np.expm1(-places / DEVIATES_FROM) / (1 + places / DEVIATES_TO))


def leading_modes(covariance: Array, count: int) -> Array:
    """Return the leading modes of a covariance (n, n), scaled to their standard deviations, shape (n, count)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0)))[:, : -count - 1 : -1])


def _cosines(place: Array, count: int) -> Array:
    """Return cosines of a place from 0 to 1, the finer the smaller, shape (count, samples)."""
    number = np.arange(1, count + 1)[:, None]
    return np.asarray(np.cos(math.pi * number * place) / number)


def base_forces(model: ShaftAndTip, effects: Sequence[FittedEffect], motion: Motion) -> tuple[Array, Array]:
    """Return friction along the shaft and cutting force (N) with the effects present, shape (samples,) each."""
    if all(is_added(effect) for effect in effects):
        state = simulate(model, motion).states
        return model.shaft_n(state, motion), model.tip_n(state, motion)
    plain, forces = output_beside(model, effects, motion), []
    for name in ("friction", "cutting"):
        step = relative_step(model, name)
        varied = model.with_values(**{name: (1 + step) * getattr(model, name)})
        forces.append((output_beside(varied, effects, motion) - plain) / step)
    return forces[0], forces[1]
