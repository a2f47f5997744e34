"""Evidence of a linear Gaussian model: residual = J d + F f + h U S z + e, with priors on all coefficients.

W is the inverse covariance of the white noise e and the heterogeneity h U S z. d is projected out per trial, f is
shared by all trials and integrated out with its prior precision. All products exist for t heterogeneities h at once.
Notation: docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from needleplan.signals import Array

__all__ = ["HETEROGENEITY_SDS", "Block", "Columns", "Indices", "LinearModel", "NoiseScale", "Projected"]

Indices = NDArray[np.intp]

HETEROGENEITY_SDS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
"""Standard deviations of the tissue's heterogeneity that are summed over, relative to the mean of its property."""

# Share of a column's energy that other columns leave, below which the rest is rounding error.
_ROUNDING = 1e-8
# Relative ridge of normal matrices.
_RIDGE = 1e-10


@dataclass(frozen=True)
class NoiseScale:
    """Noise variance that is known only as well as `freedom` samples of noise determine it, integrated out.

    The variance of the noise, in units of its estimate, has a scaled inverse chi-squared prior. All other variances are
    taken in units of it, so that the marginal likelihood of the readings is Student's.
    """

    freedom: float
    """Degrees of freedom of the estimate of the noise variance; infinite if the noise is known."""

    count: int
    """Number of readings."""

    def log_likelihood(self, energy: Array) -> Array:
        """Return the log-likelihood for a squared residual that has been minimised and whitened; 0 for none."""
        if math.isinf(self.freedom):
            return np.asarray(-0.5 * energy)
        return np.asarray(-0.5 * (self.freedom + self.count) * np.log1p(energy / self.freedom))

    def variance(self, energy: Array) -> Array:
        """Return the most probable variance of the noise, in units of its estimate."""
        if math.isinf(self.freedom):
            return np.ones_like(energy)
        return np.asarray((self.freedom + energy) / (self.freedom + self.count))


@dataclass(frozen=True)
class Block:
    """One whitened trial: residual (n,), base sensitivities (n, q) of norm 1, tissue modes (n, k) and variances (k,).

    The rows of `base` end with the priors of its q coefficients, a diagonal block.
    """

    residual: Array
    base: Array
    modes: Array
    variances: Array
    log_volume: float = 0.0
    """Log determinant of the covariance of errors that this block alone is whitened by, times -1/2."""

    @cached_property
    def weights(self) -> Array:
        """Share of each mode's energy that W removes, shape (t, k)."""
        varied = HETEROGENEITY_SDS[:, None] ** 2 * self.variances
        return np.asarray(varied / (1 + varied))

    @cached_property
    def log_scale(self) -> float:
        """Logarithm of the norms by which the columns of `base` were divided, summed."""
        q = self.base.shape[1]
        return -float(np.log(np.maximum(np.diag(self.base[len(self.base) - q :]), 1e-300)).sum())


class Columns:
    """Fixed columns of all trials, one array (n, m) per trial, with their products with the tissue modes."""

    def __init__(self, blocks: Sequence[Block], values: Sequence[Array]) -> None:
        self.values = tuple(values)
        self.moved = tuple(block.modes.T @ each for block, each in zip(blocks, values, strict=True))
        self.squares = tuple(np.einsum("nm,nm->m", each, each) for each in values)
        self.curved = tuple(block.weights @ each**2 for block, each in zip(blocks, self.moved, strict=True))

    @property
    def count(self) -> int:
        """Number of columns m."""
        return int(self.values[0].shape[1])


@dataclass(frozen=True)
class Projected:
    """Columns with J and F projected out: slope and curvature of the log-likelihood, both of shape (t, m).

    Only the heterogeneities `levels` are computed: those that the data permit.
    """

    levels: Indices
    slope: Array
    curvature: Array
    cross: Array
    """Products of F and the columns with J projected out, shape (t, f, m)."""

    halves: tuple[Array, ...]
    """For each trial, root J'W X, shape (t, q, m)."""


