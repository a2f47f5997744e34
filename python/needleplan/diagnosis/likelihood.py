"""Likelihood of all trials: scores of candidate effects with the base model projected out.

For each trial, whitened by the sensor noise, with the sensitivity s(p) of the output to the amplitude a of a candidate
at p:

    r = J d + G b + s(p) a + h U S g + e,        e, g white;  d free; b free and shared by all trials

J holds the sensitivities of the base model, G those of effects that were accepted before. U S are the modes of the
tissue's heterogeneity and h is its standard deviation. d and b are projected out, g is integrated out, and h maximises
the restricted likelihood, separately for each candidate.

Heterogeneous properties of tissue are random functions of depth with an exponential correlation (Ornstein-Uhlenbeck),
expanded in their eigenfunctions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from weakref import ref

import numpy as np

from needleplan.signals import Array

__all__ = [
    "CORRELATION_MM",
    "GRID_MM",
    "HETEROGENEITY_SDS",
    "Gates",
    "JointLikelihood",
    "SensitivityScores",
    "WhitenedTrial",
    "at_depth",
    "functions_of_depth",
]

# Correlation length (mm) of the tissue's heterogeneity along the path.
CORRELATION_MM = 6.0
# Spacing (mm) of the depth grid of heterogeneity modes.
GRID_MM = 0.5
# Least share of the variance that the retained modes hold.
_VARIANCE_SHARE = 0.995
# Heterogeneity standard deviations tried, relative to the mean of the tissue's property.
HETEROGENEITY_SDS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
# Least eigenvalue of a scaled basis that counts.
_SEEN = 1e-7
# Share of a sensitivity's energy below which the remainder beside the base model is rounding error.
_ABSORBED = 1e-8


@dataclass(frozen=True)
class Gates:
    """Thresholds of the verdict. All gains are twice a log-likelihood; BIC gains subtract k log N for k parameters."""

    bic_gain: float = 10.0
    """BIC gain that an effect needs in nearly homogeneous tissue."""

    bic_gain_heterogeneous: float = 20.0
    """BIC gain that an effect needs if the heterogeneity exceeds `heterogeneous_above`."""

    heterogeneous_above: float = 0.05
    """Heterogeneity standard deviation from which `bic_gain_heterogeneous` applies."""

    p_value: float = 0.01
    """Largest probability that data without an effect reach the same BIC gain."""

    lead: float = 10.0
    """Lead in BIC gain over every other effect, and over alternatives that are as simple."""

    share_of_alternative: float = 0.93
    """A more flexible alternative wins only if the effects reach less than this share of its gain."""

    explained: float = 0.5
    """Least share of the gap that named effects must explain."""

    complete: float = 0.7
    """Share of the gap below which the verdict is incomplete."""

    transfer: float = 0.4
    """Share of the predicted held-out gain that an effect must achieve."""

    transfer_sds: float = 2.33
    """Standard deviations by which the achieved gain may fall short: one true effect in a hundred does."""

    closed: float = 0.5
    """Share of a certain held-out gap that named effects must close."""

    further: float = 0.03
    """Least gain of a further effect, as a share of the first effect's gain."""

    further_elsewhere: float = 0.005
    """The same for an effect of another family that the held-out trials confirm.

    The threshold is higher within a family because errors in the first effect's formula resemble that family.
    """

    most: int = 3
    """Largest number of names."""

    relevant: float = 1.0
    """RMS of an effect, in units of the noise RMS, from which it matters."""

    def needed(self, heterogeneity_sd: float) -> float:
        """Return the BIC gain that an effect needs at a heterogeneity standard deviation."""
        return self.bic_gain_heterogeneous if heterogeneity_sd > self.heterogeneous_above else self.bic_gain


def at_depth(depth_mm: Array, places: Array, rows: Array) -> Array:
    """Interpolate functions on a uniform grid, (places, m), linearly at depths, (samples, m)."""
    at = (depth_mm - places[0]) / (places[1] - places[0])
    left = np.clip(at.astype(int), 0, len(places) - 2)
    share = np.clip(at - left, 0.0, 1.0)[:, None]
    return np.asarray(rows[left] * (1 - share) + rows[left + 1] * share)


