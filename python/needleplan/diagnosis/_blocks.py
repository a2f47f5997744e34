"""One trial as a block of the linear model, and its products with errors, tissue and base eliminated.

Equation (1) of docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
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
    errors: Array | None = None
    """Output changes E by further errors of this trial alone, all of the same variance, shape (n, e)."""

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
    """Products of one trial, with errors E, tissue modes U and base J eliminated one after the other.

    Only the tissue depends on the heterogeneity. If there are more errors than modes, E is eliminated first, and once
    for all; or else U is, whose normal matrix is diagonal before, and E goes with J. Each elimination is L^-1 A, with a
    Cholesky factor L of the normal matrix of its columns, and with products A of these columns and all later ones.
    """

    block: Block
    known: Array
    """E, J, F and r side by side, shape (n, e + q + f + 1)."""

    moved: Array
    """Products of the tissue modes and `known`, shape (k, e + q + f + 1)."""

    square: Array
    """Normal matrix of `known`."""

    first: tuple[Array, Array]
    """Elimination of the first s columns of E, all or none: L^-1, (s, s), and L^-1 A, (s, k + e - s + q + f + 1)."""

    tissue: tuple[Array, Array]
    """The same of U: L^-1 times the modes' standard deviations, (t, u, u), or (t, u) if it is diagonal; and L^-1 A."""

    base: tuple[Array, Array]
    """The same of the rest of E, and J: (t, c, c) and (t, c, f + 1) with c = e - s + q."""

    rest: Array
    """Normal matrices of [F r] that are left, shape (t, f + 1, f + 1)."""

    logs: Array
    plain: Array
    """Normal matrices of [F r] with E and U eliminated, but not J, shape (t, f + 1, f + 1)."""

    spread: Array
    """Log determinants of the covariance of tissue and errors, shape (t,)."""

    @classmethod
    def of(cls, block: Block, basis: Array, share: float) -> TrialProducts:
        errors = [] if block.errors is None else [block.errors]
        known = np.column_stack([*errors, block.base, basis, block.residual])
        return cls._eliminated(block, known, block.modes.T @ known, known.T @ known, share)

    def with_share(self, share: float) -> TrialProducts:
        """Return the products with another standard deviation of the errors."""
        return self._eliminated(self.block, self.known, self.moved, self.square, share)

    def with_block(self, block: Block, share: float) -> TrialProducts:
        """Return the products of the same columns with the heterogeneities of a block."""
        return self._eliminated(block, self.known, self.moved, self.square, share)

    @classmethod
    def _eliminated(cls, block: Block, known: Array, moved: Array, square: Array, share: float) -> TrialProducts:
        k, q, sds = len(moved), block.base.shape[1], block.sds
        e = 0 if block.errors is None else block.errors.shape[1]
        prior = RIDGE * np.diag(square)[: e + q] + np.repeat([share**-2, 1e-12], [e, q])
        s = e if e > sds.shape[1] else 0
        factor = root_of((square[:s, :s] + np.diag(prior[:s]))[None])
        first = inverse_root(factor)[0]
        early = first @ np.hstack([moved[:, :s].T, square[:s, s:]])
        modes, later = early[:, :k], early[:, k:]
        spread = _log_squares(factor) + 2 * e * math.log(share)
        if s:  # among the modes of one kind of tissue, which are orthonormal
            normal = (np.eye(k) - modes.T @ modes)[block.present[:, :, None], block.present[:, None]]
            factor = root_of(sds[:, :, None] * sds[:, None] * normal + np.eye(sds.shape[1]))
            tissue, spread = inverse_root(factor) * sds[:, None], spread + _log_squares(factor)
        else:
            tissue, spread = sds / np.sqrt(1 + sds**2), spread + np.log1p(sds**2).sum(axis=1)
        half = _times(tissue, (moved[:, s:] - modes.T @ later)[block.present])
        left = square[s:, s:] - later.T @ later - half.swapaxes(1, 2) @ half
        c, r = e - s + q, e - s
        factor = root_of(left[:, :c, :c] + np.diag(prior[s:]))
        base = inverse_root(factor)
        across = base @ left[:, :c, c:]
        spread = spread + _log_squares(factor[:, :r, :r])
        logs = spread + _log_squares(factor[:, r:, r:]) + 2 * block.log_scale
        plain = left[:, c:, c:] - across[:, :r].swapaxes(1, 2) @ across[:, :r]
        rest = plain - across[:, r:].swapaxes(1, 2) @ across[:, r:]
        return cls(
            block, known, moved, square, (first, early), (tissue, half), (base, across), rest, logs, plain, spread
        )

    def _last(self, h: int, f: Array) -> Array:
        """Return the best coefficients of the rest of E, and of J, at a heterogeneity index, given f."""
        base, across = self.base
        return np.asarray(base[h].T @ (across[h] @ np.append(-f, 1.0)))

    def base_step(self, h: int, f: Array) -> Array:
        """Return the best coefficients of J at a heterogeneity index, given f."""
        return self._last(h, f)[-self.block.base.shape[1] :]

    def residual(self, h: int, f: Array) -> Array:
        """Return the residual of r if all columns have their best coefficients, given f, shape (n,)."""
        later = np.concatenate([-self._last(h, f), -f, [1.0]])
        (tissue, half), (first, early) = self.tissue, self.first
        across, own = half[h] @ later, tissue[h]
        modes = np.zeros(len(self.moved))
        np.add.at(modes, self.block.present[h], -(own * across if own.ndim == 1 else own.T @ across))
        errors = -first.T @ (early @ np.concatenate([modes, later]))
        return np.asarray(self.known @ np.concatenate([errors, later]) + self.block.modes @ modes)

    def against(self, values: Array, moved: Array, levels: Indices, found: Array) -> tuple[Array, Array, Array]:
        """Eliminate all others from columns X at some levels. What U and the last group explain goes to `found`.

        `found`, shape (t, u + c, m), is L^-1 A. The results are the same of E's first columns, shape (s, m); the
        products of X with [F r] beside these, shape (f + 1, m); and factors (t, u + c, f + 1), whose products with
        `found` are to be subtracted from these.
        """
        (first, early), (tissue, half), (base, across) = self.first, self.tissue, self.base
        s, k, u, c = len(first), len(self.moved), half.shape[1], base.shape[1]
        products = self.known.T @ values
        errors = first @ products[:s]
        modes = moved - early[:, :k].T @ errors
        left, half = products[s:] - early[:, k:].T @ errors, half[levels]
        varied = found[:, :u] = _times(tissue[levels], modes[self.block.present[levels]])
        found[:, u:] = base[levels] @ (left[:c] - half[:, :, :c].swapaxes(1, 2) @ varied)
        return errors, left[c:], np.concatenate([half[:, :, c:], across[levels]], axis=1)

    @property
    def width(self) -> int:
        """Number of columns of U at one heterogeneity and of the last group, u + c."""
        return int(self.tissue[1].shape[1] + self.base[0].shape[1])


def _times(factors: Array, rows: Array) -> Array:
    """Return the product of matrices (t, u, u), or of diagonals (t, u), with rows (t, u, m)."""
    return np.asarray(factors[:, :, None] * rows if factors.ndim == 2 else factors @ rows)


def _log_squares(roots: Array) -> Array:
    """Return the log determinants of positive definite matrices from their Cholesky factors (t, n, n)."""
    return np.asarray(2 * np.log(np.einsum("tcc->tc", roots)).sum(axis=1))
