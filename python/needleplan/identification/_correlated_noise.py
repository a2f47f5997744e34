"""Least squares under noise with an unknown correlation.

The noise of samples at positions s_i is modelled as a stationary process plus white noise::

    V_ij = sigma^2 ((1 - w) k(|s_i - s_j| / l) + w [i = j])

The correlation length l, the white fraction w and the kernel k (Matern, smoothness 1/2, 3/2 or 5/2) are unknown. A
record of a few correlation lengths does not determine them, and intervals at their point estimates are too narrow.
l, w and k are therefore integrated out: given l, w and k, the parameters have a Student distribution around the
generalised least-squares estimate (prior 1/sigma). The distributions are mixed with weights proportional to a prior
times the restricted likelihood (Harville, Biometrika 61 (1974) 383)::

    |V|^-1/2 |J' V^-1 J|^-1/2 (r' P r)^(-(n - p)/2)

The prior probability of white noise is one half. The coverage of the intervals is measured by
benches/python/curvature.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array

__all__ = ["Marginal", "marginalise"]

# Largest number of groups of neighbouring samples that are averaged; correlation within a group counts as white noise.
_GROUPS = 64

# Number of correlation lengths, spaced geometrically.
_LENGTHS = 14

# Values of the white fraction w.
_WHITE = (1e-4, 0.05, 0.3, 0.7)

# Prior probability that the noise is white.
_ALL_WHITE = 0.5

# Longest correlation length, relative to the length of the record.
_LONGEST = 2.0

# Addition to the white fraction that keeps the Cholesky factorisation stable.
_JITTER = 1e-8

# Weight of a candidate, relative to the largest weight, below which it is dropped.
_NEGLIGIBLE = 1e-6

# Prior probability (given correlated noise) and correlation function of each kernel.
_KERNELS: tuple[tuple[float, Callable[[Array], Array]], ...] = (
    (0.5, lambda x: np.exp(-x)),
    (0.3, lambda x: (1 + np.sqrt(3) * x) * np.exp(-np.sqrt(3) * x)),
    (0.2, lambda x: (1 + np.sqrt(5) * x + 5 / 3 * x**2) * np.exp(-np.sqrt(5) * x)),
)


@dataclass(frozen=True)
class Marginal:
    """Distribution of p parameters after integration over the noise models: a mixture of m Student distributions.

    - `weights`: weights of the distributions, shape (m,); the sum is one
    - `centres`, `covariances`: centres, shape (m, p), and scale matrices, shape (m, p, p), of the distributions
    - `dof`: number of degrees of freedom of all distributions
    - `correlation`: median correlation length in the unit of the positions; 0 means white noise
    - `all_white`: probability that the noise is white
    """

    weights: Array
    centres: Array
    covariances: Array
    dof: int
    correlation: float
    all_white: float

    @property
    def mean(self) -> Array:
        """Mean of the parameters, shape (p,)."""
        return np.asarray(self.weights @ self.centres)

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, shape (p, p)."""
        away = self.centres - self.mean
        spread = np.einsum("m,mi,mj->ij", self.weights, away, away)
        return np.asarray(np.tensordot(self.weights, self.covariances, 1) * self.dof / max(self.dof - 2, 1) + spread)

    def below(self, value: float, direction: Array) -> float:
        """Return the probability that `direction` @ parameters is below `value`."""
        centre, scale = self._along(direction)
        return float(self.weights @ stdtr(self.dof, (value - centre) / scale))

    def interval(self, direction: Array, level: float = 0.95) -> tuple[float, float]:
        """Return the central interval of `direction` @ parameters with the probability `level`."""
        centre, scale = self._along(direction)
        low, high = ((1 + sign * level) / 2 for sign in (-1, 1))
        return self._quantile(low, centre, scale), self._quantile(high, centre, scale)

    def _quantile(self, share: float, centre: Array, scale: Array) -> float:
        from scipy.optimize import brentq

        quantiles = centre + stdtrit(self.dof, share) * scale
        low, high = float(quantiles.min()), float(quantiles.max())
        if not high > low:
            return low

        def excess(value: float) -> float:
            return float(self.weights @ stdtr(self.dof, (value - centre) / scale)) - share

        margin = 1e-6 * (high - low)
        return float(brentq(excess, low - margin, high + margin, xtol=1e-7 * float(scale.min())))

    def _along(self, direction: Array) -> tuple[Array, Array]:
        variance = np.einsum("i,mij,j->m", direction, self.covariances, direction)
        return self.centres @ direction, np.sqrt(variance)


