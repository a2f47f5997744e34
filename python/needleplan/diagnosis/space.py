"""The linear algebra of a diagnosis: scores of candidate columns beside everything that a calibration can take up.

For each trial, whitened by the noise of the sensor, with a(p) the column of a candidate:

    r = J d + G b + a(p) size + tau U S g + e,        e, g white;  d free, b free and shared

J holds the sensitivities of the base, own to the trial; G those of effects that were named already, shared by all; U S
is how a tissue that is not the same everywhere shows, tau its level. d and b are projected out, g is integrated out,
and tau is chosen anew for each candidate by its restricted likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from needleplan.signals import Array

__all__ = ["LEVELS", "Block", "Scores", "Space"]

LEVELS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
"""Levels of heterogeneity that are tried: standard deviation of the tissue's properties over their mean."""


@dataclass(frozen=True)
class Block:
    """One trial, whitened: residual (n,), sensitivities (n, q), shared nuisances (n, g), modes (n, k)."""

    residual: Array
    sensitivities: Array
    shared: Array
    modes: Array
    """Orthonormal."""

    variances: Array
    """Of the modes at level 1."""

    usual_level: float = math.inf
    """Standard deviation that heterogeneity is believed to have among tissues."""

    independent: int = 0
    """How many of the samples say something of their own about a smooth function; 0 for all."""

    @property
    def samples(self) -> int:
        """How many."""
        return len(self.residual)


