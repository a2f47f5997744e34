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
from weakref import ref

import numpy as np

from needleplan.signals import Array

__all__ = ["LEVELS", "Block", "Scores", "Space"]

LEVELS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
"""Levels of heterogeneity that are tried: standard deviation of the tissue's properties over their mean."""

_SEEN = 1e-7
"""Eigenvalue of a scaled basis from which on what it stands for counts."""

_ABSORBED = 1e-8
"""Share of a column's energy, left beside what the base takes up, below which it is rounding."""


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

    def gains(self, sizes: Array | None = None) -> tuple[Array, Array]:
        """Return twice the gain in log likelihood of every column over the base, and the level it takes, (m,) each.

        Of `sizes`, (t, m), and not of the best ones, if they are given.
        """
        if sizes is not None:
            each = (2 * self.slope - self.curvature * sizes) * sizes
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                each = np.where(self.curvature > 1e-9, self.slope**2 / self.curvature, 0.0)
        total = 2 * self.evidence[:, None] + each
        level = total.argmax(axis=0)
        return total.max(axis=0) - 2 * self.evidence.max(), level

    def sizes(self) -> Array:
        """Return the best size of every column at every level, shape (t, m)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.curvature > 1e-9, self.slope / self.curvature, 0.0)


@dataclass(frozen=True)
class _Trial:
    """What a trial brings to every score, at all levels (t) at once; W weighs by the noise and by the tissue."""

    known: Array
    """Sensitivities J, shared nuisances G and residual r, side by side: (n, q + g + 1)."""

    moved: Array
    """Modes times these, (k, q + g + 1)."""

    weights: Array
    """How much of each mode is taken out, (t, k)."""

    root: Array
    """Inverse of the lower triangular factor of J'WJ, (t, q, q)."""

    solved: Array
    """(J'WJ)^-1 J'W [G r], (t, q, g + 1)."""

    rest: Array
    """Normal matrix of [G r] with J projected out, (t, g + 1, g + 1)."""

    logs: Array
    """Log determinants of J'WJ and of the tissue's covariance, (t,)."""

    @classmethod
    def of(cls, block: Block, levels: Array) -> _Trial:
        q = block.sensitivities.shape[1]
        known = np.column_stack([block.sensitivities, block.shared, block.residual])
        moved = block.modes.T @ known
        varied = levels[:, None] ** 2 * block.variances
        weights = varied / (1 + varied)
        whole = known.T @ known - moved.T @ (weights[:, :, None] * moved)
        own, cross = whole[:, :q, :q], whole[:, :q, q:]
        diagonal = np.einsum("tqq->tq", own)
        factor = np.linalg.cholesky(own + (1e-10 * diagonal + 1e-12)[:, :, None] * np.eye(q))
        root = np.linalg.inv(factor)
        half = root @ cross
        rest = whole[:, q:, q:] - half.swapaxes(1, 2) @ half
        logs = 2 * np.log(np.einsum("tqq->tq", factor)).sum(axis=1) + np.log1p(varied).sum(axis=1)
        return cls(known, moved, weights, root, root.swapaxes(1, 2) @ half, rest, logs)

    def against(self, plain: Array, moved: Array, levels: slice = slice(None)) -> tuple[Array, Array]:
        """Return, of columns, root J'W a, (t, q, m), and [G r]'W a with J projected out, (t, g + 1, m).

        `plain` are the products of `known` with them, `moved` those of the modes.
        """
        q = self.root.shape[1]
        # Weights times what is small, and one product for all levels.
        weighed = self.moved.T * self.weights[levels, None, :]
        products = plain - (weighed.reshape(-1, len(moved)) @ moved).reshape(*weighed.shape[:2], -1)
        rest = products[:, q:] - self.solved[levels].swapaxes(1, 2) @ products[:, :q]
        return self.root[levels] @ products[:, :q], rest


