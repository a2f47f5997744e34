"""Evidence of a linear Gaussian model: residual = J d + F f + E w + h U S z + e, with priors on all coefficients.

W is the inverse covariance of the white noise e and the heterogeneity h U S z. d and w are projected out per trial, f
is shared by all trials and integrated out with its prior precision. All products exist for t heterogeneities h at once.
Notation: docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from needleplan.diagnosis._factors import RIDGE, eliminated, inverse_of, inverse_root, root_of
from needleplan.signals import Array

__all__ = [
    "HETEROGENEITY_SDS", "TISSUE_KINDS", "Block", "Columns", "Indices", "LinearModel", "NoiseScale", "Projected",
    "squared_residuals",
]  # fmt: skip

Indices = NDArray[np.intp]

_SDS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
HETEROGENEITY_SDS = np.concatenate([_SDS, _SDS[1:]])
"""Standard deviations of the tissue's heterogeneity that are summed over, relative to the mean of its property."""
TISSUE_KINDS = np.concatenate([np.zeros(len(_SDS), np.intp), np.ones(len(_SDS) - 1, np.intp)])
"""Kind of tissue of each of these: 0 is rough, 1 is smooth. Homogeneous tissue, the first one, has no kind."""

# Share of a column's energy that other columns leave, below which the rest is rounding error.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class NoiseScale:
    """Noise variance that is known only as well as `freedom` samples of noise determine it, integrated out.

    The variance of the noise, in units of its estimate, has a scaled inverse chi-squared prior. All other variances are
    taken in units of it, so that the marginal likelihood of the readings is Student's.
    """

    freedom: float
    """Degrees of freedom of the estimate of the noise variance."""

    count: int
    """Number of readings."""

    def log_likelihood(self, energy: Array) -> Array:
        """Return the log-likelihood for a squared residual that has been minimised and whitened; 0 for none."""
        return np.asarray(-0.5 * (self.freedom + self.count) * np.log1p(energy / self.freedom))

    def variance(self, energy: Array) -> Array:
        """Return the most probable variance of the noise, in units of its estimate."""
        return np.asarray((self.freedom + energy) / (self.freedom + self.count))