@dataclass(frozen=True)
class Scores:
    """For every level (t) and column (m): slope and curvature of the likelihood in the size, shape (t, m)."""

    slope: Array
    curvature: Array
    evidence: Array
    """Of the base at every level, shape (t,)."""

    def gains(self, allowed: Array | None = None) -> tuple[Array, Array]:
        """Return twice the gain in log likelihood of every column over the base, and the level it takes, (m,) each."""
        with np.errstate(divide="ignore", invalid="ignore"):
            each = np.where(self.curvature > 1e-9, self.slope**2 / self.curvature, 0.0)
        if allowed is not None:
            each = np.where(allowed, each, 0.0)
        total = 2 * self.evidence[:, None] + each
        level = total.argmax(axis=0)
        return total.max(axis=0) - 2 * self.evidence.max(), level

    def sizes(self) -> Array:
        """Return the best size of every column at every level, shape (t, m)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.curvature > 1e-9, self.slope / self.curvature, 0.0)


class Space:
    """Trials that are judged together."""

    def __init__(self, blocks: Sequence[Block], levels: Array = LEVELS) -> None:
        self.blocks, self.levels = tuple(blocks), levels
        self._weights = [
            [level**2 * block.variances / (1 + level**2 * block.variances) for level in levels] for block in blocks
        ]
        self._moved = [block.modes.T @ np.column_stack([block.sensitivities, block.shared, block.residual])
                       for block in blocks]  # fmt: skip
        self._plain = []
        for block in blocks:
            all_ = np.column_stack([block.sensitivities, block.shared, block.residual])
            self._plain.append(all_.T @ all_)
        self._factors = [
            [self._factor(index, level) for level in range(len(levels))] for index in range(len(self.blocks))
        ]
        self._shared = [self._shared_factor(level) for level in range(len(levels))]
        self.evidence = np.array([self._evidence(level) for level in range(len(levels))])

    @property
    def samples(self) -> int:
        """Of all trials."""
        return sum(block.samples for block in self.blocks)

    @property
    def price(self) -> float:
        """What Schwarz' criterion charges for a parameter."""
        return float(np.log(sum(block.independent or block.samples for block in self.blocks)))

    @property
    def best(self) -> int:
        """Index of the level that the base takes."""
        return int(self.evidence.argmax())

    @property
    def level(self) -> float:
        """The heterogeneity that the base takes."""
        return float(self.levels[self.best])

    def energy(self, level: int | None = None) -> float:
        """Return the weighted sum of squares that the base leaves at a level, by default the one it takes."""
        return self._shared[self.best if level is None else level][2]

    def scores(self, columns: Sequence[Array]) -> Scores:
        """Score columns with one size for all trials; one array (n, m) for each trial."""
        slope, curvature, cross = self._local(columns)
        slope, curvature = slope.sum(axis=1), curvature.sum(axis=1)
        for level in range(len(self.levels)):
            matrix, target, _ = self._shared[level]
            if target.size:
                g = cross[level].sum(axis=0)
                solved = np.linalg.solve(matrix, g)
                slope[level] -= solved.T @ target
                curvature[level] -= np.einsum("gm,gm->m", g, solved)
        return Scores(slope, curvature, self.evidence)

    def scores_apart(self, columns: Sequence[Array]) -> tuple[Array, Array]:
        """Return slope and curvature for each trial by itself, shape (levels, trials, m); no shared nuisances."""
        slope, curvature, _ = self._local(columns)
        return slope, curvature

    def basis_gains(self, basis: Sequence[Array], *, ridge: float = 1e-9) -> float:
        """Return twice the gain in log likelihood of a whole basis, shape (n, df) for each trial, sizes shared."""
        best = -np.inf
        products = self._products(basis)
        for level in range(len(self.levels)):
            matrix, target = self.normal(basis, level, products)
            scale = np.sqrt(np.maximum(np.diag(matrix), 1e-12))
            scaled = matrix / np.outer(scale, scale) + ridge * np.eye(len(scale))
            values, vectors = np.linalg.eigh(scaled)
            keep = values > 1e-7
            part = vectors[:, keep].T @ (target / scale)
            best = max(best, 2 * float(self.evidence[level]) + float((part**2 / values[keep]).sum()))
        return float(best - 2 * self.evidence.max())

    def _products(self, basis: Sequence[Array]) -> list[tuple[Array, Array, Array]]:
        found = []
        for block, columns in zip(self.blocks, basis, strict=True):
            known = np.column_stack([block.sensitivities, block.shared, block.residual])
            found.append((known.T @ columns, block.modes.T @ columns, columns.T @ columns))
        return found

    def normal(
        self, basis: Sequence[Array], level: int, products: Sequence[tuple[Array, Array, Array]] | None = None
    ) -> tuple[Array, Array]:
        """Return matrix (df, df) and right side (df,) of the normal equations of a basis at a level."""
        df = basis[0].shape[1]
        matrix, target = np.zeros((df, df)), np.zeros(df)
        cross = np.zeros((self.blocks[0].shared.shape[1], df))
        products = self._products(basis) if products is None else products
        for index, block in enumerate(self.blocks):
            q = block.sensitivities.shape[1]
            weights = self._weights[index][level]
            plain, moved, square = products[index]
            with_known = plain - self._moved[index].T @ (weights[:, None] * moved)
            factor, solved = self._factors[index][level][:2]
            own = square - moved.T @ (weights[:, None] * moved)
            matrix += own - with_known[:q].T @ cho_solve(factor, with_known[:q])
            rest = with_known[q:] - solved.T @ with_known[:q]
            target += rest[-1]
            cross = cross + rest[:-1]
        shared, right, _ = self._shared[level]
        if right.size:
            inner = np.linalg.solve(shared, cross)
            matrix -= cross.T @ inner
            target -= inner.T @ right
        return matrix, target

    def null_maxima(self, columns: Sequence[Array], penalty: Array, signs: Array, runs: int, seed: int) -> Array:
        """Return the greatest penalised gain over all columns in `runs` simulated trials without an effect.

        The level is held at the one that the base takes. `signs` is +1 or -1 where a size has a sign, else 0.
        """
        generator = np.random.default_rng(seed)
        level = self.best
        slope: Array = np.zeros((columns[0].shape[1], runs))
        curvature: Array = np.zeros(columns[0].shape[1])
        for index, (block, each) in enumerate(zip(self.blocks, columns, strict=True)):
            weights = self._weights[index][level]
            factor = self._factors[index][level][0]
            # W^(1/2) of white noise has the same law as W applied to noise with the modes in it.
            noise = generator.standard_normal((block.samples, runs))
            modes = np.sqrt(block.variances) * self.levels[level]
            noise += (block.modes * modes) @ generator.standard_normal((modes.size, runs))
            weighed = noise - block.modes @ (weights[:, None] * (block.modes.T @ noise))
            moved = block.modes.T @ each
            j = block.sensitivities.T @ each - (block.modes.T @ block.sensitivities).T @ (weights[:, None] * moved)
            solved = cho_solve(factor, j)
            slope = slope + each.T @ weighed - solved.T @ (block.sensitivities.T @ weighed)
            curvature = curvature + np.einsum("nm,nm->m", each, each) - np.einsum(
                "km,k,km->m", moved, weights, moved) - np.einsum("qm,qm->m", j, solved)  # fmt: skip
        good = curvature > 1e-9
        slope = np.where(signs[:, None] * slope < 0, 0.0, slope)
        gains = np.where(good[:, None], slope**2 / np.where(good, curvature, 1.0)[:, None], 0.0) - penalty[:, None]
        return np.asarray(gains.max(axis=0))

    def _local(self, columns: Sequence[Array]) -> tuple[Array, Array, list[Array]]:
        """Return slope and curvature (levels, trials, m), and products with what is shared, one a level."""
        count, m = len(self.levels), columns[0].shape[1]
        slope, curvature = np.empty((count, len(self.blocks), m)), np.empty((count, len(self.blocks), m))
        g = self.blocks[0].shared.shape[1]
        cross = [np.empty((len(self.blocks), g, m)) for _ in range(count)]
        for index, (block, each) in enumerate(zip(self.blocks, columns, strict=True)):
            q = block.sensitivities.shape[1]
            known = np.column_stack([block.sensitivities, block.shared, block.residual])
            plain, moved = known.T @ each, block.modes.T @ each
            squares, moved_squares = np.einsum("nm,nm->m", each, each), moved**2
            for level in range(count):
                weights = self._weights[index][level]
                products = plain - (self._moved[index] * weights[:, None]).T @ moved
                factor, solved = self._factors[index][level][:2]
                inner = cho_solve(factor, products[:q])
                rest = products[q:] - solved.T @ products[:q]
                slope[level, index] = rest[-1]
                cross[level][index] = rest[:-1]
                curvature[level, index] = squares - weights @ moved_squares - np.einsum(
                    "qm,qm->m", products[:q], inner)  # fmt: skip
        return slope, curvature, cross

    def _factor(self, index: int, level: int) -> tuple[tuple[Array, bool], Array, Array, float]:
        """Return the factor of J'WJ, (J'WJ)^-1 J'W [G r], the rest of the normal matrix of [G r], log determinants."""
        block = self.blocks[index]
        q = block.sensitivities.shape[1]
        weights, moved = self._weights[index][level], self._moved[index]
        all_ = self._plain[index] - moved.T @ (weights[:, None] * moved)
        own = all_[:q, :q] + np.diag(1e-10 * np.diag(all_)[:q] + 1e-12)
        factor = cho_factor(own)
        solved = cho_solve(factor, all_[:q, q:])
        rest = all_[q:, q:] - all_[q:, :q] @ solved
        logs = 2 * float(np.log(np.diag(factor[0])).sum())
        logs += float(np.log1p(self.levels[level] ** 2 * block.variances).sum())
        return factor, solved, rest, logs

    def _shared_factor(self, level: int) -> tuple[Array, Array, float]:
        """Return matrix (g, g) and right side (g,) of what is shared, and the energy that is left."""
        rest = np.sum([each[level][2] for each in self._factors], axis=0)
        matrix = rest[:-1, :-1] + 1e-9 * np.diag(np.diag(rest)[:-1] + 1e-9)
        target = rest[:-1, -1]
        left = float(rest[-1, -1] - (target @ np.linalg.solve(matrix, target) if target.size else 0.0))
        return matrix, target, left

    def _evidence(self, level: int) -> float:
        believed = (self.levels[level] / self.blocks[0].usual_level) ** 2
        return -0.5 * float(sum(each[level][3] for each in self._factors) + self._shared[level][2] + believed)
