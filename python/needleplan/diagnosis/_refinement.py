"""Start of a fit: the best point of ever finer grids around the screened points of an effect with local optima."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from needleplan.diagnosis._blocks import Indices
from needleplan.diagnosis._constants import CONTENDERS, GAINED, NEIGHBOURHOODS
from needleplan.diagnosis._evidence import Columns
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._tangents import unblended
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.models.effects import SIZE, Effect, effect_columns
from needleplan.signals import Array

__all__ = ["at_points", "contenders", "shared_values"]


def contenders(starts: Sequence[FittedEffect], parent: Hypothesis) -> list[FittedEffect]:
    """Return the points from which an effect may be fitted beside a set: one, or some for a nonlinear effect.

    The points are the best ones of ever finer grids that the effect states around its starts; an effect without local
    optima states none, and keeps its first start. Each point is a linear column beside `parent`, whose base, laws and
    effects give way to it. If the output is in proportion to the amplitude, the best point has the best amplitude. If
    not, the linear column of a large effect says little, and the best points around several starts are returned, the
    best first.
    """
    first, reach = starts[0], parent.problem.reach
    if not first.effect.nearby(first.in_trial(0).values, reach, 1.0):
        return [first]
    several = not _is_proportional(first.effect, parent)
    apart = [_refined(start, NEIGHBOURHOODS[:1], parent) for start in (starts if several else starts[:CONTENDERS])]
    best = sorted(apart, key=lambda pair: -pair[0])[: CONTENDERS if several else 1]
    return [_refined(point, NEIGHBOURHOODS[1:], parent)[1] for _, point in best]


def _is_proportional(effect: Effect, parent: Hypothesis) -> bool:
    """Return whether the output of an effect is in proportion to its amplitude, so that its grid states none."""
    return not any(SIZE in point for point in effect.grid(parent.problem.reach))


def _refined(start: FittedEffect, scales: Sequence[float], parent: Hypothesis) -> tuple[float, FittedEffect]:
    """Return the squared residual that the best point of ever finer grids takes away, and the effect at this point."""
    saved, best = 0.0, start
    for scale in scales:
        own = [best.in_trial(number).values for number in range(len(parent.trials))]
        grids = [[values, *best.effect.nearby(values, parent.problem.reach, scale)] for values in own]
        saved, best = _best_point(best, grids, parent)
    return saved, best


def _best_point(
    first: FittedEffect, grids: Sequence[Sequence[Mapping[str, float]]], parent: Hypothesis
) -> tuple[float, FittedEffect]:
    """Return the largest squared residual that a point takes away from `parent`, and the effect at this point.

    `grids` holds the points by trial, of which the first one stays if no other one gains.
    """
    effect, h = first.effect, parent.best
    columns = Columns(parent.linear.blocks, [_columns(effect, grid, parent, n) for n, grid in enumerate(grids)])
    sizes = np.array([point.get(SIZE, 0.0) for point in grids[0]])
    if effect.by_trial:
        slope, curvature = parent.linear.by_trial(columns, slice(None), h)
        by_trial = 2 * slope * sizes - curvature * sizes**2
        groups = shared_values(effect, grids[0])
        saved = np.array([by_trial[:, group].max(axis=1).sum() for group in groups])
        if saved.max() < by_trial[:, 0].sum() + 2 * GAINED:
            return float(by_trial[:, 0].sum()), first
        group = groups[int(saved.argmax())]
        points = [grid[group[int(own[group].argmax())]] for grid, own in zip(grids, by_trial, strict=True)]
        return float(saved.max()), at_points(first, points)
    projected = parent.linear.project(columns, np.array([h]))
    slope, curvature = projected.slope[0], projected.curvature[0]
    if _is_proportional(effect, parent):
        what = effect.parameters[SIZE]
        permitted = first.bounds.get(SIZE, (what.lower, what.upper))
        sizes = np.clip(slope / np.maximum(curvature, 1e-300), *permitted)
    saved = 2 * slope * sizes - curvature * sizes**2
    index = int(saved.argmax()) if saved.max() > saved[0] + 2 * GAINED else 0
    values = {**grids[0][index], SIZE: float(sizes[index]) or first.values[SIZE]}
    return float(saved[index]), replace(first, values=values)


def _columns(effect: Effect, grid: Sequence[Mapping[str, float]], parent: Hypothesis, number: int) -> Array:
    """Return the whitened columns of an effect at grid points beside the base of a trial; zero in a reference."""
    trial = parent.trials[number]
    if trial.is_reference:
        return np.zeros((len(trial.whitened.residual), len(grid)))
    columns = effect_columns(effect, unblended(trial.model), trial.motion, grid)
    return parent.problem.whiten(trial, number, columns)


def shared_values(effect: Effect, grid: Sequence[Mapping[str, float]]) -> list[Indices]:
    """Group the grid points that differ only in parameters with a separate value for every trial; return indices."""
    groups: dict[tuple[float, ...], list[int]] = {}
    for index, values in enumerate(grid):
        key = tuple(value for name, value in values.items() if name not in effect.by_trial)
        groups.setdefault(key if effect.by_trial else (index,), []).append(index)
    return [np.array(group, np.intp) for group in groups.values()]


def at_points(effect: FittedEffect, points: Sequence[Mapping[str, float]]) -> FittedEffect:
    """Return an effect at a grid point, or at one for each trial that differ in the trials' own parameters."""
    own = tuple({name: point[name] for name in effect.effect.by_trial} for point in points)
    return replace(effect, values=points[0], own=own if effect.effect.by_trial else ())
