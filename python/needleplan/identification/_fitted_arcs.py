"""The estimator of a tip path: an arc chain fitted to tracked points, with intervals of its curvatures.

The chain is fitted by minimising the squared distances of the points. The noise of the distances has an unknown
correlation along the path; `_correlated_noise` integrates over this correlation and computes the intervals. Everything
that estimates a path from points goes through `fit_arcs`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.identification._arc_chain import ArcChain
from needleplan.identification._correlated_noise import Marginal, marginalise
from needleplan.signals import Array

__all__ = ["Curvature", "CurvatureChange", "FittedArcs", "TrackerNoise", "fit_arcs"]

# Width of a normal 95 % interval in standard deviations.
_INTERVAL_SDS = 2 * 1.959964


class TrackerNoise(StrEnum):
    """Assumption about the noise of neighbouring points."""

    CORRELATED = "correlated"
    """Correlated along the path over an unknown length, as for a tracker with field distortion."""

    WHITE = "white"
    """Independent from point to point."""


@dataclass(frozen=True)
class CurvatureChange:
    """Curvature (1/mm) of a segment minus the curvature of the segment before, with 95 % interval."""

    value_per_mm: float
    low_per_mm: float
    high_per_mm: float
    p_value: float
    """Probability of a difference at least as large if both curvatures are equal (two-sided)."""


@dataclass(frozen=True)
class Curvature(ShortRepr):
    """Curvature (1/mm) of a path or segment, positive to the left, with standard deviation and 95 % interval.

    - `rms_mm`: root mean square distance of all points from the fitted path, also outside of the segment
    - `correlation_mm`: median correlation length of the distances along the path; 0 means white noise
    - `samples`: number of points of the segment
    - `low_mm`, `high_mm`: positions along the path at which the segment begins and ends
    """

    curvature_per_mm: float
    sd_per_mm: float
    low_per_mm: float
    high_per_mm: float
    rms_mm: float
    correlation_mm: float
    samples: int
    low_mm: float
    high_mm: float

    @property
    def radius_mm(self) -> float:
        """Radius (mm), positive; infinite for a straight path."""
        return abs(1 / self.curvature_per_mm) if self.curvature_per_mm else float("inf")

    @property
    def interval_sd_per_mm(self) -> float:
        """Standard deviation (1/mm) of the normal distribution with a 95 % interval of the same width.

        `sd_per_mm` itself is dominated by the tails of few candidates with long correlation lengths.
        """
        return (self.high_per_mm - self.low_per_mm) / _INTERVAL_SDS

    @property
    def bends(self) -> bool:
        """Whether the interval excludes a straight path."""
        return self.low_per_mm > 0 or self.high_per_mm < 0


@dataclass(frozen=True)
class FittedArcs(ShortRepr):
    """An arc chain fitted to points.

    - `chain`: the chain.
    - `start`: its unknowns with the least sum of squared distances, shape (p,).
    - `errors`: distribution of the true unknowns minus `start`.
    """

    chain: ArcChain
    start: Array
    errors: Marginal

    @property
    def values(self) -> Array:
        """Estimates of the unknowns, shape (p,)."""
        return np.asarray(self.start + self.errors.mean)

    @property
    def distances_mm(self) -> Array:
        """Signed distances (mm) of the points from the chain, shape (n,): positive to its left."""
        return self.chain.distance(self.values)

    @property
    def rms_mm(self) -> float:
        """Root mean square distance (mm) of the points from the chain."""
        return float(np.sqrt(np.mean(self.distances_mm**2)))

    @property
    def covariance(self) -> Array:
        """Matrix with the correlations of the errors and the widths of their 95 % intervals, shape (p, p).

        The covariance itself is dominated by the tails of few candidates with long correlation lengths.
        """
        sd = np.sqrt(np.diagonal(self.errors.covariance))
        reach = [high - low for low, high in (self.errors.interval(row) for row in np.eye(sd.size))]
        scale = np.array(reach) / _INTERVAL_SDS / sd
        return np.asarray(self.errors.covariance * np.outer(scale, scale))

    @cached_property
    def segments(self) -> tuple[Curvature, ...]:
        """Curvature of each arc if each arc has its own coefficient, else of the whole path."""
        chain, rms, values = self.chain, self.rms_mm, self.values
        curvatures = []
        for number, row in enumerate(self._rows()):
            low, high = self.errors.interval(row)
            centre, sd = float(row @ self.start), float(np.sqrt(row @ self.errors.covariance @ row))
            curvatures.append(Curvature(
                float(row @ values), sd, centre + low, centre + high, rms, self.errors.correlation,
                int((chain.index == number).sum()), float(chain.edges[number]), float(chain.edges[number + 1]),
            ))  # fmt: skip
        return tuple(curvatures)

    @cached_property
    def changes(self) -> tuple[CurvatureChange, ...]:
        """Changes of the curvature between neighbouring segments."""
        rows, changes = self._rows(), []
        for direction in rows[1:] - rows[:-1]:
            low, high = self.errors.interval(direction)
            base = float(direction @ self.start)
            below = self.errors.below(-base, direction)
            changes.append(CurvatureChange(
                float(direction @ self.values), base + low, base + high, 2 * min(below, 1 - below)
            ))  # fmt: skip
        return tuple(changes)

    def _rows(self) -> Array:
        """Return the rows that select the coefficients of the curvature from the unknowns, shape (m, p)."""
        return np.eye(self.start.size)[-self.chain.size :]


def fit_arcs(chain: ArcChain, *, noise: TrackerNoise, correlation_mm: float | None = None) -> FittedArcs:
    """Return the chain fitted to its points.

    `noise` is the assumption about the noise of neighbouring points, and `correlation_mm` its correlation length along
    the path, if known. Raises DataError for too few points, or a correlation length that is not positive.
    """
    start = chain.solve()
    errors = marginalise(
        chain.distance(start), -chain.jacobian(start), chain.position,
        correlated=noise is TrackerNoise.CORRELATED, correlation=correlation_mm,
    )  # fmt: skip
    return FittedArcs(chain, start, errors)
