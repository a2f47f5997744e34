"""Channels that can be diagnosed: the axial force and the position of the tip.

A `ChannelDescription` states how heterogeneous tissue changes the channel's output, the priors of parameters, and the
smooth functions that compete with effects. To support another channel, add its
description to `CHANNELS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline

from needleplan.diagnosis.heterogeneity import GRID_MM, at_depth, functions_of_depth
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel, Model, simulate
from needleplan.models.effects import presliding_of
from needleplan.models.friction import slid
from needleplan.models.path import bevel_direction, fixed_direction, path_displacement
from needleplan.signals import Array, Motion

__all__ = [
    "AXIAL_FORCE",
    "CHANNELS",
    "TIP_POSITION",
    "ChannelDescription",
    "GapAxis",
    "SimulatedTrial",
    "SmoothBasis",
    "channel_description",
    "curvature_modes",
    "force_bases",
    "splines",
    "tip_bases",
    "tissue_modes",
]

# Standard deviation (s) of a force sensor's usual lag.
_FORCE_LAG_SD_S = 0.004
# Prior standard deviation of fit coordinates: presliding depends on the surfaces and varies by a fifth.
_FORCE_PRIORS = {"presliding_mm": 0.2}
# Number of samples before and after a reversal that count as near it.
_TURN_SAMPLES = 2
# Share of the maximum speed below which the velocity counts as zero when reversals are sought.
_TURN_SPEED_SHARE = 0.002
# Share of the maximum speed below which the needle counts as at rest.
_REST_SPEED_SHARE = 0.02
# Standard deviation (s) of a tracker's usual lag.
_TIP_LAG_SD_S = 0.005
# Parameters of the entry pose; the path is linear in them.
_ENTRY_PARAMETERS = ("heading_y_rad", "heading_z_rad", "entry_x_mm", "entry_y_mm", "entry_z_mm")
# Prior standard deviation of fit coordinates: repeated insertions agree in curvature within a fifth.
_TIP_PRIORS = {"curvature_per_mm": 0.2}
# Ratio of the curvature variation across the bevel plane to that within it.
_ACROSS_RATIO = 0.5


class GapAxis(StrEnum):
    """Variable on which a gap depends. The values are those of `diagnosis.json`."""

    TIME = "time"
    DEPTH = "depth"
    SPEED = "speed"
    FORCE = "force"
    DWELL = "hold"
    PERIOD = "position_periodic"
    ANGLE = "angle"

    @property
    def label(self) -> str:
        """Name of the variable in reports."""
        return {"hold": "dwell time", "position_periodic": "position"}.get(self.value, self.value)


class SimulatedTrial(Protocol):
    """A trial with the output that a model predicts."""

    @property
    def model(self) -> Model:
        """Model that predicts the output."""

    @property
    def motion(self) -> Motion:
        """The motion of the trial."""

    @property
    def output(self) -> Array:
        """Output of the model, one axis after the other, shape (axes * samples,)."""


@dataclass(frozen=True)
class SmoothBasis:
    """Smooth functions along an axis, one array of shape (axes * samples, df) per trial; trials share coefficients."""

    axis: GapAxis
    functions: tuple[Array, ...]


@dataclass(frozen=True)
class ChannelDescription:
    """Properties of a measured quantity that the diagnosis uses."""

    channel: Channel
    usual_lag_s: float
    """Prior standard deviation (s) of the sensor lag; 0 for a sensor without lag."""

    priors: Mapping[str, float]
    """Prior standard deviation of fit coordinates by parameter; other parameters have a default of about a factor 2."""

    modes: Callable[[Model, Motion], Array]
    """Returns the output change by each heterogeneity mode at standard deviation 1, shape (axes * samples, modes)."""

    smooth_bases: Callable[[Sequence[SimulatedTrial]], Mapping[str, SmoothBasis]]
    """Returns the nonparametric alternatives by name."""

    linear_parameters: tuple[str, ...] = ()
    """Well known parameters that enter linearly: they keep their values in a calibration and are only linearised."""


def splines(values: Array, low: float, high: float, count: int) -> Array:
    """Return `count` cubic B-splines with equal knot intervals from `low` to `high`, shape (samples, count)."""
    inner = np.linspace(low, high, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(values, low, high * (1 - 1e-12)), knots, 3).toarray())


def tissue_modes(model: Model, motion: Motion) -> Array:
    """Return the change of the axial force by each heterogeneity mode at standard deviation 1, shape (samples, modes).

    Shaft friction and tip force vary separately if the model has the methods `shaft_n` and `tip_n`. If one of these
    methods is missing, the whole force replaces its result.
    """
    run = simulate(model, motion)
    mean, at_tip = _along_path(np.asarray(motion.depth_mm, float).tobytes())
    shaft = model.shaft_n(run.states, motion) if hasattr(model, "shaft_n") else run.output
    tip = model.tip_n(run.states, motion) if hasattr(model, "tip_n") else run.output
    count = mean.shape[1]
    found = np.empty((len(mean), 2 * count))
    np.multiply(shaft[:, None], mean, out=found[:, :count])
    np.multiply(tip[:, None], at_tip, out=found[:, count:])
    return found


@lru_cache(maxsize=8)
def _along_path(depth_mm: bytes) -> tuple[Array, Array]:
    """Return the depth functions averaged along the inserted shaft, and at the tip, both of shape (samples, modes).

    `depth_mm` is the byte string of the depth array, so that the result can be cached.
    """
    depth = np.clip(np.frombuffer(depth_mm), 0.0, None)
    modes, places = functions_of_depth(float(np.ceil(max(depth.max(), 1.0))))
    sums = np.concatenate([np.zeros((1, modes.shape[1])), np.cumsum((modes[1:] + modes[:-1]) / 2, axis=0)]) * GRID_MM
    return at_depth(depth, places, sums) / np.maximum(depth, GRID_MM)[:, None], at_depth(depth, places, modes)


def force_bases(trials: Sequence[SimulatedTrial]) -> dict[str, SmoothBasis]:
    """Return the nonparametric alternatives for the axial force by name."""
    motions = [trial.motion for trial in trials]
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    longest = max(float(each.time_s[-1]) for each in motions)
    force = max(float(np.abs(trial.output).max()) for trial in trials) or 1.0
    found: dict[str, SmoothBasis] = {}

    def add(name: str, axis: GapAxis, columns: list[Array]) -> None:
        _add_basis(found, name, axis, columns)

    signs = [slid(trial.motion, presliding_of(trial.model)) for trial in trials]
    depth = [splines(np.clip(each.depth_mm, 0, None), 0.0, deepest, 9) for each in motions]
    inside = [np.clip(each.depth_mm, 0, None)[:, None] for each in motions]
    speed = [splines(np.abs(each.velocity_mm_s), 0.0, fastest, 5) for each in motions]
    add("advance by depth", GapAxis.DEPTH, [b * ((1 + z) / 2)[:, None] for b, z in zip(depth, signs, strict=True)])
    add("retraction by depth", GapAxis.DEPTH, [b * ((1 - z) / 2)[:, None] for b, z in zip(depth, signs, strict=True)])
    add("depth, either way", GapAxis.DEPTH, depth)
    add("friction by speed", GapAxis.SPEED,
        [b * L * z[:, None] for b, L, z in zip(speed, inside, signs, strict=True)])  # fmt: skip
    add("force by speed", GapAxis.SPEED, [b * z[:, None] for b, z in zip(speed, signs, strict=True)])
    add("time", GapAxis.TIME, [splines(each.time_s, 0.0, longest, 7) for each in motions])
    add("rest", GapAxis.DWELL, [_rest_relaxation(trial) for trial in trials])
    powers = [_force_powers(trial, force) for trial in trials]
    add("force", GapAxis.FORCE, powers)
    add("force squared", GapAxis.FORCE, [each[:, 1:2] - each[:, 3:4] for each in powers])
    # Without the samples near reversals a power loses most of its gain; these keep the samples.
    push = [np.maximum(trial.output / force, 0.0)[:, None] for trial in trials]
    for name, power in (("pushing force squared", 2), ("pushing force cubed", 3)):
        found[name] = SmoothBasis(GapAxis.FORCE, tuple(each**power for each in push))
    return found


def _near_turns(motion: Motion) -> Array:
    """Return a mask of the samples near a reversal or the first movement, shape (samples,).

    A dwell without reversal does not count.
    """
    fastest = float(np.abs(motion.velocity_mm_s).max())
    sign = np.sign(np.where(np.abs(motion.velocity_mm_s) < _TURN_SPEED_SHARE * fastest, 0.0, motion.velocity_mm_s))
    turned = np.concatenate([[False], np.diff(np.where(sign == 0, motion.direction, sign)) != 0])
    return np.asarray(np.convolve(turned, np.ones(2 * _TURN_SAMPLES + 1), "same") > 0)


def _force_powers(trial: SimulatedTrial, scale: float) -> Array:
    """Return powers of the pushing and pulling force divided by `scale`, shape (samples, 4).

    The columns are push, push^2, push^3 and pull^2. All are zero near reversals, where powers would compensate timing
    errors.
    """
    force = np.where(_near_turns(trial.motion), 0.0, trial.output / scale)
    push, pull = np.maximum(force, 0), np.maximum(-force, 0)
    return np.column_stack([push, push**2, push**3, pull**2])


def _rest_relaxation(trial: SimulatedTrial) -> Array:
    """Return exponential relaxations of the force during dwells for four time constants, shape (samples, 4)."""
    motion: Motion = trial.motion
    fastest = float(np.abs(motion.velocity_mm_s).max())
    still = np.abs(motion.velocity_mm_s) < _REST_SPEED_SHARE * fastest
    began = np.maximum.accumulate(np.where(still, 0, np.arange(len(motion))))
    since = motion.time_s - motion.time_s[began]
    scale = np.where(still, trial.output, 0.0)
    return np.column_stack([scale * -np.expm1(-since / tau) for tau in (0.15, 0.6, 2.5, 10.0)])


AXIAL_FORCE = ChannelDescription(Channel.FORCE, _FORCE_LAG_SD_S, _FORCE_PRIORS, tissue_modes, force_bases)
"""Description of the axial force."""


def curvature_modes(model: Model, motion: Motion) -> Array:
    """Return the change of the position by each curvature mode at standard deviation 1, shape (3 * samples, modes)."""
    depth = np.clip(np.asarray(motion.depth_mm, float), 0.0, None)
    modes, places = functions_of_depth(float(np.ceil(max(depth.max(), 1.0))))
    at = at_depth(depth, places, modes)
    states = simulate(model, motion).states
    curvature, felt = _curvature(model), _felt_mm(model)
    return np.column_stack([
        path_displacement(states, motion, curvature * at, bevel_direction(states, 0.0), felt),
        path_displacement(states, motion, curvature * _ACROSS_RATIO * at, bevel_direction(states, np.pi / 2), felt),
    ])  # fmt: skip


def tip_bases(trials: Sequence[SimulatedTrial]) -> dict[str, SmoothBasis]:
    """Return the nonparametric alternatives for the position of the tip by name."""
    motions = [trial.motion for trial in trials]
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    longest = max(float(each.time_s[-1]) for each in motions)
    states = [simulate(trial.model, trial.motion).states for trial in trials]
    depth = [splines(np.clip(each.depth_mm, 0, None), 0.0, deepest, 6) for each in motions]
    speed = [splines(np.abs(each.velocity_mm_s), 0.0, fastest, 4) for each in motions]
    found: dict[str, SmoothBasis] = {}

    def shifted(name: str, axis: GapAxis, columns: Sequence[Array]) -> None:
        _add_basis(found, name, axis, [np.asarray(np.kron(np.eye(3), each), float) for each in columns])

    def curved(name: str, axis: GapAxis, columns: Sequence[Array], *, near_turns: bool) -> None:
        parts = []
        for trial, each, state in zip(trials, columns, states, strict=True):
            more = _curvature(trial.model) * each
            ways = [bevel_direction(state, a) if near_turns else fixed_direction(state, a) for a in (0.0, np.pi / 2)]
            parts.append(
                np.column_stack(
                    [path_displacement(state, trial.motion, more, way, _felt_mm(trial.model)) for way in ways]
                )
            )
        _add_basis(found, name, axis, parts)

    shifted("place by depth", GapAxis.DEPTH, depth)
    shifted("place by time", GapAxis.TIME, [splines(each.time_s, 0.0, longest, 7) for each in motions])
    shifted("place by speed", GapAxis.SPEED, speed)
    shifted("place by angle", GapAxis.ANGLE, [
        np.column_stack([np.cos(each.angle_rad), np.sin(each.angle_rad), np.cos(2 * each.angle_rad)])
        for each in motions
    ])  # fmt: skip
    curved("curvature by depth", GapAxis.DEPTH, depth, near_turns=True)
    curved("pull by depth", GapAxis.DEPTH, depth, near_turns=False)
    curved("curvature by speed", GapAxis.SPEED, speed, near_turns=True)
    curved("pull by speed", GapAxis.SPEED, speed, near_turns=False)
    curved(
        "curvature by time", GapAxis.TIME, [splines(each.time_s, 0.0, longest, 6) for each in motions], near_turns=True
    )
    return found


def _add_basis(found: dict[str, SmoothBasis], name: str, axis: GapAxis, columns: list[Array]) -> None:
    nonzero = np.abs(np.vstack(columns)).max(axis=0) > 1e-9
    if nonzero.any():
        found[name] = SmoothBasis(axis, tuple(each[:, nonzero] for each in columns))


def _curvature(model: Model) -> float:
    """Return the magnitude of the path's curvature (1/mm); 0.001 for a model without this parameter."""
    return abs(float(getattr(model, "curvature_per_mm", 1e-3)))


def _felt_mm(model: Model) -> float:
    """Return the length (mm) over which an elastic needle averages its load; 0 for a model without elasticity."""
    return float(getattr(model, "felt_mm", 0.0))


TIP_POSITION = ChannelDescription(
    Channel.TIP, _TIP_LAG_SD_S, _TIP_PRIORS, curvature_modes, tip_bases, _ENTRY_PARAMETERS
)
"""Description of the position of the tip."""


# All channels that can be diagnosed.
CHANNELS: dict[Channel, ChannelDescription] = {each.channel: each for each in (AXIAL_FORCE, TIP_POSITION)}


def channel_description(channel: Channel) -> ChannelDescription:
    """Return the description of a channel. Raises ModelError if the channel cannot be diagnosed."""
    if channel not in CHANNELS:
        rule = f"cannot be diagnosed; must be one of {', '.join(CHANNELS)}"
        raise ModelError(Mistake("channel", channel, rule))
    return CHANNELS[channel]
