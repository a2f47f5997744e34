"""Nonparametric components: smooth functions along an axis, a step in time, and waves of position and time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
from scipy.interpolate import BSpline
from scipy.special import logsumexp

from needleplan.diagnosis._blocks import Indices
from needleplan.diagnosis._constants import (
    AMPLITUDE_SCALES,
    FINER,
    FIRST_STEP_S,
    LATE_S,
    NEAR_TURN,
    NOT_VISITED,
    REST_SPEED_SHARE,
    RINGING_HZ,
    RINGING_S,
    STEP_EVERY_S,
    WAVE_STEP,
    WAVES_HZ,
    WAVES_PER_MM,
)
from needleplan.diagnosis._evidence import Columns, Projected
from needleplan.diagnosis._hypothesis import Extra, Hypothesis
from needleplan.diagnosis._problem import Problem, turns_of
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.channels import GapAxis, curvature_of, felt_mm_of
from needleplan.models import Channel, recurrence, simulate
from needleplan.models.effects import presliding_of
from needleplan.models.friction import slid
from needleplan.models.path import bevel_direction, fixed_direction, path_displacement
from needleplan.signals import Array, Motion

__all__ = ["Component", "ComponentEvidence", "Components"]


_Smooth = tuple[str, GapAxis, list[Array]]
Shape = Callable[[CalibratedTrial, Array], Array]
"""Function that returns the columns of one trial at places (times, frequencies), shape (axes * samples, places, p)."""


@dataclass(frozen=True)
class Component:
    """A kind of component: name, axis, and groups of columns of which one applies, at the given places."""

    name: str
    axis: GapAxis
    groups: Indices
    """Columns of each group, shape (groups, columns)."""

    places: Array
    """Time or frequency of each group; empty for smooth functions."""

    shape: Shape | None = None


@dataclass(frozen=True)
class ComponentEvidence:
    """Gain of log evidence if a component is added to a hypothesis, by the name of the component."""

    hypothesis: Hypothesis
    gains: Mapping[str, Array]
    """Log evidence ratio by scale, heterogeneity and group."""

    log_gains: Mapping[str, float]
    """Log evidence ratio with scales and places averaged over."""


class Components:
    """All components of a data set with their whitened columns; a draw of one has the RMS of the noise at scale 1."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        trials = problem.trials
        last = min(float(trial.motion.time_s[-1]) for trial in trials)
        force = trials[0].model.channel is Channel.FORCE
        functions = _force_functions if force else _path_functions
        kinds: list[tuple[str, GapAxis, Array, Shape | None, list[Array]]] = []
        for name, axis, columns in functions(trials):
            visited = np.max([np.abs(column).max(axis=0) for column in columns], axis=0) > NOT_VISITED
            if visited.any():
                kinds.append((name, axis, np.zeros(0), None, [column[:, None, visited] for column in columns]))
        per_mm, hertz = (  # frequencies that the range of depths or times distinguishes
            np.arange(*ends, WAVE_STEP / max(float(np.ptp(getattr(trial.motion, name))) for trial in trials))
            for name, ends in (("depth_mm", WAVES_PER_MM), ("time_s", WAVES_HZ))
        )
        for name, axis, places, shape in (
            ("step in time", GapAxis.TIME, np.arange(FIRST_STEP_S, last - STEP_EVERY_S, STEP_EVERY_S), _step),
            ("wave of the position", GapAxis.PERIOD, per_mm, partial(_wave, "depth_mm")),
            ("wave in time", GapAxis.TIME, hertz, partial(_wave, "time_s")),
            *((("ringing", GapAxis.ACCELERATION, np.arange(*RINGING_HZ), _ringing),) if force else ()),
        ):
            kinds.append((name, axis, places, shape, [shape(trial, places) for trial in trials]))
        every: list[Component] = []
        raw: list[list[Array]] = []
        first = 0
        for name, axis, places, finer, values in kinds:
            groups = first + np.arange(values[0][0].size).reshape(values[0].shape[1:])
            every.append(Component(name, axis, groups, places, finer))
            raw.append(self._scaled(values))
            first += groups.size
        self.components: tuple[Component, ...] = tuple(every)
        self.raw: tuple[Array, ...] = tuple(np.column_stack(each) for each in zip(*raw, strict=True))

    @cached_property
    def columns(self) -> Columns:
        """Columns of all components, whitened by noise and errors of single trials."""
        return self._columns(self.raw)

    def _scaled(self, groups: Sequence[Array]) -> list[Array]:
        """Return groups of columns (n, groups, p) by trial, scaled to the RMS of the noise, as (n, groups * p).

        They are zero in the references, which show what is normal.
        """
        trials = self.problem.trials
        some = [0.0 * each if trial.is_reference else each for each, trial in zip(groups, trials, strict=True)]
        energy = sum((each**2).sum(axis=(0, 2)) for each in some) / sum(map(len, groups))
        factor = self.problem.calibration.noise.rms / np.sqrt(np.maximum(energy, 1e-300))
        return [(each * factor[:, None]).reshape(len(each), -1) for each in some]

    def _columns(self, raw: Sequence[Array]) -> Columns:
        problem = self.problem
        whitened = [problem.whiten(trial, number, raw[number]) for number, trial in enumerate(problem.trials)]
        return Columns([problem.block(trial, number) for number, trial in enumerate(problem.trials)], whitened)

    def evidence(self, hypothesis: Hypothesis) -> ComponentEvidence:
        """Return the evidence of each component if it is added to a hypothesis."""
        columns = self.columns
        projected = hypothesis.linear.project(columns, hypothesis.levels)
        gains = {
            component.name: _gains(hypothesis, columns, projected, component.groups) for component in self.components
        }
        prior = hypothesis.by_heterogeneity[hypothesis.levels]
        total = float(logsumexp(prior))
        log_gains = {name: _total(by_scale, prior) - total for name, by_scale in gains.items()}
        return ComponentEvidence(hypothesis, gains, log_gains)

    def strongest(self, evidence: ComponentEvidence, least: float) -> tuple[Extra, float] | None:
        """Return the component with the largest gain at its best place; None if its gain is below `least` nats.

        The number is the log ratio of the evidence averaged over places and scales to that at the best place and scale.
        """
        hypothesis = evidence.hypothesis
        prior = hypothesis.by_heterogeneity[hypothesis.levels]
        component = max(self.components, key=lambda candidate: evidence.log_gains[candidate.name])
        if evidence.log_gains[component.name] < least:
            return None
        raw = [columns[:, component.groups[0]] for columns in self.raw]
        count = cells = len(component.groups)
        if component.shape is not None:  # the best place lies between the points of the grid
            index = int(logsumexp(evidence.gains[component.name] + prior[None, :, None], axis=(0, 1)).argmax())
            step = float(component.places[1] - component.places[0])
            near = component.places[index] + step * np.linspace(-1, 1, 2 * FINER + 1)
            raw, count = self._scaled([component.shape(trial, near) for trial in self.problem.trials]), len(near)
        columns = self._columns(raw)
        groups = np.arange(columns.count).reshape(count, -1)
        projected = hypothesis.linear.project(columns, hypothesis.levels)
        gains = _gains(hypothesis, columns, projected, groups)
        index = int(logsumexp(gains + prior[None, :, None], axis=(0, 1)).argmax())
        by_scale = logsumexp(gains[:, :, index] + prior, axis=1)
        scale = float(AMPLITUDE_SCALES[by_scale.argmax()])
        level = int((gains[by_scale.argmax(), :, index] + prior).argmax())
        matrix = hypothesis.linear.normals(columns, projected, groups[index : index + 1])[level, 0]
        fitted = np.linalg.solve(matrix + np.eye(len(matrix)) / scale**2, projected.slope[level, groups[index]])
        group = [trial_columns[:, groups[index]] for trial_columns in raw]
        outputs = tuple(trial_columns @ fitted for trial_columns in group)
        extra = Extra(component.name, tuple(group), outputs, scale)
        return extra, _total(gains, prior) - math.log(cells) - float(by_scale.max())


