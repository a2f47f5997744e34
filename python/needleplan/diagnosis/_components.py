"""Nonparametric components: smooth functions along an axis, a step in time, and waves of position and time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from needleplan.diagnosis._evidence import Columns, Indices, Projected
from needleplan.diagnosis._hypothesis import AMPLITUDE_SCALES, Extra, Hypothesis
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.channels import GapAxis, channel_description
from needleplan.signals import Array

__all__ = ["Beside", "Component", "Components", "StrongComponent"]

# Lowest and highest frequency of a wave of the position (1/mm) and of the time (Hz).
_PER_MM, _HZ = (0.04, 1.2), (0.1, 6.0)
# Step of these frequencies, as a share of the inverse range of position or time.
_FREQUENCY_STEP = 0.8
# First time of a step and interval of its times, s.
_FIRST_S, _STEP_S = 2.0, 0.4
# Number of points on each side at which the place of a step or a frequency is refined.
_FINER = 6

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
class StrongComponent:
    """The component with the largest gain beside a hypothesis: its columns at the best place."""

    offset: float
    """Log ratio of the evidence averaged over places and scales to that at the best place and scale."""

    extra: Extra


@dataclass(frozen=True)
class Beside:
    """Evidence of all components beside a hypothesis, by name."""

    hypothesis: Hypothesis
    projected: Projected
    gains: Mapping[str, Array]
    """Log evidence ratio by scale, heterogeneity and group."""

    log_gains: Mapping[str, float]
    """Log evidence ratio with scales and places averaged over."""


class Components:
    """All components of a data set with their whitened columns; a draw of one has the RMS of the noise at scale 1."""

    def __init__(self, problem: Problem, empty: Hypothesis) -> None:
        self.problem, self._blocks = problem, empty.linear.blocks
        trials = problem.trials
        bases = channel_description(trials[0].model.channel).smooth_bases(trials)
        last = min(float(trial.motion.time_s[-1]) for trial in trials)
        kinds: list[tuple[str, GapAxis, Array, Shape]] = [
            ("step in time", GapAxis.TIME, np.arange(_FIRST_S, last - _STEP_S, _STEP_S), _step),
            ("wave of the position", GapAxis.PERIOD, _frequencies(trials, "depth_mm", _PER_MM), _position_wave),
            ("wave in time", GapAxis.TIME, _frequencies(trials, "time_s", _HZ), _time_wave),
        ]
        raw: list[list[Array]] = [[] for _ in trials]
        every, first = [], 0
        no_places: Array = np.zeros(0)
        for name, basis in bases.items():
            width = basis.functions[0].shape[1]
            every.append(Component(name, basis.axis, first + np.arange(width)[None], no_places))
            for own, each in zip(raw, self._scaled([each[:, None] for each in basis.functions]), strict=True):
                own.append(each)
            first += width
        for name, axis, places, shape in kinds:
            values = [shape(trial, places) for trial in trials]
            width = values[0].shape[2]
            groups = first + np.arange(len(places) * width).reshape(-1, width)
            every.append(Component(name, axis, groups, places, shape))
            for own, each in zip(raw, self._scaled(values), strict=True):
                own.append(each)
            first += len(places) * width
        self.components = tuple(every)
        self.raw = tuple(np.column_stack(each) for each in raw)
        self.columns = self._columns(self.raw)

    def _scaled(self, groups: Sequence[Array]) -> list[Array]:
        """Return groups of columns (n, groups, p) by trial, scaled to the RMS of the noise, as (n, groups * p)."""
        energy = sum((each**2).sum(axis=(0, 2)) for each in groups) / sum(map(len, groups))
        factor = self.problem.calibration.noise.rms / np.sqrt(np.maximum(energy, 1e-300))
        return [(each * factor[:, None]).reshape(len(each), -1) for each in groups]

    def _columns(self, raw: Sequence[Array]) -> Columns:
        problem = self.problem
        whitened = [problem.whiten(trial, number, raw[number]) for number, trial in enumerate(problem.trials)]
        return Columns(self._blocks, whitened)

    def beside(self, here: Hypothesis) -> Beside:
        """Return the evidence of all components beside a hypothesis."""
        columns = here.decorrelated(self.columns)
        projected = here.linear.project(columns, here.levels)
        gains = {each.name: _gains(here, columns, projected, each.groups) for each in self.components}
        prior = here.by_heterogeneity[here.levels]
        total = float(logsumexp(prior))
        return Beside(here, projected, gains, {name: _total(each, prior) - total for name, each in gains.items()})

    def strongest(self, beside: Beside, least: float) -> StrongComponent | None:
        """Return the component with the largest gain at its best place; None if its gain is below `least` nats."""
        here, projected = beside.hypothesis, beside.projected
        prior = here.by_heterogeneity[here.levels]
        component = max(self.components, key=lambda each: beside.log_gains[each.name])
        if beside.log_gains[component.name] < least:
            return None
        gains = beside.gains[component.name]
        index = int(logsumexp(gains + prior[None, :, None], axis=(0, 1)).argmax())
        group = [each[:, component.groups[index]] for each in self.raw]
        columns: Columns = here.decorrelated(self.columns)
        groups: Indices = component.groups[index : index + 1]
        cells = gains.shape[2]
        gains = gains[:, :, index : index + 1]
        if component.shape is not None:  # the best place lies between the points of the grid
            step = float(component.places[1] - component.places[0])
            near = component.places[index] + step * np.linspace(-1, 1, 2 * _FINER + 1)
            raw = self._scaled([component.shape(trial, near) for trial in self.problem.trials])
            columns = here.decorrelated(self._columns(raw))
            groups = np.arange(columns.count).reshape(len(near), -1)
            projected = here.linear.project(columns, here.levels)
            gains = _gains(here, columns, projected, groups)
            index = int(logsumexp(gains + prior[None, :, None], axis=(0, 1)).argmax())
            group = [each[:, groups[index]] for each in raw]
        else:
            index = 0
        total = _total(gains, prior) - math.log(cells)
        by_scale = logsumexp(gains[:, :, index] + prior, axis=1)
        scale = float(AMPLITUDE_SCALES[by_scale.argmax()])
        level = int((gains[by_scale.argmax(), :, index] + prior).argmax())
        matrix = here.linear.normals(columns, projected, groups[index : index + 1])[level, 0]
        fitted = np.linalg.solve(matrix + np.eye(len(matrix)) / scale**2, projected.slope[level, groups[index]])
        extra = Extra(component.name, tuple(group), tuple(each @ fitted for each in group), scale)
        return StrongComponent(total - float(by_scale.max()), extra)


def _gains(here: Hypothesis, columns: Columns, projected: Projected, groups: Indices) -> Array:
    """Return the log evidence ratio of each group by scale and heterogeneity, shape (scales, t, groups)."""
    noise, energy = here.problem.noise_scale, here.linear.energy[here.levels][:, None]
    values, vectors = np.linalg.eigh(here.linear.normals(columns, projected, groups))
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
    return _on_each_axis(trial, np.asarray(trial.motion.time_s[:, None] >= times_s, float)[:, :, None])


def _position_wave(trial: CalibratedTrial, per_mm: Array) -> Array:
    return _on_each_axis(trial, _wave(trial.motion.depth_mm, per_mm))


def _time_wave(trial: CalibratedTrial, frequencies_hz: Array) -> Array:
    return _on_each_axis(trial, _wave(trial.motion.time_s, frequencies_hz))


def _wave(values: Array, frequencies: Array) -> Array:
    angle = 2 * math.pi * values[:, None] * frequencies
    return np.stack([np.sin(angle), np.cos(angle)], axis=2)


def _on_each_axis(trial: CalibratedTrial, values: Array) -> Array:
    """Return columns (samples, places, p) with own coefficients for each axis, (axes * samples, places, axes * p)."""
    axes = len(trial.measured) // len(values)
    if axes == 1:
        return values
    found = np.zeros((axes, len(values), values.shape[1], axes, values.shape[2]))
    for axis in range(axes):
        found[axis, :, :, axis] = values
    return found.reshape(axes * len(values), values.shape[1], -1)


def _frequencies(trials: Sequence[CalibratedTrial], variable: str, ends: tuple[float, float]) -> Array:
    """Return the frequencies of waves that the range of a motion's variable distinguishes."""
    span = max(float(np.ptp(getattr(trial.motion, variable))) for trial in trials)
    return np.arange(*ends, _FREQUENCY_STEP / span)