@lru_cache(maxsize=8)
def functions_of_depth(deepest_mm: float) -> tuple[Array, Array]:
    """Return scaled eigenfunctions of the heterogeneity, shape (places, modes), and the grid of depths (mm)."""
    places = np.arange(0.0, deepest_mm + GRID_MM, GRID_MM)
    covariance = np.exp(-np.abs(places[:, None] - places) / CORRELATION_MM)
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    count = min(int(np.searchsorted(np.cumsum(values) / values.sum(), _VARIANCE_SHARE)) + 1, 40)
    return vectors[:, :count] * np.sqrt(values[:count]), places


@dataclass(frozen=True)
class WhitenedTrial:
    """One whitened trial: residual (n,), sensitivities of the base model (n, q) and of shared effects (n, g)."""

    residual: Array
    base_sensitivities: Array
    shared: Array
    modes: Array
    """Orthonormal modes of the heterogeneity, shape (n, k)."""

    variances: Array
    """Variance of each mode at heterogeneity 1, shape (k,)."""

    usual_heterogeneity_sd: float = math.inf
    """Prior standard deviation of the heterogeneity; infinite for a flat prior."""

    independent_samples: int = 0
    """Number of samples that are independent for smooth functions; 0 for all."""

    @property
    def samples(self) -> int:
        """Number of whitened samples."""
        return len(self.residual)


@dataclass(frozen=True)
class SensitivityScores:
    """Slope and curvature of the log-likelihood by amplitude, for each heterogeneity (t) and candidate (m), (t, m)."""

    slope: Array
    curvature: Array
    evidence: Array
    """Log-likelihood of the base model at each heterogeneity, shape (t,)."""

    def gains(self, amplitudes: Array | None = None) -> tuple[Array, Array]:
        """Return twice the log-likelihood gain of each candidate and its heterogeneity index, shape (m,) each.

        The amplitudes are the best ones, or `amplitudes`, shape (t, m), if given.
        """
        if amplitudes is not None:
            each = (2 * self.slope - self.curvature * amplitudes) * amplitudes
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                each = np.where(self.curvature > 1e-9, self.slope**2 / self.curvature, 0.0)
        total = 2 * self.evidence[:, None] + each
        index = total.argmax(axis=0)
        return total.max(axis=0) - 2 * self.evidence.max(), index

    def amplitudes(self) -> Array:
        """Return the best amplitude of each candidate at each heterogeneity, shape (t, m)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.curvature > 1e-9, self.slope / self.curvature, 0.0)


@dataclass(frozen=True)
class _Trial:
    """Precomputed products of one trial at all heterogeneities (t); W is the inverse covariance of noise and tissue."""

    known: Array
    """Base sensitivities J, shared sensitivities G and residual r side by side, shape (n, q + g + 1)."""

    moved: Array
    """Product of the modes with `known`, shape (k, q + g + 1)."""

    weights: Array
    """Share of each mode that W removes, shape (t, k)."""

    root: Array
    """Inverse of the lower triangular Cholesky factor of J'WJ, shape (t, q, q)."""

    solved: Array
    """(J'WJ)^-1 J'W [G r], shape (t, q, g + 1)."""

    rest: Array
    """Normal matrix of [G r] with J projected out, shape (t, g + 1, g + 1)."""

    logs: Array
    """Log determinants of J'WJ and of the heterogeneity's covariance, shape (t,)."""

    @classmethod
    def of(cls, whitened: WhitenedTrial, heterogeneity_sds: Array) -> _Trial:
        """Return the products of a trial."""
        q = whitened.base_sensitivities.shape[1]
        known = np.column_stack([whitened.base_sensitivities, whitened.shared, whitened.residual])
        moved = whitened.modes.T @ known
        varied = heterogeneity_sds[:, None] ** 2 * whitened.variances
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

    def against(self, plain: Array, moved: Array, rows: slice = slice(None)) -> tuple[Array, Array]:
        """Return root J'W s, (t, q, m), and [G r]'W s with J projected out, (t, g + 1, m), for sensitivities s.

        `plain` is the product of `known` with s, `moved` the product of the modes with s. `rows` is a range of t.
        """
        q = self.root.shape[1]
        # One product for all heterogeneities: the modes' products are small.
        weighed = self.moved.T * self.weights[rows, None, :]
        products = plain - (weighed.reshape(-1, len(moved)) @ moved).reshape(*weighed.shape[:2], -1)
        rest = products[:, q:] - self.solved[rows].swapaxes(1, 2) @ products[:, :q]
        return self.root[rows] @ products[:, :q], rest


