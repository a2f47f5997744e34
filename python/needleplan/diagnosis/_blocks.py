"""One trial as a block of the linear model, and its products with tissue and base eliminated.

Equation (1) of docs/explanation/posterior.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from needleplan.diagnosis._constants import HETEROGENEITIES
from needleplan.diagnosis._factors import RIDGE, inverse_root, root_of
from needleplan.signals import Array

__all__ = ["HETEROGENEITY_SDS", "TISSUE_KINDS", "Block", "Indices", "TrialProducts"]

Indices = NDArray[np.intp]

_SDS = np.array(HETEROGENEITIES)
HETEROGENEITY_SDS = np.concatenate([_SDS, _SDS[1:]])
"""Standard deviations of the tissue's heterogeneity that are summed over, relative to the mean of its property."""
TISSUE_KINDS = np.concatenate([np.zeros(len(_SDS), np.intp), np.ones(len(_SDS) - 1, np.intp)])
"""Kind of tissue of each of these: 0 is rough, 1 is smooth. Homogeneous tissue, the first one, has no kind."""


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
    levels: Indices = field(default_factory=lambda: np.arange(len(HETEROGENEITY_SDS)))
    """Indices of the t heterogeneities that are summed over, in ascending order."""

    @cached_property
    def present(self) -> Indices:
        """Modes that vary at each heterogeneity, and others to fill the rows, shape (t, most modes of a kind)."""
        most = int((self.varied > 0).sum(axis=1).max())
        return np.argsort(self.varied == 0, axis=1, kind="stable")[:, :most]

    @cached_property
    def sds(self) -> Array:
        """Standard deviations of these modes, 0 for those that fill the rows."""
        return np.sqrt(np.take_along_axis(self.varied, self.present, axis=1))

    @cached_property
    def varied(self) -> Array:
        """Variance of each mode at each heterogeneity, shape (t, k)."""
        return np.asarray(HETEROGENEITY_SDS[self.levels, None] ** 2 * self.variances[TISSUE_KINDS[self.levels]])

    @cached_property
    def log_scale(self) -> float:
        """Logarithm of the norms by which the columns of `base` were divided, summed."""
        q = self.base.shape[1]
        return -float(np.log(np.maximum(np.diag(self.base[len(self.base) - q :]), 1e-300)).sum())


@dataclass(frozen=True)
class TrialProducts:
    """Products of one trial, with tissue modes U and base J eliminated one after the other.

    Each elimination is L^-1 A, with a Cholesky factor L of the normal matrix of its columns, and with products A of
    these columns and all later ones. Only the tissue depends on the heterogeneity.
    """

    block: Block
    known: Array
    """J, F and r side by side, shape (n, q + f + 1)."""

    moved: Array
    """Products of the tissue modes and `known`, shape (k, q + f + 1)."""

    square: Array
    """Normal matrix of `known`."""

    tissue: tuple[Array, Array]
    """Elimination of U: L^-1 times the modes' standard deviations, (t, u), and L^-1 A, (t, u, q + f + 1)."""

    base: tuple[Array, Array]
    """Elimination of J: L^-1, (t, q, q), and L^-1 A, (t, q, f + 1)."""

    rest: Array
    """Normal matrices of [F r] that are left, shape (t, f + 1, f + 1)."""

    logs: Array
    plain: Array
    """Normal matrices of [F r] with U eliminated, but not J, shape (t, f + 1, f + 1)."""

    spread: Array
    """Log determinants of the covariance of the tissue, shape (t,)."""

    @classmethod
    def of(cls, block: Block, basis: Array) -> TrialProducts:
        known = np.column_stack([block.base, basis, block.residual])
        return cls._eliminated(block, known, block.modes.T @ known, known.T @ known)

    def with_block(self, block: Block) -> TrialProducts:
        """Return the products of the same columns with the heterogeneities of a block."""
        return self._eliminated(block, self.known, self.moved, self.square)

    @classmethod
    def _eliminated(cls, block: Block, known: Array, moved: Array, square: Array) -> TrialProducts:
        q, sds = block.base.shape[1], block.sds
        tissue, spread = sds / np.sqrt(1 + sds**2), np.log1p(sds**2).sum(axis=1)
        half = tissue[:, :, None] * moved[block.present]
        left = square - half.swapaxes(1, 2) @ half
        factor = root_of(left[:, :q, :q] + np.diag(RIDGE * np.diag(square)[:q] + 1e-12))
        base, plain = inverse_root(factor), left[:, q:, q:]
        across = base @ left[:, :q, q:]
        rest = plain - across.swapaxes(1, 2) @ across
        logs = spread + 2 * np.log(np.einsum("tcc->tc", factor)).sum(axis=1) + 2 * block.log_scale
        return cls(block, known, moved, square, (tissue, half), (base, across), rest, logs, plain, spread)

    def base_step(self, h: int, f: Array) -> Array:
        """Return the best coefficients of J at a heterogeneity index, given f."""
        base, across = self.base
        return np.asarray(base[h].T @ (across[h] @ np.append(-f, 1.0)))

    def residual(self, h: int, f: Array) -> Array:
        """Return the residual of r if all columns have their best coefficients, given f, shape (n,)."""
        later = np.concatenate([-self.base_step(h, f), -f, [1.0]])
        tissue, half = self.tissue
        modes = np.zeros(len(self.moved))
        np.add.at(modes, self.block.present[h], -tissue[h] * (half[h] @ later))
        return np.asarray(self.known @ later + self.block.modes @ modes)

    def against(self, values: Array, moved: Array, levels: Indices, found: Array) -> tuple[Array, Array]:
        """Eliminate U and J from columns X at some levels. What they explain, L^-1 A, goes to `found`, (t, u + q, m).

        The results are the products of X with [F r], shape (f + 1, m), and factors (t, u + q, f + 1), whose products
        with `found` are to be subtracted from these.
        """
        (tissue, half), (base, across) = self.tissue, self.base
        u, q = half.shape[1], base.shape[1]
        products, half = self.known.T @ values, half[levels]
        varied = found[:, :u] = tissue[levels][:, :, None] * moved[self.block.present[levels]]
        found[:, u:] = base[levels] @ (products[:q] - half[:, :, :q].swapaxes(1, 2) @ varied)
        return products[q:], np.concatenate([half[:, :, q:], across[levels]], axis=1)

    @property
    def width(self) -> int:
        """Number of columns of U at one heterogeneity and of J, u + q."""
        return int(self.tissue[1].shape[1] + self.base[0].shape[1])