@dataclass(frozen=True)
class Block:
    """One whitened trial: residual (n,), base sensitivities (n, q) of norm 1, and tissue modes (n, k).

    `variances` (kinds, k) are those of each mode in each kind of tissue; the modes with a variance in one kind are
    orthonormal. The rows of `base` end with the priors of its q coefficients, a diagonal block.
    """

    residual: Array
    base: Array
    modes: Array
    variances: Array
    errors: Array | None = None
    """Output changes E by further errors of this trial alone, all of the same variance, shape (n, e)."""

    levels: Indices = field(default_factory=lambda: np.arange(len(HETEROGENEITY_SDS)))
    """Indices of the t heterogeneities that are summed over, in ascending order."""

    @cached_property
    def weights(self) -> Array:
        """Share of each mode's energy that W removes, shape (t, k)."""
        return np.asarray(self.varied / (1 + self.varied))

    @cached_property
    def varied(self) -> Array:
        """Variance of each mode at each heterogeneity, shape (t, k)."""
        return np.asarray(HETEROGENEITY_SDS[self.levels, None] ** 2 * self.variances[TISSUE_KINDS[self.levels]])

    def tissue(self, kind: int) -> Array:
        """Return the modes of one kind of tissue times their standard deviations, shape (n, modes)."""
        own = self.variances[kind] > 0
        return np.asarray(self.modes[:, own] * np.sqrt(self.variances[kind, own]))

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

    `share` is the standard deviation of the coefficients of the blocks' errors E. Products are computed when they are
    asked for first.
    """

    def __init__(self, blocks: Sequence[Block], basis: Sequence[Array], precision: Array, share: float = 1.0) -> None:
        self.blocks, self.basis, self.precision = tuple(blocks), tuple(basis), np.asarray(precision, float)
        self.share = share

    @cached_property
    def _trials(self) -> list[_TrialProducts]:
        return [_TrialProducts.of(block, each, self.share) for block, each in zip(self.blocks, self.basis, strict=True)]

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
        return inverse_of(self.posterior_precision)

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
        found = LinearModel(self.blocks, self.basis, precision, self.share)
        found._trials, found.parts, found._whole, found.logs = self._trials, self.parts, self._whole, self.logs
        found.posterior_precision = self.posterior_precision + np.diag(precision - self.precision)
        return found

    def with_share(self, share: float) -> LinearModel:
        """Return the model with another standard deviation of the errors E; products are kept."""
        found = LinearModel(self.blocks, self.basis, self.precision, share)
        found._trials = [each.with_share(share) for each in self._trials]
        return found

    def evidence_with(self, precision: Array, h: int, noise: NoiseScale) -> float:
        """Return the log evidence at a heterogeneity index if f had another prior precision."""
        matrix = self.posterior_precision[h] + np.diag(precision - self.precision)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), precision))  # rounding may take more than the products add
        root = root_of(scale[:, None] * matrix * scale + RIDGE * np.eye(len(scale)))
        half = solve_triangular(root, scale * self.target[h], lower=True, check_finite=False)
        spread = 2 * float(np.log(np.diag(root) / scale).sum()) - float(np.log(np.maximum(precision, 1e-300)).sum())
        energy = self.unfitted[h] - float(half @ half)
        return float(noise.log_likelihood(energy)) + float(self.logs[h]) - spread / 2

    def at_zero(self, count: int) -> tuple[Array, Array]:
        """Return least energy and log volume at each heterogeneity if the first `count` coefficients of F are zero.

        The energy is the squared residual plus the priors of the coefficients. Both have the shape (t,).
        """
        rest, spread = self.marginal(count)
        return rest[:, -1, -1], self.logs - 0.5 * spread

    def marginal(self, count: int) -> tuple[Array, Array]:
        """Return normal matrices of the first `count` columns of F, and r, the others integrated out, and spread.

        The matrices contain the priors. The spread is the log determinant of the posterior precision of the others, in
        units of their priors. The shapes are (t, count + 1, count + 1) and (t,).
        """
        f = len(self.precision)
        order = np.array([*range(count, f), *range(count), f])
        whole = self._whole[:, order[:, None], order] + np.diag(np.append(self.precision + 1e-12, 0.0)[order])
        rest, spread = eliminated(whole, f - count)
        return rest, spread - np.log(np.maximum(self.precision[count:], 1e-300)).sum()

    def at_point(self, fixed: Indices, values: Array, levels: Indices) -> tuple[Array, Array]:
        """Return energy and log volume at some heterogeneities if d is zero and some coefficients of F are fixed.

        The other coefficients of F have their best values.
        """
        free = np.setdiff1d(np.arange(len(self.precision)), fixed)
        # from [F r]: the free columns, and what the fixed ones leave of r
        columns: Array = np.eye(len(self.precision) + 1)[:, [*free, -1]]
        columns[fixed, -1] = -values
        whole = columns.T @ np.sum([each.plain[levels] for each in self._trials], axis=0) @ columns
        whole += np.diag(np.append(self.precision[free] + 1e-12, 0.0))
        energy = eliminated(whole, len(free))[0][:, 0, 0]
        spread = np.sum([each.spread[levels] for each in self._trials], axis=0)
        return energy + float(self.precision[fixed] @ values**2), -0.5 * spread

    def base_steps(self, h: int, f: Array) -> list[Array]:
        """Return the best coefficients d of each trial at a heterogeneity index, given f, in the units of `base`."""
        return [
            each.coefficients(h, f)[-block.base.shape[1] :]
            for each, block in zip(self._trials, self.blocks, strict=True)
        ]

    def residuals(self, h: int, f: Array) -> list[Array]:
        """Return what all columns and the tissue leave of each trial at a heterogeneity index, given f, shape (n,)."""
        found = []
        for each, block, basis in zip(self._trials, self.blocks, self.basis, strict=True):
            own = each.coefficients(h, f)
            left = block.residual - each.known[:, : len(own)] @ own - basis @ f
            found.append(left - block.modes @ (block.weights[h] * (block.modes.T @ left)))
        return found

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


def squared_residuals(parts: Array, f: Array) -> Array:
    """Return the squared residual, given the coefficients f, from normal matrices of [F r] (..., f + 1, f + 1)."""
    both = np.append(-f, 1.0)
    return np.asarray(both @ parts @ both)


@dataclass(frozen=True)
class _TrialProducts:
    """Products of one trial: `known` is E, J, F and r side by side; `rest` has E and J projected out."""

    block: Block
    known: Array
    moved: Array
    """Products of the tissue modes and `known`, shape (k, e + q + f + 1)."""

    whole: Array
    """Normal matrices of `known`, shape (t, e + q + f + 1, e + q + f + 1)."""

    root: Array
    solved: Array
    """Best coefficients of E and J for each of F and r, shape (t, e + q, f + 1)."""

    rest: Array
    logs: Array
    plain: Array
    """Normal matrices of [F r] with E projected out, shape (t, f + 1, f + 1)."""

    spread: Array
    """Log determinants of the covariance of tissue and errors, shape (t,)."""

    @classmethod
    def of(cls, block: Block, basis: Array, share: float) -> _TrialProducts:
        errors = [] if block.errors is None else [block.errors]
        known = np.column_stack([*errors, block.base, basis, block.residual])
        moved, square, parts = block.modes.T @ known, known.T @ known, []
        for kind, variances in enumerate(block.variances):
            levels, own = kind == TISSUE_KINDS[block.levels], variances > 0
            its = moved[own]
            parts.append(square - (its.T * block.weights[levels][:, None, own]) @ its)
        return cls._projected(block, known, moved, np.concatenate(parts), share)

    def with_share(self, share: float) -> _TrialProducts:
        """Return the products with another standard deviation of the errors."""
        return self._projected(self.block, self.known, self.moved, self.whole, share)

    @classmethod
    def _projected(cls, block: Block, known: Array, moved: Array, whole: Array, share: float) -> _TrialProducts:
        q = block.base.shape[1]
        e = 0 if block.errors is None else block.errors.shape[1]
        c = e + q
        own, cross = whole[:, :c, :c], whole[:, :c, c:]
        ridge = RIDGE * np.einsum("tcc->tc", own) + np.concatenate([np.full(e, share**-2), np.full(q, 1e-12)])
        factor = root_of(own + ridge[:, :, None] * np.eye(c))
        root = inverse_root(factor)
        half = root @ cross
        logs = 2 * np.log(np.einsum("tcc->tc", factor))
        spread = np.log1p(block.varied).sum(axis=1) + logs[:, :e].sum(axis=1) + 2 * e * math.log(share)
        plain = whole[:, c:, c:] - half[:, :e].swapaxes(1, 2) @ half[:, :e]
        rest = plain - half[:, e:].swapaxes(1, 2) @ half[:, e:]
        solved = root.swapaxes(1, 2) @ half
        logs = logs[:, e:].sum(axis=1) + spread + 2 * block.log_scale
        return cls(block, known, moved, whole, root, solved, rest, logs, plain, spread)

    def coefficients(self, h: int, f: Array) -> Array:
        """Return the best coefficients of E and J at a heterogeneity index, given f."""
        return np.asarray(self.solved[h, :, -1] - self.solved[h, :, :-1] @ f)

    def against(self, values: Array, moved: Array, levels: Indices) -> tuple[Array, Array]:
        """Return root [E J]'W X and [F r]'W X without E and J, (t, e + q, m) and (t, f + 1, m), at some levels."""
        c = self.root.shape[1]
        weighed = self.moved.T * self.block.weights[levels][:, None, :]
        t, p, k = weighed.shape
        products = self.known.T @ values - (weighed.reshape(t * p, k) @ moved).reshape(t, p, moved.shape[1])
        half = self.root[levels] @ products[:, :c]
        return half, products[:, c:] - self.solved[levels].swapaxes(1, 2) @ products[:, :c]