class JointLikelihood:
    """Restricted likelihood of several trials with common effects and a common heterogeneity."""

    def __init__(self, blocks: Sequence[WhitenedTrial], heterogeneity_sds: Array = HETEROGENEITY_SDS) -> None:
        self.blocks, self.heterogeneity_sds = tuple(blocks), np.asarray(heterogeneity_sds, float)
        self._scored: tuple[tuple[ref[Array], ...], SensitivityScores] | None = None
        self._trials = [_Trial.of(whitened, self.heterogeneity_sds) for whitened in self.blocks]
        self._rest = rest = np.sum([each.rest for each in self._trials], axis=0)
        g = rest.shape[1] - 1
        diagonal = np.einsum("tgg->tg", rest)[:, :-1]
        # Normal equations of the shared effects: matrix (t, g, g), right side (t, g), remaining energy (t,).
        self._shared = rest[:, :-1, :-1] + 1e-9 * (diagonal + 1e-9)[:, :, None] * np.eye(g)
        self._target = rest[:, :-1, -1]
        fitted = np.linalg.solve(self._shared, self._target[:, :, None])[:, :, 0]
        self._energy = rest[:, -1, -1] - np.einsum("tg,tg->t", self._target, fitted)
        prior_penalty = (self.heterogeneity_sds / self.blocks[0].usual_heterogeneity_sd) ** 2
        logs = np.sum([each.logs for each in self._trials], axis=0)
        self.evidence = -0.5 * (logs + self._energy + prior_penalty)
        self.evidence_alone = -0.5 * (logs + rest[:, -1, -1] + prior_penalty)

    @property
    def samples(self) -> int:
        """Number of whitened samples of all trials."""
        return sum(whitened.samples for whitened in self.blocks)

    @property
    def bic_penalty(self) -> float:
        """BIC penalty of one parameter: the logarithm of the number of independent samples."""
        return float(np.log(sum(whitened.independent_samples or whitened.samples for whitened in self.blocks)))

    @property
    def best(self) -> int:
        """Index of the heterogeneity that maximises the likelihood."""
        return int(self.evidence.argmax())

    @property
    def heterogeneity_sd(self) -> float:
        """Heterogeneity standard deviation that maximises the likelihood."""
        return float(self.heterogeneity_sds[self.best])

    def energy(self, index: int | None = None) -> float:
        """Return the weighted residual energy at a heterogeneity index, by default the best one."""
        return float(self._energy[self.best if index is None else index])

    def scores(self, sensitivities: Sequence[Array]) -> SensitivityScores:
        """Score candidate sensitivities, one array (n, m) per trial; an amplitude is common to all trials.

        The last result is cached by the identity of the arrays.
        """
        kept = self._scored
        if (
            kept
            and len(kept[0]) == len(sensitivities)
            and all(a() is b for a, b in zip(kept[0], sensitivities, strict=True))
        ):
            return kept[1]
        scores = self._scores(sensitivities)
        self._scored = tuple(map(ref, sensitivities)), scores
        return scores

    def _scores(self, sensitivities: Sequence[Array]) -> SensitivityScores:
        (t, g), m = self._target.shape, sensitivities[0].shape[1]
        slope, curvature, cross = np.zeros((t, m)), np.zeros((t, m)), np.zeros((t, g, m))
        energy = np.zeros(m)
        for whitened, trial, each in zip(self.blocks, self._trials, sensitivities, strict=True):
            moved = whitened.modes.T @ each
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
        return SensitivityScores(slope, np.where(curvature > _ABSORBED * energy, curvature, 0.0), self.evidence)

    def basis_gains(self, basis: Sequence[Array], *, ridge: float = 1e-9) -> float:
        """Return twice the log-likelihood gain of a whole basis, shape (n, df) per trial, with common coefficients."""
        matrix, target = self._normals(basis, slice(None))
        scale = np.sqrt(np.maximum(np.einsum("tdd->td", matrix), 1e-12))
        scaled = matrix / (scale[:, :, None] * scale[:, None]) + ridge * np.eye(scale.shape[1])
        values, vectors = np.linalg.eigh(scaled)
        part = np.einsum("tdi,td->ti", vectors, target / scale)
        keep = values > _SEEN
        gains = (np.where(keep, part, 0.0) ** 2 / np.where(keep, values, 1.0)).sum(axis=1)
        return float((2 * self.evidence + gains).max() - 2 * self.evidence.max())

    def shared_normal(self, index: int) -> tuple[Array, Array]:
        """Return matrix (g, g) and right side (g,) of the normal equations of the shared effects at an index."""
        return self._rest[index, :-1, :-1], self._rest[index, :-1, -1]

    def normal(self, basis: Sequence[Array], index: int) -> tuple[Array, Array]:
        """Return matrix (df, df) and right side (df,) of the normal equations of a basis at an index."""
        matrix, target = self._normals(basis, slice(index, index + 1))
        return matrix[0], target[0]

    def _normals(self, basis: Sequence[Array], heterogeneity_sds: slice) -> tuple[Array, Array]:
        (t, g), df = self._target[heterogeneity_sds].shape, basis[0].shape[1]
        matrix, target, cross = np.zeros((t, df, df)), np.zeros((t, df)), np.zeros((t, g, df))
        for whitened, trial, each in zip(self.blocks, self._trials, basis, strict=True):
            moved = whitened.modes.T @ each
            half, rest = trial.against(trial.known.T @ each, moved, heterogeneity_sds)
            weighed = trial.weights[heterogeneity_sds, :, None] * moved
            matrix += each.T @ each - moved.T @ weighed - half.swapaxes(1, 2) @ half
            target += rest[:, -1]
            cross += rest[:, :-1]
        if g:
            inner = np.linalg.solve(self._shared[heterogeneity_sds], cross)
            matrix -= cross.swapaxes(1, 2) @ inner
            target -= np.einsum("tgd,tg->td", inner, self._target[heterogeneity_sds])
        return matrix, target

    def null_maxima(self, sensitivities: Sequence[Array], penalty: Array, signs: Array, runs: int, seed: int) -> Array:
        """Return the largest penalised gain of all candidates in each of `runs` simulated data sets without an effect.

        The heterogeneity is held at its best value. `signs` is +1 or -1 for amplitudes of one sign, else 0.
        """
        generator = np.random.default_rng(seed)
        index = self.best
        slope: Array = np.zeros((sensitivities[0].shape[1], runs))
        curvature: Array = np.zeros(sensitivities[0].shape[1])
        energy: Array = np.zeros(sensitivities[0].shape[1])
        for whitened, trial, each in zip(self.blocks, self._trials, sensitivities, strict=True):
            q = whitened.base_sensitivities.shape[1]
            weights, root = trial.weights[index][:, None], trial.root[index]
            # W applied to noise that includes the modes has the distribution of W^(1/2) applied to white noise.
            noise = generator.standard_normal((whitened.samples, runs))
            modes = np.sqrt(whitened.variances) * self.heterogeneity_sds[index]
            noise += (whitened.modes * modes) @ generator.standard_normal((modes.size, runs))
            noise -= whitened.modes @ (weights * (whitened.modes.T @ noise))
            moved = whitened.modes.T @ each
            half = root @ (whitened.base_sensitivities.T @ each - trial.moved[:, :q].T @ (weights * moved))
            # The base model is projected out of the noise first: one large product with all candidates is enough.
            taken = whitened.base_sensitivities - whitened.modes @ (weights * trial.moved[:, :q])
            noise -= taken @ (root.T @ (root @ (whitened.base_sensitivities.T @ noise)))
            # Single precision is enough for random draws.
            slope += each.astype(np.float32).T @ noise.astype(np.float32)
            squares = np.einsum("nm,nm->m", each, each)
            energy += squares
            curvature += squares - (weights * moved**2).sum(axis=0) - (half**2).sum(axis=0)
        good = curvature > np.maximum(_ABSORBED * energy, 1e-9)
        slope = np.where(signs[:, None] * slope < 0, 0.0, slope)
        gains = np.where(good[:, None], slope**2 / np.where(good, curvature, 1.0)[:, None], 0.0) - penalty[:, None]
        return np.asarray(gains.max(axis=0))