def _gains(hypothesis: Hypothesis, columns: Columns, projected: Projected, groups: Indices) -> Array:
    """Return the log evidence ratio of each group by scale and heterogeneity, shape (scales, t, groups)."""
    noise, energy = hypothesis.problem.noise_scale, hypothesis.linear.energy[hypothesis.levels][:, None]
    values, vectors = np.linalg.eigh(hypothesis.linear.normals(columns, projected, groups))
    values = np.maximum(values, 0.0)
    part = np.einsum("tgpi,tgp->tgi", vectors, projected.slope[:, groups]) ** 2
    scales = AMPLITUDE_SCALES[:, None, None, None] ** 2
    explained = (part * scales / (1 + scales * values)).sum(axis=3)
    gains = noise.log_likelihood(np.maximum(energy - explained, 0.0)) - noise.log_likelihood(energy)
    return np.asarray(gains - 0.5 * np.log1p(scales * values).sum(axis=3))


def _total(gains: Array, prior: Array) -> float:
    """Return the log evidence with scales and places averaged over."""
    return float(logsumexp(gains + prior[None, :, None])) - math.log(gains.shape[0] * gains.shape[2])


def _step(trial: CalibratedTrial, times_s: Array) -> Array:
    return trial.on_each_axis(np.asarray(trial.motion.time_s[:, None] >= times_s, float)[:, :, None])


