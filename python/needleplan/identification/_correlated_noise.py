"""Least squares under noise that is correlated to an unknown degree.

The noise of samples at positions s_i is taken as a stationary process plus a white part,

    V_ij = sigma^2 ((1 - w) k(|s_i - s_j| / l) + w [i = j]),

with correlation length l, white fraction w and kernel k (the Matern family of smoothness 1/2, 3/2 and 5/2: from rough
to smooth) all unknown. Estimating them and then believing the estimate gives intervals that are too narrow: over a
record of a few correlation lengths nobody can know them well. Here they are integrated out. With them given, the
parameters have a Student distribution around the generalised least-squares estimate (prior 1/sigma); these are mixed
with the weights of the restricted likelihood (Harville, Biometrika 61 (1974) 383)

    |V|^-1/2 |J' V^-1 J|^-1/2 (r' P r)^(-(n - p)/2)

times a prior: one half for noise that is all white, the other for the rest. What that is worth is measured, not proven:
benches/python/curvature.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array

__all__ = ["Marginal", "marginalise"]

_GROUPS = 64
"""Samples are averaged to this many neighbours at most: correlation over less than that is white noise between them."""

_LENGTHS = 14
_WHITE = (1e-4, 0.05, 0.3, 0.7)
_ALL_WHITE = 0.5
_LONGEST = 2.0
"""Longest correlation length considered, in lengths of the record."""

_JITTER = 1e-8
_NEGLIGIBLE = 1e-6
_KERNELS: tuple[tuple[float, Callable[[Array], Array]], ...] = (
    (0.5, lambda x: np.exp(-x)),
    (0.3, lambda x: (1 + np.sqrt(3) * x) * np.exp(-np.sqrt(3) * x)),
    (0.2, lambda x: (1 + np.sqrt(5) * x + 5 / 3 * x**2) * np.exp(-np.sqrt(5) * x)),
)
"""Prior share of each kernel."""


@dataclass(frozen=True)
class Marginal:
    """What the data say of p parameters, the noise integrated out: a mixture of m Student distributions.

    `weights` (m,) sum to one; `centres` (m, p) and `covariances` (m, p, p) are those of the scale; `dof` is common.
    `correlation` is the median correlation length (in the unit of the positions, 0 for white noise), `all_white` the
    probability that the noise is white.
    """

    weights: Array
    centres: Array
    covariances: Array
    dof: int
    correlation: float
    all_white: float

    @property
    def mean(self) -> Array:
        """The parameters, shape (p,)."""
        return np.asarray(self.weights @ self.centres)

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, shape (p, p)."""
        away = self.centres - self.mean
        spread = np.einsum("m,mi,mj->ij", self.weights, away, away)
        return np.asarray(np.tensordot(self.weights, self.covariances, 1) * self.dof / max(self.dof - 2, 1) + spread)

    def below(self, value: float, direction: Array) -> float:
        """Return the probability that `direction` @ parameters is below `value`."""
        from scipy import stats

        centre, scale = self._along(direction)
        return float(self.weights @ stats.t.cdf((value - centre) / scale, self.dof))

    def interval(self, direction: Array, level: float = 0.95) -> tuple[float, float]:
        """Return the central interval of `direction` @ parameters."""
        centre, scale = self._along(direction)
        low, high = ((1 + sign * level) / 2 for sign in (-1, 1))
        return self._quantile(low, centre, scale), self._quantile(high, centre, scale)

    def _quantile(self, share: float, centre: Array, scale: Array) -> float:
        from scipy import stats
        from scipy.optimize import brentq

        each = centre + stats.t.ppf(share, self.dof) * scale
        low, high = float(each.min()), float(each.max())
        if not high > low:
            return low

        def excess(value: float) -> float:
            return float(self.weights @ stats.t.cdf((value - centre) / scale, self.dof)) - share

        margin = 1e-6 * (high - low)
        return float(brentq(excess, low - margin, high + margin, xtol=1e-7 * float(scale.min())))

    def _along(self, direction: Array) -> tuple[Array, Array]:
        variance = np.einsum("i,mij,j->m", direction, self.covariances, direction)
        return self.centres @ direction, np.sqrt(variance)


def marginalise(
    residual: Array, jacobian: Array, position: Array, *, correlated: bool = True, correlation: float | None = None
) -> Marginal:
    """Return what residual = jacobian @ parameters + noise says of the parameters.

    `residual` (n,), `jacobian` (n, p), `position` (n,) in any unit and order. `correlated` False takes white noise for
    granted; `correlation` is the correlation length where it is known from elsewhere, in the unit of the positions.
    Raises DataError for fewer than p + 3 samples, or samples that are all at one position.
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
    """Return correlation length, prior share and kernel of everything that is considered but white noise."""
    rest = 1 - _ALL_WHITE
    if correlation is not None:
        if not 0 < correlation < np.inf:
            raise DataError(Mistake("correlation", f"{correlation:g}", "must be a length above 0"))
        return [(correlation, rest * share, kernel) for share, kernel in _KERNELS]
    length = float(place[-1] - place[0])
    lengths = np.geomspace(length / (2 * place.size), _LONGEST * length, _LENGTHS)
    return [(float(each), rest * share / _LENGTHS, kernel) for share, kernel in _KERNELS for each in lengths]


class _Points:
    """Generalised least squares for all candidates of the noise at once: everything is whitened, first axis m."""

    def __init__(self, residual: Array, jacobian: Array, logdet: Array, cells: Sequence[tuple[float, float]]) -> None:
        self.prior, self.lengths = (np.array(each) for each in zip(*cells, strict=True))
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