class LinearModel:
    """A linear Gaussian model of all trials; `basis` holds F by trial (n, f), `precision` its prior (f,).

    Products are computed when they are asked for first.
    """

    def __init__(self, blocks: Sequence[Block], basis: Sequence[Array], precision: Array) -> None:
        self.blocks, self.basis, self.precision = tuple(blocks), tuple(basis), np.asarray(precision, float)

    @cached_property
    def _trials(self) -> list[_TrialProducts]:
        return [_TrialProducts.of(block, each) for block, each in zip(self.blocks, self.basis, strict=True)]

    @cached_property
    def parts(self) -> Array:
        """Normal matrices of [F r] with J projected out, shape (trials, t, f + 1, f + 1)."""
        return np.stack([each.rest for each in self._trials])

    @cached_property
    def _whole(self) -> Array:
        return np.asarray(self.parts.sum(axis=0))

    @cached_property
    def posterior_precision(self) -> Array:
        """Posterior precision of f, shape (t, f, f)."""
        return self._whole[:, :-1, :-1] + np.diag(self.precision + 1e-12)

    @property
    def target(self) -> Array:
        """Right side of the normal equations of f, shape (t, f)."""
        return self._whole[:, :-1, -1]

    @property
    def unfitted(self) -> Array:
        """Squared residual with J projected out, shape (t,)."""
        return self._whole[:, -1, -1]

    @cached_property
    def logs(self) -> Array:
        """Log determinants of J and of the tissue, times -1/2, shape (t,)."""
        return np.asarray(-0.5 * np.sum([each.logs for each in self._trials], axis=0))

    @cached_property
    def inverse(self) -> Array:
        """Inverse of the posterior precision of f, shape (t, f, f)."""
        return _inverse(self.posterior_precision)

    @cached_property
    def mean(self) -> Array:
        """Posterior mean of f, shape (t, f)."""
        return np.asarray(np.einsum("tfg,tg->tf", self.inverse, self.target))

    @cached_property
    def energy(self) -> Array:
        """Squared residual that is left, plus the priors of f, shape (t,)."""
        return np.asarray(self.unfitted - np.einsum("tf,tf->t", self.target, self.mean))

    def with_precision(self, precision: Array) -> LinearModel:
        """Return the model with another prior precision of f; products are kept."""
        found = LinearModel(self.blocks, self.basis, precision)
        found._trials, found.parts, found._whole, found.logs = self._trials, self.parts, self._whole, self.logs
        found.posterior_precision = self.posterior_precision + np.diag(precision - self.precision)
        return found

    def evidence_with(self, precision: Array, h: int, noise: NoiseScale) -> float:
        """Return the log evidence at a heterogeneity index if f had another prior precision."""
        matrix = self.posterior_precision[h] + np.diag(precision - self.precision)
        scale = 1 / np.sqrt(np.diag(matrix))
        root = np.linalg.cholesky(scale[:, None] * matrix * scale + _RIDGE * np.eye(len(scale)))
        half = solve_triangular(root, scale * self.target[h], lower=True, check_finite=False)
        spread = 2 * float(np.log(np.diag(root) / scale).sum()) - float(np.log(np.maximum(precision, 1e-300)).sum())
        energy = self.unfitted[h] - float(half @ half)
        return float(noise.log_likelihood(energy)) + float(self.logs[h]) - spread / 2

    def at_zero(self, count: int) -> tuple[Array, Array]:
        """Return least energy and log volume at each heterogeneity if the first `count` coefficients of F are zero.

        The energy is the squared residual plus the priors of the coefficients. Both have the shape (t,).
        """
        inner, target, prior = (
            self.posterior_precision[:, count:, count:],
            self.target[:, count:],
            self.precision[count:],
        )
        if not len(prior):
            return self.unfitted, self.logs
        mean = np.linalg.solve(inner, target[:, :, None])[:, :, 0]
        spread = np.linalg.slogdet(inner)[1] - np.log(np.maximum(prior, 1e-300)).sum()
        return self.unfitted - np.einsum("tf,tf->t", target, mean), self.logs - 0.5 * spread

    def at_point(self, fixed: Indices, values: Array) -> tuple[Array, Array]:
        """Return energy and log volume at each heterogeneity if d is zero and some coefficients of F are fixed.

        The other coefficients of F have their best values.
        """
        whole = np.sum([each.plain for each in self._trials], axis=0)
        free = np.setdiff1d(np.arange(len(self.precision)), fixed)
        matrix = whole[:, free][:, :, free] + np.diag(self.precision[free] + 1e-12)
        target = whole[:, free, -1] - whole[:, free][:, :, fixed] @ values
        energy = whole[:, -1, -1] - 2 * whole[:, fixed, -1] @ values + values @ whole[:, fixed][:, :, fixed] @ values
        energy = energy - np.einsum("tf,tf->t", target, np.linalg.solve(matrix, target[:, :, None])[:, :, 0])
        spread = np.sum([each.spread for each in self._trials], axis=0)
        return energy + float(self.precision[fixed] @ values**2), -0.5 * spread

    def base_steps(self, h: int, f: Array) -> list[Array]:
        """Return the best coefficients d of each trial at a heterogeneity index, given f, in the units of `base`."""
        return [each.solved[h, :, -1] - each.solved[h, :, :-1] @ f for each in self._trials]

    def project(self, columns: Columns, levels: Indices) -> Projected:
        """Return columns with J and F projected out, at the heterogeneities with the indices `levels`."""
        t, f, m = len(levels), len(self.precision), columns.count
        cross, slope, curvature, energy = np.zeros((t, f, m)), np.zeros((t, m)), np.zeros((t, m)), np.zeros(m)
        halves = []
        for trial, values, moved, squares, curved in zip(
            self._trials, columns.values, columns.moved, columns.squares, columns.curved, strict=True
        ):
            half, rest = trial.against(values, moved, levels)
            halves.append(half)
            cross += rest[:, :f]
            slope += rest[:, f]
            curvature += squares - curved[levels] - np.einsum("tqm,tqm->tm", half, half)
            energy += squares
        if f:
            solved = self.inverse[levels] @ cross
            slope -= np.einsum("tfm,tf->tm", solved, self.target[levels])
            curvature -= np.einsum("tfm,tfm->tm", cross, solved)
        kept = np.where(curvature > _ROUNDING * energy, curvature, 0.0)
        return Projected(levels, slope, kept, cross, tuple(halves))

    def by_trial(self, columns: Columns, part: slice, h: int) -> tuple[Array, Array]:
        """Return slope and curvature of some columns in each trial at a heterogeneity index, shape (trials, m) each.

        J is projected out; the coefficients f have their posterior means, and do not give way to the columns.
        """
        fitted, levels, slopes, curvatures = self.mean[h], np.array([h]), [], []
        for trial, values, moved, squares, curved in zip(
            self._trials, columns.values, columns.moved, columns.squares, columns.curved, strict=True
        ):
            half, rest = trial.against(values[:, part], moved[:, part], levels)
            slopes.append(rest[0, -1] - fitted @ rest[0, :-1])
            curvatures.append(squares[part] - curved[h, part] - (half[0] ** 2).sum(axis=0))
        return np.array(slopes), np.array(curvatures)

    def normals(self, columns: Columns, projected: Projected, groups: Indices) -> Array:
        """Return the normal matrices of groups of columns with J and F projected out, shape (t, groups, p, p)."""
        found: Array = np.zeros((len(projected.levels), *groups.shape, groups.shape[1]))
        for block, values, moved, half in zip(
            self.blocks, columns.values, columns.moved, projected.halves, strict=True
        ):
            own, ours, its = values[:, groups], moved[:, groups], half[:, :, groups]
            found += np.einsum("ngp,ngq->gpq", own, own, optimize=True)
            found -= np.einsum("tk,kgp,kgq->tgpq", block.weights[projected.levels], ours, ours, optimize=True)
            found -= np.einsum("tqgp,tqgr->tgpr", its, its, optimize=True)
        if not len(self.precision):
            return found
        cross = projected.cross[:, :, groups]
        solved = (self.inverse[projected.levels] @ projected.cross)[:, :, groups]
        return np.asarray(found - np.einsum("tfgp,tfgq->tgpq", cross, solved, optimize=True))


