"""Curvature of a needle path from tracked points, with an interval whose coverage was measured.

The path is a chain of tangent arcs: from the entry pose with curvature k_1 up to the first edge, then k_2 up to the
second edge, and so on. A path without edges is one circle. `fit_arcs` fits it. The parameter is the curvature, not the
radius, because errors of the curvature are symmetric and zero is an ordinary value.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._arc_chain import ArcChain, along_circle
from needleplan.identification._circle import checked_points, fit_circle
from needleplan.identification._fitted_arcs import Curvature, CurvatureChange, TrackerNoise, fit_arcs
from needleplan.models import arc_step
from needleplan.signals import Array

__all__ = [
    "Curvature",
    "CurvatureChange",
    "PathForm",
    "TrackerNoise",
    "arc_curvature",
    "path_curvature",
]


class PathForm(StrEnum):
    """Prior knowledge of the entry pose."""

    FREE = "free"
    """The entry pose is unknown and fitted too (3 parameters for one arc)."""

    TANGENT = "tangent"
    """The path starts at the given pose `entry` (1 parameter for one arc); a wrong pose biases the result."""


def arc_curvature(
    points_mm: Array,
    *,
    form: PathForm = PathForm.FREE,
    entry: tuple[float, float, float] | None = None,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
) -> Curvature:
    """Return the curvature of a path of one arc, with its interval.

    Parameters
    ----------
    points_mm
        Points, shape (n, 2), in their order along the path.
    form
        Whether the entry pose is fitted or given.
    entry
        Entry pose (x_mm, y_mm, heading_rad) for the form TANGENT.
    noise
        Assumption about the noise of neighbouring points.
    correlation_mm
        Correlation length of the tracker along the path, if known.

    Returns
    -------
    Curvature

    Raises
    ------
    DataError
        There are too few points, points that are not finite or all coincide, no entry for the form TANGENT, or a
        correlation length that is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import arc_step
    >>> x, y, _ = arc_step(0.0, 0.0, 0.0, 1 / 300, np.linspace(0, 80, 200))
    >>> points = np.column_stack([x, y]) + np.random.default_rng(0).normal(0, 0.1, (200, 2))
    >>> found = arc_curvature(points)
    >>> found.low_per_mm < 1 / 300 < found.high_per_mm
    True
    """
    segments, _ = path_curvature(points_mm, form=form, entry=entry, noise=noise, correlation_mm=correlation_mm)
    return segments[0]


def path_curvature(
    points_mm: Array,
    edges_mm: Sequence[float] = (),
    *,
    position_mm: Array | None = None,
    form: PathForm = PathForm.FREE,
    entry: tuple[float, float, float] | None = None,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
) -> tuple[tuple[Curvature, ...], tuple[CurvatureChange, ...]]:
    """Return the curvature of every segment of a path, and the changes between neighbouring segments.

    Parameters
    ----------
    points_mm
        Points, shape (n, 2), in their order along the path.
    edges_mm
        Increasing positions at which the curvature may change, in the scale of `position_mm`.
    position_mm
        Position of each point along the path, shape (n,), such as its depth. The default is the distance from the
        first point along the fitted circle.
    form, entry, noise, correlation_mm
        As for `arc_curvature`.

    Returns
    -------
    tuple of Curvature
        One curvature for each segment.
    tuple of CurvatureChange
        One change for each edge.

    Raises
    ------
    DataError
        As for `arc_curvature`; or `position_mm` is not one finite number for each point, the edges do not increase
        inside the path, or a segment has fewer than 5 points.
    """
    points = checked_points(points_mm)
    path = _chain(points, edges_mm, position_mm, form, entry)
    fitted = fit_arcs(path, noise=noise, correlation_mm=correlation_mm)
    return fitted.segments, fitted.changes


def _chain(
    points: Array,
    edges_mm: Sequence[float],
    position_mm: Array | None,
    form: PathForm,
    entry: tuple[float, float, float] | None,
) -> ArcChain:
    """Return the chain of arcs with one curvature for each segment.

    Raises DataError for wrong positions, edges or segments, and if the form TANGENT has no entry.
    """
    circle = fit_circle(points)
    along = along_circle(points, circle)
    position = along - along.min() if position_mm is None else np.asarray(position_mm, float)
    if position.shape != (len(points),) or not np.isfinite(position).all():
        raise DataError(Mistake("position_mm", "", f"must be {len(points)} finite numbers"))
    begin, end = float(position.min()), float(position.max())
    edges = np.array([begin, *edges_mm, end])
    if (np.diff(edges) <= 0).any():
        rule = f"must increase between {begin:.4g} and {end:.4g} mm, the range of the points"
        raise DataError(Mistake("edges_mm", ", ".join(f"{edge_mm:g}" for edge_mm in edges_mm), rule))
    if form is PathForm.FREE:
        x, y, heading = arc_step(*circle.point_mm, circle.heading_rad, circle.curvature_per_mm, float(along.min()))
        pose = (float(x), float(y), float(heading))
    elif entry is None:
        raise DataError(Mistake("entry", "", "is needed for the form tangent"))
    else:
        pose = entry
    chain = ArcChain(points, position, edges, pose, circle.curvature_per_mm, free=form is PathForm.FREE)
    chain.require_points()
    return chain