def _wave(variable: str, trial: CalibratedTrial, frequencies: Array) -> Array:
    """Return sine and cosine of a variable of the motion, shape (axes * samples, frequencies, 2 * axes)."""
    values = np.asarray(getattr(trial.motion, variable), float)
    return trial.on_each_axis(_waves(values.tobytes(), np.asarray(frequencies, float).tobytes()))


@lru_cache(maxsize=32)
def _waves(values: bytes, frequencies: bytes) -> Array:
    """Return sine and cosine, shape (samples, frequencies, 2), read-only; byte strings, for the cache.

    The frequencies have equal distances, so that each wave is the one before times the same factor.
    """
    first, *others = np.frombuffer(frequencies)
    turn = 2j * math.pi * np.frombuffer(values)[:, None]
    factors = np.tile(np.exp(turn * (others[0] - first if others else 0.0)), 1 + len(others))
    factors[:, 0] = np.exp(turn[:, 0] * first)
    waves = np.cumprod(factors, axis=1)
    found: Array = np.stack([waves.imag, waves.real], axis=2)
    found.flags.writeable = False
    return found


def _ringing(trial: CalibratedTrial, frequencies_hz: Array) -> Array:
    """Return damped oscillations that the acceleration drives, as sine and cosine, shape (samples, places, 2)."""
    series = (trial.motion.time_s, trial.motion.velocity_mm_s, frequencies_hz)
    return _rung(*(np.asarray(values, float).tobytes() for values in series))


@lru_cache(maxsize=32)
def _rung(time_s: bytes, velocity_mm_s: bytes, frequencies_hz: bytes) -> Array:
    """Return the oscillations, shape (samples, places, 2), read-only; byte strings, for the cache.

    The solution is exact if the acceleration is linear between samples.
    """
    time, velocity = np.frombuffer(time_s), np.frombuffer(velocity_mm_s)
    pole = -1 / RINGING_S + 2j * math.pi * np.frombuffer(frequencies_hz)
    drive = np.gradient(velocity, time)[:, None]
    turn = pole * np.diff(time)[:, None]
    keep = np.exp(turn)
    late = (keep - 1 - turn) / (turn * pole)  # share of a step that the acceleration at its end drives
    pushes = drive[:-1] * ((keep - 1) / pole - late) + drive[1:] * late
    state, found = np.zeros(len(pole), complex), [np.zeros(len(pole), complex)]
    for factor, push in zip(keep, pushes, strict=True):
        state = factor * state + push
        found.append(state)
    states = np.array(found)
    rung: Array = np.stack([states.imag, states.real], axis=2)
    rung.flags.writeable = False
    return rung


def _late_accelerations(motion: Motion) -> Array:
    """Return the acceleration and its means over the time before, for four lags of first order, shape (samples, 5)."""
    step_s, drive = np.diff(motion.time_s), motion.acceleration_mm_s2
    late = [
        recurrence(keep, (1 - keep) * drive[1:], float(drive[0]))
        for keep in (np.exp(-step_s / lag_s) for lag_s in LATE_S)
    ]
    return np.column_stack([drive, *late])


def _force_functions(trials: Sequence[CalibratedTrial]) -> Iterator[_Smooth]:
    """Yield the smooth functions of the axial force: name, axis, and columns by trial."""
    motions = [trial.motion for trial in trials]
    deepest = max(float(motion.depth_mm.max()) for motion in motions)
    fastest = max(float(np.abs(motion.velocity_mm_s).max()) for motion in motions)
    longest = max(float(motion.time_s[-1]) for motion in motions)
    force = max(float(np.abs(trial.output).max()) for trial in trials) or 1.0
    signs = [slid(trial.motion, presliding_of(trial.model))[:, None] for trial in trials]
    inside = [np.clip(motion.depth_mm, 0, None)[:, None] for motion in motions]
    depth = [_splines(each[:, 0], 0.0, deepest, 9) for each in inside]
    speed = [_splines(np.abs(motion.velocity_mm_s), 0.0, fastest, 5) for motion in motions]
    yield "advance by depth", GapAxis.DEPTH, [b * ((1 + z) / 2) for b, z in zip(depth, signs, strict=True)]
    yield "retraction by depth", GapAxis.DEPTH, [b * ((1 - z) / 2) for b, z in zip(depth, signs, strict=True)]
    yield "depth, either way", GapAxis.DEPTH, depth
    yield "friction by speed", GapAxis.SPEED, [b * L * z for b, L, z in zip(speed, inside, signs, strict=True)]
    yield "force by speed", GapAxis.SPEED, [b * z for b, z in zip(speed, signs, strict=True)]
    yield "acceleration", GapAxis.ACCELERATION, [_late_accelerations(motion) for motion in motions]
    time = [_splines(motion.time_s, 0.0, longest, 7) for motion in motions]
    yield "time", GapAxis.TIME, time
    yield "friction by time", GapAxis.TIME, [b * L * z for b, L, z in zip(time, inside, signs, strict=True)]
    yield "rest", GapAxis.DWELL, [_rest_relaxation(trial) for trial in trials]
    powers = [_force_powers(trial, force) for trial in trials]
    yield "force", GapAxis.FORCE, powers
    yield "force squared", GapAxis.FORCE, [power[:, 1:2] - power[:, 3:4] for power in powers]
    # Without the samples near reversals a power loses most of its gain; these keep the samples.
    push = [np.maximum(trial.output / force, 0.0)[:, None] for trial in trials]
    yield "pushing force squared", GapAxis.FORCE, [each**2 for each in push]
    yield "pushing force cubed", GapAxis.FORCE, [each**3 for each in push]


