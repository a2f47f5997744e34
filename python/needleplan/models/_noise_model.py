"""Correlation of the residuals of a fit, and the covariance of least-squares estimates under it.

The noise is an autoregressive process, r_i = a_1 r_(i-1) + ... + a_p r_(i-p) + e_i. The coefficients follow from the
autocovariances of the residuals (Yule-Walker), pooled over the records, and the order p from the BIC. With the
covariance matrix R of this process, the estimates of a fit with the Jacobian J have the covariance

    C = A S A,    A = (J'J)^-1,    S = J' R J

A kernel estimator of S (Newey and West) is too small for slow columns of J, because the fit has removed the slow part
of the noise from the residuals. The process extrapolates the slow part from neighbouring samples.
Its autocovariances are corrected for the part that the fit has removed: with H = J A J', the residuals have the
covariance (I - H) R (I - H), so the sums of r_i r_(i+k) are too small by those of H R + R H - H R H, which are added
for the present R, `_ROUNDS` times.

The variance of an estimate is uncertain itself. It is s^2 h(a), with the variance s^2 of the innovations e and a
function h of the coefficients a, whose estimates have the covariance s^2 G^-1 / n, with the p autocovariances of
neighbouring samples in the Toeplitz matrix G. Satterthwaite's degrees of freedom (Biometrics Bulletin 2 (1946) 110)
of this variance are those of the t quantile, for every parameter::

    2 / (2/n + (d ln h / d a)' (s^2 G^-1 / n) (d ln h / d a))

For AR(1) with the coefficient 0.9 and a slow column of J, these are n/39. The effective number of samples for the
variance of a sample, n/9.5, would give too narrow intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import toeplitz

from needleplan.signals import Array

__all__ = ["NoiseModel", "noise_model"]

# Largest order of the process; a force sensor that averages five samples needs about twice as many.
_MOST_ORDER = 24
# Correlation below which later lags are left out, and largest share of a record that the lags reach.
_NEGLIGIBLE, _FARTHEST = 1e-4, 0.5
# Number of corrections of the autocovariances, and largest share of the variance that counts as removed by the fit.
_ROUNDS, _REMOVED = 4, 0.5
# Step of a coefficient for derivatives, in units of its standard deviation.
_STEP = 0.05
# Length of the impulse response, in units of the lags that count.
_RESPONSE = 4


@dataclass(frozen=True)
class NoiseModel:
    """Noise of a fit.

    - `variance`: variance of a sample
    - `correlation`: autocorrelation at the lags 0, 1 ..., shape (lags,), with 1 at lag 0
    - `order`: order p of the process
    """

    variance: float
    correlation: Array
    order: int
    coefficients: Array = field(default_factory=lambda: np.zeros(0))

    def spread(self, jacobian: Array) -> Array:
        """Return R J for unit variance and the Jacobian of one record, shape (samples, parameters)."""
        count = len(jacobian)
        if not count:
            return jacobian
        lags = min(len(self.correlation), count)
        width = 1 << int(count + lags).bit_length()
        kernel = np.zeros(width)
        kernel[:lags] = self.correlation[:lags]
        kernel[width - lags + 1 :] = self.correlation[1:lags][::-1]
        product = np.fft.rfft(jacobian, width, axis=0) * np.fft.rfft(kernel).real[:, None]
        return np.asarray(np.fft.irfft(product, width, axis=0)[:count])

    def score_covariance(self, jacobians: Sequence[Array]) -> Array:
        """Return S, summed over the Jacobians of the records, shape (parameters, parameters)."""
        total = self.variance * np.sum([jacobian.T @ self.spread(jacobian) for jacobian in jacobians], axis=0)
        return np.asarray((total + total.T) / 2)

    def freedom(self, jacobians: Sequence[Array], inverse: Array, samples: int) -> Array:
        """Return the degrees of freedom of each parameter's estimated variance, shape (parameters,).

        `inverse` is the matrix A of the module docstring, and `samples` the number of samples of all records.
        """
        plain = max(samples - len(inverse), 1)
        if not self.order:
            return np.full(len(inverse), float(plain))
        count = len(self.correlation)

        def logarithms(coefficients: Array) -> Array:
            covariance = _autocovariance(coefficients, count)
            noise = NoiseModel(float(covariance[0]), covariance / covariance[0], self.order)
            variances = np.diagonal(inverse @ noise.score_covariance(jacobians) @ inverse)
            return np.log(np.maximum(variances, 1e-300))

        covariance = _autocovariance(self.coefficients, max(self.order, 1))
        spread = np.linalg.pinv(toeplitz(covariance[: self.order])) / plain
        steps = _STEP * np.sqrt(np.diagonal(spread))
        slopes = np.array([
            (logarithms(self.coefficients + step * row) - logarithms(self.coefficients - step * row)) / (2 * step)
            for step, row in zip(steps, np.eye(self.order), strict=True)
        ])  # fmt: skip
        relative = 2 / plain + np.einsum("ij,ik,kj->j", slopes, spread, slopes)
        return np.asarray(np.clip(2 / relative, 1.0, plain))


def noise_model(residuals: Sequence[Array], jacobians: Sequence[Array], inverse: Array) -> NoiseModel:
    """Return the process that fits the residuals of the records, shape (samples,) each, without gaps.

    `jacobians` are the Jacobians of the records, shape (samples, parameters) each, `inverse` is A.
    """
    count = sum(residual.size for residual in residuals)
    longest = max(residual.size for residual in residuals)
    most = max(min(_MOST_ORDER, longest // 10), 0)
    seen = np.sum([_products(residual[:, None], residual[:, None], most) for residual in residuals], axis=0)
    if not seen[0] > 0:
        return NoiseModel(0.0, np.ones(1), 0)
    process = _process(seen / count, count, int(_FARTHEST * longest))
    for _ in range(_ROUNDS):
        removed = _removed(process, jacobians, inverse, most)
        removed *= min(1.0, _REMOVED * count / max(removed[0], 1e-300))
        variance = seen[0] / (count - removed[0])
        process = _process(seen / count + variance * removed / count, count, int(_FARTHEST * longest))
    return process


def _removed(noise: NoiseModel, jacobians: Sequence[Array], inverse: Array, most: int) -> Array:
    """Return the sums, for every lag, by which a fit reduces the products of unit variance, shape (most + 1,)."""
    spread = [noise.spread(jacobian) for jacobian in jacobians]
    scores = np.sum([jacobian.T @ wide for jacobian, wide in zip(jacobians, spread, strict=True)], axis=0)
    inner = inverse @ scores @ inverse
    total = np.zeros(most + 1)
    for each, wide in zip(jacobians, spread, strict=True):
        known = each @ inverse
        total += _products(known, wide, most) + _products(wide, known, most) - _products(each @ inner, each, most)
    return total


def _process(covariance: Array, count: int, farthest: int) -> NoiseModel:
    """Return the process with these autocovariances (Levinson and Durbin), with the order of the smallest BIC."""
    variance, coefficients = float(covariance[0]), np.zeros(0)
    best, chosen = count * np.log(variance), coefficients
    for order in range(1, len(covariance)):
        reflection = float(covariance[order] - coefficients @ covariance[order - 1 : 0 : -1]) / variance
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        variance *= 1 - reflection**2
        if not variance > 0:
            break
        score = count * np.log(variance) + order * np.log(count)
        if score < best:
            best, chosen = score, coefficients
    return NoiseModel(float(covariance[0]), _correlation(chosen, covariance, farthest), chosen.size, chosen)


def _autocovariance(coefficients: Array, count: int) -> Array:
    """Return the autocovariances at the lags 0 to count - 1 of a process with innovations of unit variance."""
    from scipy.signal import lfilter  # takes a second to import

    length = max(_RESPONSE * count, 64)
    response = lfilter([1.0], np.concatenate([[1.0], -coefficients]), np.eye(1, length)[0])
    power = np.abs(np.fft.rfft(response, 2 * length)) ** 2
    return np.asarray(np.fft.irfft(power)[:count])


def _products(left: Array, right: Array, most: int) -> Array:
    """Return the sums of left_i right_(i+k), over all columns, for the lags 0 to `most`; shape (samples, columns)."""
    size = len(left)
    return np.array([float(np.sum(left[: size - lag] * right[lag:])) for lag in range(most + 1)])


def _correlation(coefficients: Array, covariance: Array, most: int) -> Array:
    """Return the autocorrelation of a process up to the lag from which on it is negligible, at most to `most`."""
    order = coefficients.size
    if not order:
        return np.ones(1)
    correlation = (covariance[: order + 1] / covariance[0]).tolist()
    backwards = coefficients[::-1]
    quiet = 0
    while len(correlation) < most and quiet < 2 * order + 8:
        correlation.append(float(backwards @ correlation[-order:]))
        quiet = quiet + 1 if abs(correlation[-1]) < _NEGLIGIBLE else 0
    return np.array(correlation)
