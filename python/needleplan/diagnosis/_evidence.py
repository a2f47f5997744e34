"""Evidence of a linear Gaussian model: residual = J d + F f + E w + h U S z + e, with priors on all coefficients.

W is the inverse covariance of the white noise e and the heterogeneity h U S z. d and w are projected out per trial, f
is shared by all trials and integrated out with its prior precision. All products exist for t heterogeneities h at once.
Equations (6) and (7) of docs/explanation/posterior.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from needleplan.diagnosis._blocks import Block, Indices, TrialProducts
from needleplan.diagnosis._factors import RIDGE, eliminated, inverse_of, root_of
from needleplan.signals import Array

__all__ = ["Columns", "LinearModel", "NoiseScale", "Projected", "squared_residuals"]

# Share of a column's energy that other columns leave, below which the rest is rounding error.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class NoiseScale:
    """Noise variance that `freedom` samples of noise determine, integrated out: equation (7).

    The variance of the noise, in units of its estimate, has a scaled inverse chi-squared prior. All other variances are
    taken in units of it, so that the marginal likelihood of the readings is Student's.
    """

    freedom: float
    """Degrees of freedom of the estimate of the noise variance."""

    count: int
    """Number of readings."""

    def log_likelihood(self, energy: Array) -> Array:
        """Return the log-likelihood for a squared residual that has been minimised and whitened; 0 for none.

        A residual below 0 is a rounding error, as it occurs in readings without noise, and counts as 0.
        """
        return np.asarray(-0.5 * (self.freedom + self.count) * np.log1p(np.maximum(energy, 0.0) / self.freedom))

    def variance(self, energy: Array) -> Array:
        """Return the most probable variance of the noise, in units of its estimate."""
        return np.asarray((self.freedom + np.maximum(energy, 0.0)) / (self.freedom + self.count))


class Columns:
    """Fixed columns of all trials, one array (n, m) per trial, with their products with the tissue modes."""

    def __init__(self, blocks: Sequence[Block], values: Sequence[Array]) -> None:
        self.values: tuple[Array, ...] = tuple(values)
        self.moved: tuple[Array, ...] = tuple(block.modes.T @ each for block, each in zip(blocks, values, strict=True))
        self.squares: tuple[Array, ...] = tuple(np.einsum("nm,nm->m", value, value) for value in values)

    @property
    def count(self) -> int:
        """Number of columns m."""
        return int(self.values[0].shape[1])


@dataclass(frozen=True)
class Projected:
    """Log-likelihood as a function of the coefficient of each of m columns, with J and F projected out."""

    levels: Indices
    """Indices of the t heterogeneities at which the arrays are computed."""

    slope: Array
    """First derivative of the log-likelihood at a coefficient of 0, shape (t, m)."""

    curvature: Array
    """Negative second derivative of the log-likelihood, shape (t, m); 0 for a column that J and F can replace."""

    cross: Array
    """Products of F and the columns with J projected out, shape (t, f, m)."""

    solved: Array
    """Posterior covariance of F times `cross`, shape (t, f, m)."""

    early: Array
    late: Array
    """Parts of the columns that errors, tissue and J explain, over all trials, shapes (s, m) and (t, u + c, m)."""


class LinearModel:
    """A linear Gaussian model of all trials; `basis` holds F by trial (n, f), `precision` its prior (f,).

    `share` is the standard deviation of the coefficients w of the formula errors E. A product is computed at its first
    use.
    """

    def __init__(self, blocks: Sequence[Block], basis: Sequence[Array], precision: Array, share: float = 1.0) -> None:
        self.blocks: tuple[Block, ...] = tuple(blocks)
        self.basis: tuple[Array, ...] = tuple(basis)
        self.precision: Array = np.asarray(precision, float)
        self.share = share

    @cached_property
    def _trials(self) -> list[TrialProducts]:
        return [TrialProducts.of(block, each, self.share) for block, each in zip(self.blocks, self.basis, strict=True)]

    @cached_property
    def parts(self) -> Array:
        """Normal matrices of [F r] with J projected out, shape (trials, t, f + 1, f + 1)."""
        return np.stack([products.rest for products in self._trials])

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
        return np.asarray(-0.5 * np.sum([products.logs for products in self._trials], axis=0))

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
        """Squared residual at the posterior mean of f, plus the prior term of f, shape (t,)."""
        return np.asarray(self.unfitted - np.einsum("tf,tf->t", self.target, self.mean))

    def with_precision(self, precision: Array) -> LinearModel:
        """Return this model with another prior precision of f; the matrix products are not computed again."""
        model = LinearModel(self.blocks, self.basis, precision, self.share)
        model._trials, model.parts, model._whole, model.logs = self._trials, self.parts, self._whole, self.logs
        model.posterior_precision = self.posterior_precision + np.diag(precision - self.precision)
        return model

    def with_share(self, share: float) -> LinearModel:
        """Return this model with another standard deviation of the coefficients w of the formula errors E.

        The matrix products of the trials are not computed again.
        """
        model = LinearModel(self.blocks, self.basis, self.precision, share)
        model._trials = [products.with_share(share) for products in self._trials]
        return model

    def with_levels(self, levels: Indices) -> LinearModel:
        """Return this model at other heterogeneities; the matrix products of the trials are not computed again."""
        blocks = [replace(block, levels=levels) for block in self.blocks]
        model = LinearModel(blocks, self.basis, self.precision, self.share)
        pairs = zip(blocks, self._trials, strict=True)
        model._trials = [products.with_block(block, self.share) for block, products in pairs]
        return model

    def evidence_with(self, precision: Array, h: int, noise: NoiseScale) -> float:
        """Return the log evidence at a heterogeneity index if f had another prior precision."""
        matrix = self.posterior_precision[h] + np.diag(precision - self.precision)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), precision))  # rounding may take more than the products add
        root = root_of(scale[:, None] * matrix * scale + RIDGE * np.eye(len(scale)))
        half = solve_triangular(root, scale * self.target[h], lower=True, check_finite=False)
        spread = 2 * float(np.log(np.diag(root) / scale).sum()) - float(np.log(np.maximum(precision, 1e-300)).sum())
        energy = self.unfitted[h] - float(half @ half)
        return float(noise.log_likelihood(energy)) + float(self.logs[h]) - spread / 2

    def marginal(self, count: int) -> tuple[Array, Array]:
        """Integrate out all columns of F but the first `count`.

        Returns
        -------
        normal : Array, shape (t, count + 1, count + 1)
            Normal matrices of [F r] with the first `count` columns of F, priors included.
        spread : Array, shape (t,)
            Log determinant of the posterior precision of the other coefficients, in units of their prior precision.
        """
        f = len(self.precision)
        order = np.array([*range(count, f), *range(count), f])
        whole = self._whole[:, order[:, None], order] + np.diag(np.append(self.precision + 1e-12, 0.0)[order])
        rest, spread = eliminated(whole, f - count)
        return rest, spread - np.log(np.maximum(self.precision[count:], 1e-300)).sum()

    def at_point(self, fixed: Indices, values: Array, levels: Indices) -> tuple[Array, Array]:
        """Return squared residual and log volume, shape (levels,) each, for d = 0 and fixed coefficients of F.

        `fixed` are the indices of the coefficients with the given `values`; the other coefficients of F have their best
        values. `levels` are the indices of the heterogeneities.
        """
        free = np.setdiff1d(np.arange(len(self.precision)), fixed)
        # from [F r]: the free columns of F, and r minus the fixed columns times their values
        columns: Array = np.eye(len(self.precision) + 1)[:, [*free, -1]]
        columns[fixed, -1] = -values
        whole = columns.T @ np.sum([products.plain[levels] for products in self._trials], axis=0) @ columns
        whole += np.diag(np.append(self.precision[free] + 1e-12, 0.0))
        energy = eliminated(whole, len(free))[0][:, 0, 0]
        spread = np.sum([products.spread[levels] for products in self._trials], axis=0)
        return energy + float(self.precision[fixed] @ values**2), -0.5 * spread

    def base_steps(self, h: int, f: Array) -> list[Array]:
        """Return the best coefficients d of each trial at a heterogeneity index, given f, in the units of `base`."""
        return [trial.base_step(h, f) for trial in self._trials]

    def residuals(self, h: int, f: Array) -> list[Array]:
        """Return the residual of each trial, shape (n,), with the best coefficients at heterogeneity `h`, given f."""
        return [trial.residual(h, f) for trial in self._trials]

    def project(self, columns: Columns, levels: Indices) -> Projected:
        """Return columns with J and F projected out, at the heterogeneities with the indices `levels`."""
        ends = np.cumsum([0, *(trial.width for trial in self._trials)])
        late = np.empty((len(levels), ends[-1], columns.count))
        parts = [
            trial.against(values, moved, levels, late[:, slice(*rows)])
            for trial, values, moved, rows in zip(
                self._trials, columns.values, columns.moved, pairwise(ends), strict=True
            )
        ]
        early = np.vstack([each for each, _, _ in parts])
        energy = np.sum(columns.squares, axis=0)
        factors = np.concatenate([each for _, _, each in parts], axis=1)
        cross = np.sum([each for _, each, _ in parts], axis=0) - factors.swapaxes(1, 2) @ late
        cross, slope = cross[:, :-1], cross[:, -1]
        curvature = energy - (early**2).sum(axis=0) - np.einsum("tqm,tqm->tm", late, late)
        solved = self.inverse[levels] @ cross
        if len(self.precision):
            slope = slope - np.einsum("tfm,tf->tm", solved, self.target[levels])
            curvature -= np.einsum("tfm,tfm->tm", cross, solved)
        kept = np.where(curvature > _ROUNDING * energy, curvature, 0.0)
        return Projected(levels, slope, kept, cross, solved, early, late)

    def by_trial(self, columns: Columns, part: slice, h: int) -> tuple[Array, Array]:
        """Return slope and curvature of some columns in each trial at a heterogeneity index, shape (trials, m) each.

        J is projected out; the coefficients f have their posterior means, and do not give way to the columns.
        """
        fitted, levels, slopes, curvatures = self.mean[h], np.array([h]), [], []
        for trial, values, moved, squares in zip(
            self._trials, columns.values, columns.moved, columns.squares, strict=True
        ):
            late = np.empty((1, trial.width, values[:, part].shape[1]))
            early, products, factors = trial.against(values[:, part], moved[:, part], levels, late)
            rest = products - factors[0].T @ late[0]
            slopes.append(rest[-1] - fitted @ rest[:-1])
            curvatures.append(squares[part] - (early**2).sum(axis=0) - (late[0] ** 2).sum(axis=0))
        return np.array(slopes), np.array(curvatures)

    def normals(self, columns: Columns, projected: Projected, groups: Indices) -> Array:
        """Return the normal matrices of groups of columns with J and F projected out, shape (t, groups, p, p).

        The columns of all groups follow one another.
        """
        columns_of = partial(_grouped, groups=groups)
        found: Array = np.zeros((len(projected.levels), *groups.shape, groups.shape[1]))
        for own in map(columns_of, columns.values):
            found += np.einsum("ngp,ngq->gpq", own, own, optimize=True)
        first, late = columns_of(projected.early), columns_of(projected.late)
        found -= np.einsum("egp,egq->gpq", first, first, optimize=True)
        found -= np.einsum("tqgp,tqgr->tgpr", late, late, optimize=True)
        cross, solved = columns_of(projected.cross), columns_of(projected.solved)
        return np.asarray(found - np.einsum("tfgp,tfgq->tgpq", cross, solved, optimize=True))


def _grouped(values: Array, groups: Indices) -> Array:
    """Return the columns (..., m) of groups that follow one another, shape (..., groups, p)."""
    part = slice(int(groups[0, 0]), int(groups[-1, -1]) + 1)
    return values[..., part].reshape(*values.shape[:-1], *groups.shape)


def squared_residuals(parts: Array, f: Array) -> Array:
    """Return the squared residual, given the coefficients f, from normal matrices of [F r] (..., f + 1, f + 1)."""
    both = np.append(-f, 1.0)
    return np.asarray(both @ parts @ both)