class Space:
    """Trials that are judged together."""

    def __init__(self, blocks: Sequence[Block], levels: Array = LEVELS) -> None:
        self.blocks, self.levels = tuple(blocks), np.asarray(levels, float)
        self._scored: tuple[tuple[ref[Array], ...], Scores] | None = None
        self._trials = [_Trial.of(block, self.levels) for block in self.blocks]
        self._rest = rest = np.sum([each.rest for each in self._trials], axis=0)
        g = rest.shape[1] - 1
        diagonal = np.einsum("tgg->tg", rest)[:, :-1]
        # What is shared: its matrix (t, g, g) and right side (t, g), and the energy that is left.
        self._shared = rest[:, :-1, :-1] + 1e-9 * (diagonal + 1e-9)[:, :, None] * np.eye(g)
        self._target = rest[:, :-1, -1]
        fitted = np.linalg.solve(self._shared, self._target[:, :, None])[:, :, 0]
        self._energy = rest[:, -1, -1] - np.einsum("tg,tg->t", self._target, fitted)
        believed = (self.levels / self.blocks[0].usual_level) ** 2
        logs = np.sum([each.logs for each in self._trials], axis=0)
        self.evidence = -0.5 * (logs + self._energy + believed)
        self.evidence_alone = -0.5 * (logs + rest[:, -1, -1] + believed)
        """Where what is shared stays as it is."""

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
        return float(self._energy[self.best if level is None else level])

    def scores(self, columns: Sequence[Array]) -> Scores:
        """Score columns with one size for all trials, one array (n, m) for each; the last ones asked for are kept."""
        kept = self._scored
        if kept and len(kept[0]) == len(columns) and all(a() is b for a, b in zip(kept[0], columns, strict=True)):
            return kept[1]
        scores = self._scores(columns)
        self._scored = tuple(map(ref, columns)), scores
        return scores

    def _scores(self, columns: Sequence[Array]) -> Scores:
        (t, g), m = self._target.shape, columns[0].shape[1]
        slope, curvature, cross = np.zeros((t, m)), np.zeros((t, m)), np.zeros((t, g, m))
        energy = np.zeros(m)
        for block, trial, each in zip(self.blocks, self._trials, columns, strict=True):
            moved = block.modes.T @ each
            half, rest = trial.against(trial.known.T @ each, moved)
            slope += rest[:, -1]
            cross += rest[:, :-1]
            squares = np.einsum("nm,nm->m", each, each)
            energy += squares
            curvature += squares - trial.weights @ moved**2 - np.einsum("tqm,tqm->tm", half, half)
        if g:
            solved = np.linalg.solve(self._shared, cross)
            slope -= np.einsum("tgm,tg->tm", solved, self._target)
            curvature -= (cross * solved).sum(axis=1)
        return Scores(slope, np.where(curvature > _ABSORBED * energy, curvature, 0.0), self.evidence)

    def basis_gains(self, basis: Sequence[Array], *, ridge: float = 1e-9) -> float:
        """Return twice the gain in log likelihood of a whole basis, shape (n, df) for each trial, sizes shared."""
        matrix, target = self._normals(basis, slice(None))
        scale = np.sqrt(np.maximum(np.einsum("tdd->td", matrix), 1e-12))
        scaled = matrix / (scale[:, :, None] * scale[:, None]) + ridge * np.eye(scale.shape[1])
        values, vectors = np.linalg.eigh(scaled)
        part = np.einsum("tdi,td->ti", vectors, target / scale)
        keep = values > _SEEN
        gains = (np.where(keep, part, 0.0) ** 2 / np.where(keep, values, 1.0)).sum(axis=1)
        return float((2 * self.evidence + gains).max() - 2 * self.evidence.max())

    def shared_normal(self, level: int) -> tuple[Array, Array]:
        """Return matrix (g, g) and right side (g,) of the normal equations of what is shared, at a level."""
        return self._rest[level, :-1, :-1], self._rest[level, :-1, -1]

    def normal(self, basis: Sequence[Array], level: int) -> tuple[Array, Array]:
        """Return matrix (df, df) and right side (df,) of the normal equations of a basis at a level."""
        matrix, target = self._normals(basis, slice(level, level + 1))
        return matrix[0], target[0]

    def _normals(self, basis: Sequence[Array], levels: slice) -> tuple[Array, Array]:
        (t, g), df = self._target[levels].shape, basis[0].shape[1]
        matrix, target, cross = np.zeros((t, df, df)), np.zeros((t, df)), np.zeros((t, g, df))
        for block, trial, each in zip(self.blocks, self._trials, basis, strict=True):
            moved = block.modes.T @ each
            half, rest = trial.against(trial.known.T @ each, moved, levels)
            weighed = trial.weights[levels, :, None] * moved
            matrix += each.T @ each - moved.T @ weighed - half.swapaxes(1, 2) @ half
            target += rest[:, -1]
            cross += rest[:, :-1]
        if g:
            inner = np.linalg.solve(self._shared[levels], cross)
            matrix -= cross.swapaxes(1, 2) @ inner
            target -= np.einsum("tgd,tg->td", inner, self._target[levels])
        return matrix, target

    def null_maxima(self, columns: Sequence[Array], penalty: Array, signs: Array, runs: int, seed: int) -> Array:
        """Return the greatest penalised gain over all columns in `runs` simulated trials without an effect.

        The level is held at the one that the base takes. `signs` is +1 or -1 where a size has a sign, else 0.
        """
        generator = np.random.default_rng(seed)
        level = self.best
        slope: Array = np.zeros((columns[0].shape[1], runs))
        curvature: Array = np.zeros(columns[0].shape[1])
        energy: Array = np.zeros(columns[0].shape[1])
        for block, trial, each in zip(self.blocks, self._trials, columns, strict=True):
            q = block.sensitivities.shape[1]
            weights, root = trial.weights[level][:, None], trial.root[level]
            # W^(1/2) of white noise has the same law as W applied to noise with the modes in it.
            noise = generator.standard_normal((block.samples, runs))
            modes = np.sqrt(block.variances) * self.levels[level]
            noise += (block.modes * modes) @ generator.standard_normal((modes.size, runs))
            noise -= block.modes @ (weights * (block.modes.T @ noise))
            moved = block.modes.T @ each
            half = root @ (block.sensitivities.T @ each - trial.moved[:, :q].T @ (weights * moved))
            # The base takes its part of the noise first: then one product with the columns, the largest, is enough.
            taken = block.sensitivities - block.modes @ (weights * trial.moved[:, :q])
            noise -= taken @ (root.T @ (root @ (block.sensitivities.T @ noise)))
            # What is drawn needs no more than seven digits.
            slope += each.astype(np.float32).T @ noise.astype(np.float32)
            squares = np.einsum("nm,nm->m", each, each)
            energy += squares
            curvature += squares - (weights * moved**2).sum(axis=0) - (half**2).sum(axis=0)
        good = curvature > np.maximum(_ABSORBED * energy, 1e-9)
        slope = np.where(signs[:, None] * slope < 0, 0.0, slope)
        gains = np.where(good[:, None], slope**2 / np.where(good, curvature, 1.0)[:, None], 0.0) - penalty[:, None]
        return np.asarray(gains.max(axis=0))