def _path_functions(trials: Sequence[CalibratedTrial]) -> Iterator[_Smooth]:
    """Yield the smooth functions of the position of the tip: name, axis, and columns by trial."""
    motions = [trial.motion for trial in trials]
    deepest = max(float(motion.depth_mm.max()) for motion in motions)
    fastest = max(float(np.abs(motion.velocity_mm_s).max()) for motion in motions)
    longest = max(float(motion.time_s[-1]) for motion in motions)
    depth = [_splines(np.clip(motion.depth_mm, 0, None), 0.0, deepest, 6) for motion in motions]
    speed = [_splines(np.abs(motion.velocity_mm_s), 0.0, fastest, 4) for motion in motions]
    angle = [
        np.column_stack([np.cos(motion.angle_rad), np.sin(motion.angle_rad), np.cos(2 * motion.angle_rad)])
        for motion in motions
    ]  # fmt: skip
    places = (
        ("depth", GapAxis.DEPTH, depth),
        ("time", GapAxis.TIME, [_splines(motion.time_s, 0.0, longest, 7) for motion in motions]),
        ("speed", GapAxis.SPEED, speed),
        ("angle", GapAxis.ANGLE, angle),
    )
    for name, axis, columns in places:
        yield f"place by {name}", axis, [trial.on_each_axis(each) for trial, each in zip(trials, columns, strict=True)]
    time = [_splines(motion.time_s, 0.0, longest, 6) for motion in motions]
    states = [simulate(trial.model, trial.motion).states for trial in trials]
    bends = (
        ("curvature by depth", GapAxis.DEPTH, depth, bevel_direction),
        ("pull by depth", GapAxis.DEPTH, depth, fixed_direction),
        ("curvature by speed", GapAxis.SPEED, speed, bevel_direction),
        ("pull by speed", GapAxis.SPEED, speed, fixed_direction),
        ("curvature by time", GapAxis.TIME, time, bevel_direction),
    )
    for name, axis, columns, direction in bends:
        parts = []
        for trial, each, state in zip(trials, columns, states, strict=True):
            more, felt = curvature_of(trial.model) * each, felt_mm_of(trial.model)
            ways = [direction(state, angle) for angle in (0.0, np.pi / 2)]
            parts.append(np.column_stack([path_displacement(state, trial.motion, more, way, felt) for way in ways]))
        yield name, axis, parts


def _splines(values: Array, low: float, high: float, count: int) -> Array:
    """Return `count` cubic B-splines with equal knot intervals from `low` to `high`, shape (samples, count)."""
    inner = np.linspace(low, high, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(values, low, high * (1 - 1e-12)), knots, 3).toarray())


def _force_powers(trial: CalibratedTrial, scale: float) -> Array:
    """Return powers of the pushing and pulling force divided by `scale`, shape (samples, 4).

    The columns are push, push^2, push^3 and pull^2. All are zero near reversals, where powers would compensate timing
    errors.
    """
    turns = turns_of(trial.motion)
    turned = np.isin(np.arange(len(trial.motion)), turns[turns > 0])
    near = np.convolve(turned, np.ones(2 * NEAR_TURN + 1), "same") > 0
    force = np.where(near, 0.0, trial.output / scale)
    push, pull = np.maximum(force, 0), np.maximum(-force, 0)
    return np.column_stack([push, push**2, push**3, pull**2])


def _rest_relaxation(trial: CalibratedTrial) -> Array:
    """Return exponential relaxations of the force during dwells for four time constants, shape (samples, 4)."""
    motion: Motion = trial.motion
    fastest = float(np.abs(motion.velocity_mm_s).max())
    still = np.abs(motion.velocity_mm_s) < REST_SPEED_SHARE * fastest
    began = np.maximum.accumulate(np.where(still, 0, np.arange(len(motion))))
    since = motion.time_s - motion.time_s[began]
    scale = np.where(still, trial.output, 0.0)
    return np.column_stack([scale * -np.expm1(-since / tau) for tau in (0.15, 0.6, 2.5, 10.0)])
