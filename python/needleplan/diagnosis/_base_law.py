"""The law tolerance of the base: friction and cutting force that depend otherwise on depth, force, direction and speed.

The axial force of the base is S + C, friction along the shaft and cutting force. Both laws are lumped: the density of
the friction is even, the cutting force comes up exponentially, and both depend on the direction by the bristle alone.
Each column here is S, C or their sum times a function of one variable, with a standard normal coefficient that all
trials share. Mathematics: docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from functools import cache, lru_cache

import numpy as np

from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis._tangents import is_added, relative_step, with_effects
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models import recurrence, simulate
from needleplan.models.effects import Reach
from needleplan.models.friction import ShaftAndTip
from needleplan.signals import Array, Motion

__all__ = ["LAW_COUNTS", "OWN_LAW", "Law", "base_laws"]


class Law(StrEnum):
    """Law that has a tolerance with a scale of its own: those of the base, and those of the effects together."""

    REVERSAL = "reversal"
    DEPTH = "depth"
    FORCE = "force"
    SPEED = "speed"
    ENTRY = "entry"
    EFFECTS = "effects"


# Standard deviations of the laws along the speed, and of all laws in a single trial, in units of that of the laws along
# depth, force and direction.
_SPEED, OWN_LAW = 0.2, 0.15
# Standard deviation of the friction density at the entry, in units of that of the rise of the cutting force, and depths
# (mm) over which its deviations decay: the tissue is dimpled there, or does not touch the shaft.
_RIM, _RIMS_MM = 2.5, (0.5, 1.0, 2.0, 4.0)
# Number of cosines along depth, force and speed.
_DEPTHS, _FORCES, _SPEEDS = 4, 3, 2
# Depth (onset lengths) from which the rise of the cutting force may deviate, and from which the deviation decays as the
# inverse depth; correlation length of the deviation (in the logarithm of the depth), and number of modes. A Matern
# process with one derivative: real laws have kinks.
_FROM, _TO, _CORRELATION, _MODES = 0.3, 3.0, 0.9, 14
LAW_COUNTS = {
    Law.DEPTH: _DEPTHS, Law.FORCE: _FORCES + 2, Law.SPEED: 2 * _SPEEDS, Law.ENTRY: _MODES + len(_RIMS_MM),
}  # fmt: skip
"""Number of functions of each law, in the order of the columns."""
# Logarithms of the depths (onset lengths) between which the modes are interpolated.
_PLACES = np.linspace(math.log(0.02), math.log(100.0), 90)
# Travel (mm) over which the speed is averaged: at rest, friction keeps the value of the movement before.
_TRAVEL_MM = 0.5


def base_laws(
    trial: CalibratedTrial, effects: Sequence[FittedEffect], reach: Reach, largest_n: float, settings: Settings
) -> Array:
    """Return the change of the output by each function of the law tolerance of the base, shape (samples, functions).

    Parameters
    ----------
    trial
        The trial; its base model is the point at which the columns are linear.
    effects
        Effects beside which the base acts.
    reach
        Ranges of depth and speed of all trials.
    largest_n
        Force (N) to which the axis of the force extends in both directions.
    settings
        Standard deviations of the tolerance.
    """
    model, motion = trial.model, trial.motion
    if not isinstance(model, ShaftAndTip):
        return np.zeros((len(trial.measured), 0))
    shaft, tip = _parts(model, effects, motion)
    depth = np.maximum(motion.depth_mm, 0.0)
    risen, onsets, rims = _along_depth(depth.tobytes(), model.onset_mm)
    along = _cosines(depth / max(reach.depth_mm[1], model.onset_mm), _DEPTHS)
    force = shaft + tip
    pushed = _cosines((np.clip(force / largest_n, -1.0, 1.0) + 1) / 2, _FORCES)
    moved = (np.asarray(each, float).tobytes() for each in (motion.velocity_mm_s, motion.depth_mm))
    speed = _along_speed(*moved, reach.speed_mm_s)
    anywhere = [shaft * along, force * pushed, np.abs(shaft), model.cutting * risen - tip, shaft * speed, tip * speed]
    entry = [tip / np.maximum(risen, 1e-9) * onsets, shaft / np.maximum(depth, 1e-6) * rims]
    return np.vstack(
        [*(settings.base_law * each for each in anywhere), *(settings.entry_law * each for each in entry)]
    ).T


@lru_cache(maxsize=32)
def _along_depth(depth_mm: bytes, onset_mm: float) -> tuple[Array, Array, Array]:
    """Return the rise of the cutting force, its deviations, and those of the friction at the entry (mm).

    The shapes are (samples,), (modes, samples) and (lengths, samples). The depths are a byte string, so that the result
    can be cached: a fit repeats them. The arrays are read-only.
    """
    depth = np.frombuffer(depth_mm)
    place = np.log(np.maximum(depth / onset_mm, 0.02))
    onsets = np.array([np.interp(place, _PLACES, each) for each in _modes()])
    lengths = np.array(_RIMS_MM)[:, None]
    risen, rims = np.asarray(-np.expm1(-depth / onset_mm)), np.asarray(-_RIM * lengths * np.expm1(-depth / lengths))
    for each in (risen, onsets, rims):
        each.flags.writeable = False
    return risen, onsets, rims


@lru_cache(maxsize=32)
def _along_speed(velocity_mm_s: bytes, depth_mm: bytes, reach_mm_s: tuple[float, float]) -> Array:
    """Return the cosines of the logarithm of the speed, times their standard deviations, shape (cosines, samples)."""
    slow, fast = np.log(reach_mm_s)
    mean = _speed(np.frombuffer(velocity_mm_s), np.frombuffer(depth_mm), reach_mm_s)
    found = _SPEED * _cosines(np.clip((np.log(mean) - slow) / max(fast - slow, 1e-6), 0.0, 1.0), _SPEEDS)
    found.flags.writeable = False
    return found


@cache
def _modes() -> Array:
    """Return the deviations of the rise of the cutting force with depth, at `_PLACES`, shape (modes, places)."""
    depth = np.exp(_PLACES)
    envelope = -np.expm1(-depth / _FROM) / (1 + depth / _TO)
    apart = math.sqrt(3) * np.abs(_PLACES[:, None] - _PLACES) / _CORRELATION
    values, vectors = np.linalg.eigh(np.outer(envelope, envelope) * (1 + apart) * np.exp(-apart))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T[: -_MODES - 1 : -1])


def _cosines(place: Array, count: int) -> Array:
    """Return cosines of a place from 0 to 1, the finer the smaller, shape (count, samples)."""
    number = np.arange(1, count + 1)[:, None]
    return np.asarray(np.cos(math.pi * number * place) / number)


def _parts(model: ShaftAndTip, effects: Sequence[FittedEffect], motion: Motion) -> tuple[Array, Array]:
    """Return friction along the shaft and cutting force (N) beside the effects, shape (samples,) each."""
    if all(is_added(each) for each in effects):
        state = simulate(model, motion).states
        return model.shaft_n(state, motion), model.tip_n(state, motion)

    def output(each: ShaftAndTip) -> Array:
        return simulate(with_effects(each, effects), motion).output

    plain, found = output(model), []
    for name in ("friction", "cutting"):
        step = relative_step(model, name)
        found.append((output(model.with_values(**{name: (1 + step) * getattr(model, name)})) - plain) / step)
    return found[0], found[1]


def _speed(velocity_mm_s: Array, depth_mm: Array, reach_mm_s: tuple[float, float]) -> Array:
    """Return the speed (mm/s) averaged over the travel, within the range of the trials, shape (samples,)."""
    speed = np.clip(np.abs(velocity_mm_s), *reach_mm_s)
    keep = np.exp(-np.abs(np.diff(depth_mm)) / _TRAVEL_MM)
    return np.clip(recurrence(keep, (1 - keep) * speed[1:], float(speed[0])), *reach_mm_s)
