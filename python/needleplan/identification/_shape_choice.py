"""Choice of the curvature by depth: uniform, layered or smooth, by insertions that are left out.

For each candidate, each insertion is left out in turn. The mean curvature of the others is its predicted curvature; its
own entry pose is fitted. The score is the mean squared distance of its points from this path. Candidates are equal to
the best if their score exceeds the smallest one by at most the standard error of the difference
(one-standard-error rule: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 7.10) or by at most 5 %.
The one with the fewest coefficients is chosen, and layers rather than a smooth curvature.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from needleplan.identification._curvature_trial import CurvatureTrial
from needleplan.identification._entry_population import MeanPath, mean_path
from needleplan.identification._fitted_arcs import TrackerNoise
from needleplan.identification._insertion_path import EntryPath, PathShape, ShapeKind, layered
from needleplan.models import BetweenDepths, Bicycle, BicycleByDepth, Estimate

__all__ = ["ShapeChoice", "choose_shape", "curvature_estimates", "model_of", "shaped_paths"]

# Smallest number of insertions that can choose: with fewer, the standard error has no degree of freedom.
_FEWEST = 3

# Mean squared distance, relative to the smallest one, up to which fewer coefficients are preferred: with three
# insertions the standard error is too uncertain to be the only criterion.
_EQUAL = 1.05

# Largest heading (rad) at entry that a model stores; at larger ones the path does not advance along +x.
_STEEPEST_RAD = 1.5


@dataclass(frozen=True)
class ShapeChoice:
    """The chosen shape, the fitted paths, and for each candidate the RMS distance (mm) of left-out insertions."""

    shape: PathShape
    paths: tuple[EntryPath, ...]
    scores: tuple[tuple[str, float], ...]
    remark: str


def shaped_paths(trials: Sequence[CurvatureTrial], layers: int | None) -> ShapeChoice:
    """Return the paths of trials with `layers` layers; None: with the shape that cross-validation chooses.

    `identify curvature`, `identify deflection`, `--scenario` and `diagnose` all take their path from here.
    """

    def fit(shape: PathShape, noise: TrackerNoise | None = None) -> tuple[EntryPath, ...]:
        return tuple(trial.path_of(shape, noise) for trial in trials)

    if layers is None:
        # The scores use the fitted values only, so the fast fit for white noise is enough for the candidates.
        choice = choose_shape(partial(fit, noise=TrackerNoise.WHITE))
        return replace(choice, paths=fit(choice.shape))
    paths = fit(PathShape())
    if layers > 1:
        paths = fit(layered(layers, max(path.first_mm for path in paths), min(path.deepest_mm for path in paths)))
    return ShapeChoice(paths[0].shape, paths, (), "")


def choose_shape(fit: Callable[[PathShape], Sequence[EntryPath]]) -> ShapeChoice:
    """Return the choice among one to three layers and two or three knots.

    `fit` returns the paths of all insertions for a shape. With fewer than three insertions, the shape is uniform.
    """
    uniform = tuple(fit(PathShape()))
    if len(uniform) < _FEWEST:
        remark = f"{len(uniform)} insertions do not choose how the curvature depends on the depth: one curvature"
        return ShapeChoice(PathShape(), uniform, (), remark)
    first, last = max(path.first_mm for path in uniform), min(path.deepest_mm for path in uniform)
    candidates = [
        layered(2, first, last),
        PathShape(ShapeKind.SMOOTH, (0.0, last)),
        layered(3, first, last),
        PathShape(ShapeKind.SMOOTH, (0.0, last / 2, last)),
    ]
    fits = [uniform, *(tuple(fit(shape)) for shape in candidates)]
    scores = np.array([_held_out(paths) for paths in fits])
    means = scores.mean(axis=1)
    best = int(np.argmin(means))
    error = (scores - scores[best]).std(axis=1, ddof=1) / np.sqrt(scores.shape[1])
    equal = (means - means[best] <= error) | (means <= _EQUAL * means[best])
    chosen = min(np.flatnonzero(equal), key=lambda number: (fits[number][0].shape.size, number))
    names = [str(paths[0].shape) for paths in fits]
    remark = f"curvature by depth, chosen by insertions left out: {names[int(chosen)]}"
    rms = tuple((name, float(np.sqrt(mean))) for name, mean in zip(names, means, strict=True))
    return ShapeChoice(fits[int(chosen)][0].shape, fits[int(chosen)], rms, remark)


def _held_out(paths: Sequence[EntryPath]) -> list[float]:
    """Return the mean squared distance (mm2) of each insertion from the curvature of the others."""
    return [
        path.misfit(mean_path([*paths[:number], *paths[number + 1 :]]).values[2:]) for number, path in enumerate(paths)
    ]


def curvature_estimates(mean: MeanPath) -> dict[str, Estimate]:
    """Return the estimates of the coefficients of the curvature by the names of the model's parameters."""
    estimates = {}
    for number in range(mean.shape.size):
        estimate = mean.estimate(2 + number, "1/mm")
        name = f"curvature_{number}_per_mm" if number else "curvature_per_mm"
        estimates[name] = Estimate(
            estimate.value,
            estimate.sd,
            estimate.low,
            estimate.high,
            estimate.unit,
            estimate.low > 0 or estimate.high < 0,
            estimate.between_sd,
        )
    return estimates


def model_of(mean: MeanPath) -> Bicycle | BicycleByDepth:
    """Return the model of a mean path, without entry pose if the path does not advance along +x."""
    values = {name: curvature_estimate.value for name, curvature_estimate in curvature_estimates(mean).items()}
    if abs(mean.values[1]) < _STEEPEST_RAD:
        values |= {"offset_mm": float(mean.values[0]), "heading_rad": float(mean.values[1])}
    if mean.shape.kind is ShapeKind.UNIFORM:
        return Bicycle(**values)
    smooth = mean.shape.kind is ShapeKind.SMOOTH
    places = mean.shape.places_mm[1:] if smooth else mean.shape.places_mm
    depths = {f"depth_{number}_mm": place for number, place in enumerate(places, 1)}
    return BicycleByDepth(**values, **depths, between=BetweenDepths.LINEAR if smooth else BetweenDepths.CONSTANT)
