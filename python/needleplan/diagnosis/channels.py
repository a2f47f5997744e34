"""Channels that can be diagnosed: the axial force and the position of the tip.

A `ChannelDescription` states how heterogeneous tissue changes the channel's output, and the priors of parameters.
Heterogeneous tissue is a random function of depth. To support another channel, add its description to `_CHANNELS`, and
the smooth functions that compete with effects to `_components`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.diagnosis._constants import (
    ACROSS_RATIO,
    FORCE_LAG_S,
    FORCE_PRIORS,
    MOST_MODES,
    ROUGH_MM,
    SMOOTH_MM,
    TIP_LAG_S,
    TIP_PRIORS,
    TISSUE_GRID_MM,
    TISSUE_VARIANCE,
)
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel, Model, simulate
from needleplan.models.path import bevel_direction, path_displacement
from needleplan.signals import Array, Motion

__all__ = [
    "ROUGH_MM",
    "SMOOTH_MM",
    "ChannelDescription",
    "GapAxis",
    "at_depth",
    "channel_description",
    "curvature_of",
    "felt_mm_of",
    "tissue_modes",
]

# Parameters of the entry pose; the path is linear in them.
_ENTRY_PARAMETERS = ("heading_y_rad", "heading_z_rad", "entry_x_mm", "entry_y_mm", "entry_z_mm")


class GapAxis(StrEnum):
    """Variable on which a gap depends. The values are those of `diagnosis.json`."""

    TIME = "time"
    DEPTH = "depth"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    FORCE = "force"
    DWELL = "hold"
    PERIOD = "position_periodic"
    ANGLE = "angle"

    @property
    def label(self) -> str:
        """Name of the variable in reports."""
        return {"hold": "dwell time", "position_periodic": "position"}.get(self.value, self.value)


@dataclass(frozen=True)
class ChannelDescription(CallRepr):
    """Properties of a measured quantity that the diagnosis uses."""

    usual_lag_s: float
    """Prior standard deviation (s) of the sensor lag; 0 for a sensor without lag."""

    priors: Mapping[str, float]
    """Prior standard deviation of fit coordinates by parameter; other parameters have a default of about a factor 2."""

    modes: Callable[[Model, Motion], tuple[Array, ...]]
    """Returns the output change by each heterogeneity mode at standard deviation 1, shape (axes * samples, modes), for
    each kind of tissue: rough and smooth."""

    linear_parameters: tuple[str, ...] = ()
    """Well known parameters that enter linearly: they keep their values in a calibration and are only linearised."""


def at_depth(depth_mm: Array, places: Array, rows: Array) -> Array:
    """Interpolate `rows`, functions on the uniform grid `places`, linearly at depths, clipped; shape (samples, m)."""
    at = (depth_mm - places[0]) / (places[1] - places[0])
    left = np.clip(at.astype(int), 0, len(places) - 2)
    share = np.clip(at - left, 0.0, 1.0)[:, None]
    return np.asarray(rows[left] * (1 - share) + rows[left + 1] * share)


def _rough(apart_mm: Array) -> Array:
    """Return the exponential correlation (Ornstein-Uhlenbeck): the property jumps at every scale."""
    return np.asarray(np.exp(-apart_mm / ROUGH_MM))


def _smooth(apart_mm: Array) -> Array:
    """Return the Matern correlation (5/2): the property has two derivatives."""
    x = math.sqrt(5) * apart_mm / SMOOTH_MM
    return np.asarray((1 + x + x**2 / 3) * np.exp(-x))


_CORRELATIONS = (_rough, _smooth)


@lru_cache(maxsize=8)
def _functions_of_depth(deepest_mm: float) -> tuple[tuple[Array, ...], Array]:
    """Return the scaled modes of each kind of heterogeneity, shape (places, modes), and their depths `places` (mm).

    The modes are the eigenfunctions of the correlation.
    """
    places = np.arange(0.0, deepest_mm + TISSUE_GRID_MM, TISSUE_GRID_MM)
    apart, found = np.abs(places[:, None] - places), []
    for correlation in _CORRELATIONS:
        values, vectors = np.linalg.eigh(correlation(apart))
        values, vectors = values[::-1], vectors[:, ::-1]
        count = min(int(np.searchsorted(np.cumsum(values) / values.sum(), TISSUE_VARIANCE)) + 1, MOST_MODES)
        found.append(vectors[:, :count] * np.sqrt(values[:count]))
    return tuple(found), places


def tissue_modes(model: Model, motion: Motion) -> tuple[Array, ...]:
    """Return the change of the axial force by each heterogeneity mode at standard deviation 1, by kind of tissue.

    Each array has the shape (samples, modes). Shaft friction and tip force vary separately if the model has the methods
    `shaft_n` and `tip_n`. If one of these methods is missing, the whole force replaces its result.
    """
    run = simulate(model, motion)
    shaft = model.shaft_n(run.states, motion) if hasattr(model, "shaft_n") else run.output
    tip = model.tip_n(run.states, motion) if hasattr(model, "tip_n") else run.output
    both = _along_path(np.asarray(motion.depth_mm, float).tobytes())
    return tuple(np.hstack([shaft[:, None] * mean, tip[:, None] * at_tip]) for mean, at_tip in both)


@lru_cache(maxsize=8)
def _along_path(depth_mm: bytes) -> tuple[tuple[Array, Array], ...]:
    """Return the depth functions averaged along the shaft, and at the tip, (samples, modes) each, by kind of tissue.

    `depth_mm` is the byte string of the depth array, so that the result can be cached.
    """
    depth, found = np.clip(np.frombuffer(depth_mm), 0.0, None), []
    kinds, places = _functions_of_depth(float(np.ceil(max(depth.max(), 1.0))))
    for modes in kinds:
        sums = np.cumsum((modes[1:] + modes[:-1]) / 2, axis=0) * TISSUE_GRID_MM
        sums = np.concatenate([np.zeros((1, modes.shape[1])), sums])
        mean = at_depth(depth, places, sums) / np.maximum(depth, TISSUE_GRID_MM)[:, None]
        found.append((mean, at_depth(depth, places, modes)))
    return tuple(found)


def _curvature_modes(model: Model, motion: Motion) -> tuple[Array, ...]:
    """Return the change of the position by each curvature mode at standard deviation 1, by kind of tissue.

    Each array has the shape (3 * samples, modes).
    """
    depth = np.clip(np.asarray(motion.depth_mm, float), 0.0, None)
    kinds, places = _functions_of_depth(float(np.ceil(max(depth.max(), 1.0))))
    states = simulate(model, motion).states
    within, across = bevel_direction(states, 0.0), bevel_direction(states, np.pi / 2)
    curvature, felt, found = curvature_of(model), felt_mm_of(model), []
    for modes in kinds:
        at = at_depth(depth, places, modes)
        found.append(np.column_stack([
            path_displacement(states, motion, curvature * at, within, felt),
            path_displacement(states, motion, curvature * ACROSS_RATIO * at, across, felt),
        ]))  # fmt: skip
    return tuple(found)


def curvature_of(model: Model) -> float:
    """Return the magnitude of the path's curvature (1/mm); 0.001 for a model without this parameter."""
    return abs(float(getattr(model, "curvature_per_mm", 1e-3)))


def felt_mm_of(model: Model) -> float:
    """Return the length (mm) over which an elastic needle averages its load; 0 for a model without elasticity."""
    return float(getattr(model, "felt_mm", 0.0))


_CHANNELS = {
    Channel.FORCE: ChannelDescription(FORCE_LAG_S, FORCE_PRIORS, tissue_modes),
    Channel.TIP: ChannelDescription(TIP_LAG_S, TIP_PRIORS, _curvature_modes, _ENTRY_PARAMETERS),
}


def channel_description(channel: Channel) -> ChannelDescription:
    """Return the description of a channel. Raises ModelError if the channel cannot be diagnosed."""
    if channel not in _CHANNELS:
        rule = f"cannot be diagnosed; must be one of {', '.join(_CHANNELS)}"
        raise ModelError(Mistake("channel", channel, rule))
    return _CHANNELS[channel]