@dataclass(frozen=True)
class _TrialProducts:
    """Products of one trial: `known` is J, F and r side by side; `rest` has J projected out."""

    block: Block
    known: Array
    weighed: Array
    root: Array
    solved: Array
    rest: Array
    logs: Array
    plain: Array
    """Normal matrices of [F r], shape (t, f + 1, f + 1)."""

    spread: Array
    """Log determinants of the covariance of the tissue, shape (t,)."""

    @classmethod
    def of(cls, block: Block, basis: Array) -> _TrialProducts:
        q = block.base.shape[1]
        known = np.column_stack([block.base, basis, block.residual])
        moved = block.modes.T @ known
        weighed = moved.T * block.weights[:, None, :]
        whole = known.T @ known - weighed @ moved
        own, cross = whole[:, :q, :q], whole[:, :q, q:]
        diagonal = np.einsum("tqq->tq", own)
        factor = np.linalg.cholesky(own + (_RIDGE * diagonal + 1e-12)[:, :, None] * np.eye(q))
        root = np.linalg.inv(factor)
        half = root @ cross
        varied = HETEROGENEITY_SDS[:, None] ** 2 * block.variances
        spread = np.log1p(varied).sum(axis=1) - 2 * block.log_volume
        logs = 2 * np.log(np.einsum("tqq->tq", factor)).sum(axis=1) + spread + 2 * block.log_scale
        rest = whole[:, q:, q:] - half.swapaxes(1, 2) @ half
        return cls(block, known, weighed, root, root.swapaxes(1, 2) @ half, rest, logs, whole[:, q:, q:], spread)

    def against(self, values: Array, moved: Array, levels: Indices) -> tuple[Array, Array]:
        """Return root J'W X, shape (t, q, m), and [F r]'W X with J projected out, (t, f + 1, m), at some levels."""
        q = self.root.shape[1]
        weighed = self.weighed[levels]
        t, p, k = weighed.shape
        products = self.known.T @ values - (weighed.reshape(-1, k) @ moved).reshape(t, p, -1)
        half = self.root[levels] @ products[:, :q]
        return half, products[:, q:] - self.solved[levels].swapaxes(1, 2) @ products[:, :q]


def _inverse(matrix: Array) -> Array:
    """Return the inverse of positive definite matrices (t, f, f), scaled to unit diagonals first."""
    if not matrix.shape[1]:
        return matrix
    scale = 1 / np.sqrt(np.einsum("tff->tf", matrix))
    whole = scale[:, :, None] * scale[:, None] * matrix + _RIDGE * np.eye(matrix.shape[1])
    return np.asarray(scale[:, :, None] * scale[:, None] * np.linalg.inv(whole))
