"""Likelihood of all trials: scores of candidate effects with the base model projected out.

Each trial is whitened by the sensor noise. The sensitivity of its output to the amplitude a of a candidate at grid
point p is s(p). The residual r of the trial is

    r = J d + G b + s(p) a + h U S g + e,        e, g white;  d free; b free and shared by all trials

J holds the sensitivities of the base model, G the sensitivities of the effects that were accepted before. U S are the
modes of the tissue's heterogeneity and h is its standard deviation. d and b are projected out and g is integrated
out. h maximises the restricted likelihood, separately for each candidate.

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
    "LARGEST_HETEROGENEITY",
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
# Share of the variance that the retained heterogeneity modes hold at least.
_VARIANCE_SHARE = 0.995
# Heterogeneity standard deviations tried, relative to the mean of the tissue's property.
HETEROGENEITY_SDS = np.array([0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3])
# Remark of a diagnosis whose heterogeneity is the last of these.
LARGEST_HETEROGENEITY = f"the heterogeneity is at its limit, {HETEROGENEITY_SDS[-1]:.0%}: model or noise is far off"
# Eigenvalue of a scaled basis below which a direction counts as undetermined.
_SEEN = 1e-7
# Share of a sensitivity's energy that the base model leaves, below which the remainder is rounding error.
_ABSORBED = 1e-8


@dataclass(frozen=True)
class Gates:
    """Thresholds of the verdict. A gain is twice a difference of log-likelihoods; a BIC gain is a gain minus k log N.

    k is the number of parameters, N the number of independent samples.
    """

    bic_gain: float = 10.0
    """BIC gain that an effect needs in nearly homogeneous tissue."""

    bic_gain_heterogeneous: float = 20.0
    """BIC gain that an effect needs if the heterogeneity exceeds `heterogeneous_above`."""

    heterogeneous_above: float = 0.05
    """Heterogeneity standard deviation above which `bic_gain_heterogeneous` applies."""

    p_value: float = 0.01
    """Largest permitted probability that data without an effect reach the BIC gain of the effect."""

    lead: float = 10.0
    """Lead in BIC gain that an effect needs over all other effects and over alternatives of equal simplicity."""

    share_of_alternative: float = 0.93
    """Share of the gain of a more flexible alternative; if the effects gain more, this alternative cannot win."""

    explained: float = 0.5
    """Share of the gap that named effects must explain at least."""

    complete: float = 0.7
    """Explained share of the gap below which the verdict is incomplete."""

    transfer: float = 0.4
    """Share of the predicted held-out gain that an effect must achieve."""

    transfer_sds: float = 2.33
    """Shortfall of the achieved gain, in standard deviations, that is accepted; 1 % of true effects exceed it."""

    closed: float = 0.5
    """Share of the held-out gap that named effects must close, if that gap is certain."""

    further: float = 0.03
    """Gain that a further effect needs, as a share of the gain of the first effect."""

    further_elsewhere: float = 0.005
    """As `further`, for an effect that the held-out trials confirm and that is not of the first effect's family.

    `further` is larger because errors in the formula of the first effect resemble effects of its family.
    """

    most: int = 3
    """Largest number of effects that are named."""

    relevant: float = 1.0
    """RMS of an effect, in units of the noise RMS, above which the effect is relevant."""

    def needed(self, heterogeneity_sd: float) -> float:
        """Return the BIC gain that an effect needs in tissue with the given heterogeneity standard deviation."""
        return self.bic_gain_heterogeneous if heterogeneity_sd > self.heterogeneous_above else self.bic_gain


def at_depth(depth_mm: Array, places: Array, rows: Array) -> Array:
    """Interpolate `rows`, functions on the uniform grid `places`, linearly at depths, clipped; shape (samples, m)."""
    at = (depth_mm - places[0]) / (places[1] - places[0])
    left = np.clip(at.astype(int), 0, len(places) - 2)
    share = np.clip(at - left, 0.0, 1.0)[:, None]
    return np.asarray(rows[left] * (1 - share) + rows[left + 1] * share)


@lru_cache(maxsize=8)
def functions_of_depth(deepest_mm: float) -> tuple[Array, Array]:
    """Return scaled eigenfunctions of the heterogeneity, shape (places, modes), and their depths `places` (mm)."""
    places = np.arange(0.0, deepest_mm + GRID_MM, GRID_MM)
    covariance = np.exp(-np.abs(places[:, None] - places) / CORRELATION_MM)
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = values[::-1], vectors[:, ::-1]
    count = min(int(np.searchsorted(np.cumsum(values) / values.sum(), _VARIANCE_SHARE)) + 1, 40)
    return vectors[:, :count] * np.sqrt(values[:count]), places


@dataclass(frozen=True)
class WhitenedTrial:
    """One whitened trial: residual (n,), sensitivities of the base model (n, q) and of the shared effects (n, g)."""

    residual: Array
    base_sensitivities: Array
    shared: Array
    modes: Array
    """Orthonormal modes of the heterogeneity, shape (n, k)."""

    variances: Array
    """Variance of each mode at heterogeneity standard deviation 1, shape (k,)."""

    usual_heterogeneity_sd: float = math.inf
    """Prior standard deviation of the heterogeneity; infinite for a flat prior."""

    independent_samples: int = 0
    """Number of independent samples for the BIC penalty; 0 if all samples are independent."""

    @property
    def samples(self) -> int:
        """Number of rows n: whitened samples and priors."""
        return len(self.residual)


@dataclass(frozen=True)
class SensitivityScores:
    """Slope and (negative) curvature of the log-likelihood with respect to the amplitude of each candidate.

    Both have shape (t, m) for t heterogeneities and m candidates.
    """

    slope: Array
    curvature: Array
    evidence: Array
    """Log-likelihood of the base model at each heterogeneity, shape (t,)."""

    def gains(self, amplitudes: Array | None = None) -> tuple[Array, Array]:
        """Return twice the log-likelihood gain of each candidate, and its best heterogeneity index, both of shape (m,).

        The gain is that of the best amplitude, or of `amplitudes`, shape (t, m), if given.
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
    """Precomputed products of one trial at t heterogeneities.

    W is the inverse covariance of whitened noise and heterogeneity.
    """

    known: Array
    """Base sensitivities J, shared sensitivities G and residual r side by side, shape (n, q + g + 1)."""

    moved: Array
    """Product of the modes with `known`, shape (k, q + g + 1)."""

    weights: Array
    """Share of each mode's energy that W removes, shape (t, k)."""

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
        """Return the products of a whitened trial."""
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
        """Return two products of sensitivities s: root J'W s, and [G r]'W s with J projected out.

        The shapes are (t, q, m) and (t, g + 1, m). `plain` is the product of `known` with s, `moved` is the product of
        the modes with s, and `rows` selects heterogeneities.
        """
        q = self.root.shape[1]
        # All heterogeneities in one matrix product, which is faster than one product each.
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
        """Number of rows of all trials: whitened samples and priors."""
        return sum(whitened.samples for whitened in self.blocks)

    @property
    def bic_penalty(self) -> float:
        """BIC penalty of one parameter: logarithm of the number of independent samples."""
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
        """Return the weighted residual energy at a heterogeneity index, by default at the best heterogeneity."""
        return float(self._energy[self.best if index is None else index])

    def scores(self, sensitivities: Sequence[Array]) -> SensitivityScores:
        """Return the scores of candidates from their sensitivities, one array (n, m) per trial.

        The amplitude of a candidate is the same in all trials. The last result is cached by the identity of the arrays.
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
        """Return twice the log-likelihood gain of a basis, (n, df) per trial; all trials share its coefficients."""
        matrix, target = self._normals(basis, slice(None))
        scale = np.sqrt(np.maximum(np.einsum("tdd->td", matrix), 1e-12))
        scaled = matrix / (scale[:, :, None] * scale[:, None]) + ridge * np.eye(scale.shape[1])
        values, vectors = np.linalg.eigh(scaled)
        part = np.einsum("tdi,td->ti", vectors, target / scale)
        keep = values > _SEEN
        gains = (np.where(keep, part, 0.0) ** 2 / np.where(keep, values, 1.0)).sum(axis=1)
        return float((2 * self.evidence + gains).max() - 2 * self.evidence.max())

    def shared_normal(self, index: int) -> tuple[Array, Array]:
        """Return matrix (g, g) and right side (g,) of the shared effects' normal equations at a heterogeneity index."""
        return self._rest[index, :-1, :-1], self._rest[index, :-1, -1]

    def normal(self, basis: Sequence[Array], index: int) -> tuple[Array, Array]:
        """Return matrix (df, df) and right side (df,) of a basis' normal equations at a heterogeneity index."""
        matrix, target = self._normals(basis, slice(index, index + 1))
        return matrix[0], target[0]

    def _normals(self, basis: Sequence[Array], rows: slice) -> tuple[Array, Array]:
        (t, g), df = self._target[rows].shape, basis[0].shape[1]
        matrix, target, cross = np.zeros((t, df, df)), np.zeros((t, df)), np.zeros((t, g, df))
        for whitened, trial, each in zip(self.blocks, self._trials, basis, strict=True):
            moved = whitened.modes.T @ each
            half, rest = trial.against(trial.known.T @ each, moved, rows)
            weighed = trial.weights[rows, :, None] * moved
            matrix += each.T @ each - moved.T @ weighed - half.swapaxes(1, 2) @ half
            target += rest[:, -1]
            cross += rest[:, :-1]
        if g:
            inner = np.linalg.solve(self._shared[rows], cross)
            matrix -= cross.swapaxes(1, 2) @ inner
            target -= np.einsum("tgd,tg->td", inner, self._target[rows])
        return matrix, target

    def null_maxima(self, sensitivities: Sequence[Array], penalty: Array, signs: Array, runs: int, seed: int) -> Array:
        """Simulate `runs` data sets without an effect; return the largest BIC gain of all candidates in each, (runs,).

        The heterogeneity is held at its best value. `penalty` and `signs` have shape (m,); a sign is +1 or -1 if the
        amplitude must have this sign, else 0.
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
            # The base model is projected out of the noise, so that the large sensitivities are multiplied only once.
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