def marginalise(
    residual: Array, jacobian: Array, position: Array, *, correlated: bool = True, correlation: float | None = None
) -> Marginal:
    """Return the distribution of the parameters in the model residual = jacobian @ parameters + noise.

    `residual` has the shape (n,), `jacobian` (n, p), and `position` (n,), in any unit and order. If `correlated` is
    False, the noise is white. `correlation` is the correlation length in the unit of the positions, or None if unknown.
    Raises DataError for fewer than p + 3 samples, if all samples have the same position, and if `correlation` is not a
    positive number.
    """
    samples, parameters = jacobian.shape
    if samples < parameters + 3:
        rule = f"too short: {parameters} parameters with an interval need at least {parameters + 3} samples"
        raise DataError(Mistake("samples", str(samples), rule))
    if not np.ptp(position) > 0:
        raise DataError(Mistake("position", f"{position[0]:g}", "is constant: the samples are all at one place"))
    if not correlated:
        points = _Points(residual[None], jacobian[None], np.zeros(1), [(1.0, 0.0)])
        return points.mixture()
    order = np.argsort(position, kind="stable")
    groups = np.array_split(order, min(_GROUPS, samples))
    counts = np.array([len(group) for group in groups], float)
    place = np.array([position[group].mean() for group in groups])
    mean_residual = np.array([residual[group].mean() for group in groups])
    mean_jacobian = np.array([jacobian[group].mean(axis=0) for group in groups])
    apart = np.abs(place[:, None] - place)
    white = np.diag(counts.mean() / counts)
    matrices, cells = [white], [(_ALL_WHITE, 0.0)]
    for length, share, kernel in _candidates(place, correlation):
        smooth = kernel(apart / length)
        for fraction in _WHITE:
            matrices.append((1 - fraction) * smooth + (fraction + _JITTER) * white)
            cells.append((share / len(_WHITE), length))
    whitening = np.linalg.inv(np.linalg.cholesky(np.array(matrices)))
    logdet = -2 * np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum(axis=1)
    points = _Points(whitening @ mean_residual, whitening @ mean_jacobian, logdet, cells)
    return points.mixture()


def _candidates(place: Array, correlation: float | None) -> Sequence[tuple[float, float, Callable[[Array], Array]]]:
    """Return correlation length, prior probability and kernel of each candidate for correlated noise.

    `place` holds increasing positions. Raises DataError if the known length `correlation` is not positive and finite.
    """
    rest = 1 - _ALL_WHITE
    if correlation is not None:
        if not 0 < correlation < np.inf:
            raise DataError(Mistake("correlation", f"{correlation:g}", "must be a length above 0"))
        return [(correlation, rest * share, kernel) for share, kernel in _KERNELS]
    length = float(place[-1] - place[0])
    lengths = np.geomspace(length / (2 * place.size), _LONGEST * length, _LENGTHS)
    return [(float(each), rest * share / _LENGTHS, kernel) for share, kernel in _KERNELS for each in lengths]


class _Points:
    """Generalised least squares for all m candidates of the noise at once, on whitened data.

    The first axis of every array is the candidate. `cells` holds prior probability and correlation length of each.
    """

    def __init__(self, residual: Array, jacobian: Array, logdet: Array, cells: Sequence[tuple[float, float]]) -> None:
        self.prior, self.lengths = (np.array(array) for array in zip(*cells, strict=True))
        self.dof = jacobian.shape[1] - jacobian.shape[2]
        normal = np.einsum("mni,mnj->mij", jacobian, jacobian)
        size = np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
        scaled = normal / size[:, :, None] / size[:, None, :]
        self.inverse = np.linalg.inv(scaled) / size[:, :, None] / size[:, None, :]
        score = np.einsum("mni,mn->mi", jacobian, residual)
        self.centres = np.einsum("mij,mj->mi", self.inverse, score)
        left = residual - np.einsum("mni,mi->mn", jacobian, self.centres)
        self.variance = np.maximum((left**2).sum(axis=1), 1e-300) / self.dof
        logs = np.linalg.slogdet(scaled)[1] + 2 * np.log(size).sum(axis=1)
        self.likelihood = -0.5 * (logdet + logs + self.dof * np.log(self.variance))

    def mixture(self) -> Marginal:
        """Return the mixture of the candidates whose weights are not negligible."""
        weights = self.prior * np.exp(self.likelihood - self.likelihood.max())
        kept = np.flatnonzero(weights > _NEGLIGIBLE * weights.max())
        weights = weights[kept] / weights[kept].sum()
        lengths = self.lengths[kept]
        order = np.argsort(lengths)
        middle = int(np.searchsorted(np.cumsum(weights[order]), 0.5))
        return Marginal(
            weights,
            self.centres[kept],
            self.variance[kept][:, None, None] * self.inverse[kept],
            self.dof,
            float(lengths[order[min(middle, lengths.size - 1)]]),
            float(weights[lengths == 0].sum()),
        )
