"""What all hypotheses share: calibrated trials, errors of reversals, tissue modes, law tolerance, and the settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from needleplan.diagnosis._base_law import base_laws
from needleplan.diagnosis._blocks import HETEROGENEITY_SDS, TISSUE_KINDS, Block, Indices
from needleplan.diagnosis._constants import (
    CLOCK_S,
    FORMULA_ERRORS,
    LOCAL_S,
    MOST_NODES,
    NEGLIGIBLE_ERROR,
    NODES_S,
    OTHER_LENGTH,
    OWN_LAW,
    SINGLE_SAMPLE,
    STRETCH,
    TURN_FEWEST,
    TURN_MOST,
    TURN_REST,
    TURN_TRAVEL,
    USUAL_SD,
    VISIBLE_MODE,
)
from needleplan.diagnosis._evidence import NoiseScale
from needleplan.diagnosis._factors import directions
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis.calibration import CalibratedTrial, Calibration
from needleplan.diagnosis.channels import channel_description
from needleplan.models import Channel
from needleplan.models.effects import Reach, presliding_of
from needleplan.signals import Array, AveragedMotion, Motion

__all__ = [
    "PRESLIDING",
    "UNIFORM",
    "Problem",
    "TrialErrors",
    "formula_errors",
    "other_length",
    "shared_base",
    "turns_of",
]

PRESLIDING = "presliding_mm"
"""Name of the length over which the friction of the base reverses."""

UNIFORM = 1 / math.sqrt(12)
"""Standard deviation of a time that is uniform within a sample interval, in sample intervals."""


@dataclass(frozen=True)
class TrialErrors:
    """Errors of one trial: rows, orthonormal directions in these rows, and their sizes.

    With the whitened output changes T by these errors, of prior variance 1, the noise has the covariance I + T T'. Its
    inverse square root removes a share of each direction of T.
    """

    rows: Indices | slice
    vectors: Array
    sizes: Array
    """Standard deviation of the error along each direction."""

    @classmethod
    def of(cls, columns: Array) -> TrialErrors:
        """Return the errors with these whitened output changes, shape (n, errors)."""
        some = np.flatnonzero(columns.any(axis=1))
        rows = some if 2 * len(some) < len(columns) else slice(None)  # a slice needs no copy
        return cls(rows, *directions(columns[rows]))

    @cached_property
    def removed(self) -> tuple[Array, Array]:
        """Directions of errors that are not negligible, and, as rows, these times the share that is removed."""
        kept = self.sizes > NEGLIGIBLE_ERROR
        vectors = self.vectors[:, kept]
        return vectors, ((1 - 1 / np.sqrt(1 + self.sizes[kept] ** 2)) * vectors).T

    @cached_property
    def log_volume(self) -> float:
        """Log determinant of the covariance, times -1/2."""
        return -0.5 * float(np.log1p(self.sizes**2).sum())

    def decorrelated(self, found: Array) -> Array:
        """Return columns whitened by these errors too. Overwrites its argument."""
        vectors, removed = self.removed
        part = found[self.rows]
        part -= vectors @ (removed @ part)
        if not isinstance(self.rows, slice):  # a slice is a view
            found[self.rows] = part
        return found


@dataclass(frozen=True)
class Problem:
    """What all hypotheses share: calibration without effects, its tissue modes, and the settings."""

    calibration: Calibration
    trials: tuple[CalibratedTrial, ...]
    settings: Settings
    noise_freedom: float
    """Degrees of freedom of the estimate of the noise variance."""

    largest_sd: float = float(HETEROGENEITY_SDS.max())
    """Largest heterogeneity that is summed over."""

    only: tuple[int, ...] = ()
    """Indices of the heterogeneities that are summed over, if not all up to the largest one."""

    def with_levels(self, levels: Indices) -> Problem:
        """Return the problem with a sum over a few heterogeneities, of `HETEROGENEITY_SDS`, which costs less."""
        found = replace(self, only=tuple(sorted({int(level) for level in levels})))
        found.__dict__.update(errors=self.errors, modes=self.modes)  # these do not depend on the levels
        return found

    def up_to(self, largest_sd: float) -> Problem:
        """Return the problem with a sum over the heterogeneities up to a largest one."""
        found = replace(self, largest_sd=largest_sd)
        found.__dict__.update(errors=self.errors, _tissue=self._tissue)  # these do not depend on it
        return found

    @cached_property
    def noise_scale(self) -> NoiseScale:
        """The uncertain variance of the noise of all readings."""
        return NoiseScale(self.noise_freedom, sum(trial.readings for trial in self.trials))

    @cached_property
    def reach(self) -> Reach:
        """Ranges that the motions cover together."""
        return Reach.of([trial.motion for trial in self.trials])

    @cached_property
    def largest_n(self) -> float:
        """Largest output that the base model predicts without effects; at least a tiny one."""
        return max(1e-6, *(float(np.abs(trial.predicted).max()) for trial in self.trials))

    @cached_property
    def log_prior_h(self) -> Array:
        """Log prior of each heterogeneity, half-normal, normalised over all, times that of the law tolerance.

        It contains the log determinant of the errors of single trials, which differs between tolerances.
        """
        each = -0.5 * (HETEROGENEITY_SDS / self.settings.heterogeneity) ** 2
        for kind in np.unique(TISSUE_KINDS):  # each kind is as probable; homogeneous tissue is a part of the first one
            own = np.flatnonzero(kind == TISSUE_KINDS)
            each[own] += np.log(np.gradient(HETEROGENEITY_SDS[own]))
        volume = sum(part.log_volume for trial in self.errors for part in trial)
        return np.asarray((each - logsumexp(each))[self.levels] + volume)

    @cached_property
    def levels(self) -> Indices:
        """Indices of the heterogeneities that are summed over, of `HETEROGENEITY_SDS`."""
        return np.array(self.only, np.intp) if self.only else np.flatnonzero(self.largest_sd >= HETEROGENEITY_SDS)

    @property
    def sds(self) -> Array:
        """Standard deviations of the tissue's heterogeneity that are summed over, shape (t,)."""
        return HETEROGENEITY_SDS[self.levels]

    @cached_property
    def errors(self) -> tuple[tuple[TrialErrors, ...], ...]:
        """Errors of each trial alone: those of its reversals, then those of the laws of its base."""
        found = []
        for trial in self.trials:
            turns = TrialErrors.of(trial.whiten(_turn_errors(trial, self.settings.reversal_law)))
            laws = base_laws(trial, (), self.reach, self.largest_n, self.settings)
            own = turns.decorrelated(trial.whiten(OWN_LAW * laws))
            found.append((turns, TrialErrors.of(own)))
        return tuple(found)

    def whiten(self, trial: CalibratedTrial, number: int, values: Array) -> Array:
        """Return output changes after lag and whitening by noise and errors of reversals, shape (n, m)."""
        return self.decorrelated(number, trial.whiten(values))

    def decorrelated(self, number: int, whitened: Array) -> Array:
        """Return columns of a trial, whitened by the noise, whitened by its errors too. Overwrites its argument."""
        for each in self.errors[number]:
            whitened = each.decorrelated(whitened)
        return whitened

    @cached_property
    def _tissue(self) -> tuple[tuple[Array, Array], ...]:
        """Orthonormal decorrelated modes of all kinds of tissue side by side, and their variances by kind, by trial."""
        found = []
        for number, trial in enumerate(self.trials):
            kinds = [directions(self.decorrelated(number, modes.copy())) for modes in trial.tissue]
            variances = block_diag(*(sizes**2 for _, sizes in kinds))
            found.append((np.hstack([vectors for vectors, _ in kinds]), variances))
        return tuple(found)

    @cached_property
    def modes(self) -> tuple[tuple[Array, Array], ...]:
        """Orthonormal tissue modes and their variances by kind, by trial, for the calibration without effects.

        Modes that have next to no energy at the largest heterogeneity, or at `USUAL_SD`, are left out.
        """
        found = []
        for modes, variances in self._tissue:
            kept = min(self.largest_sd, USUAL_SD) ** 2 * variances.max(axis=0) > VISIBLE_MODE
            found.append((modes[:, kept], variances[:, kept]))
        return tuple(found)

    def block(self, trial: CalibratedTrial, number: int, more: Array | float = 0.0) -> Block:
        """Return a calibrated trial as a block, with the tissue modes of the calibration without effects.

        `more` is added to the whitened residual.
        """
        own = trial.whitened
        base = self.decorrelated(number, own.base.copy())
        return Block(
            self.decorrelated(number, own.residual.copy()) + more, base, *self.modes[number], levels=self.levels
        )


def formula_errors(
    problem: Problem, trials: Sequence[CalibratedTrial], outputs: Sequence[Sequence[Array]]
) -> list[Array]:
    """Return whitened output changes by errors of the formulas by trial, if each is wrong by the share 1, (n, e).

    Equation (5): a formula is wrong by a random function of time, of the standard deviation of a share times the local
    change of the effect's output. The function is linear between nodes at intervals of `NODES_S`. `outputs` holds the
    outputs of the effects by trial.
    """
    found = []
    for number, (trial, own) in enumerate(zip(trials, outputs, strict=True)):
        axes, time = len(trial.measured) // len(trial.motion), trial.motion.time_s
        half = max(round(LOCAL_S / float(np.median(trial.motion.interval_s))), 1)
        change = np.sqrt(sum(_local_variance(each.reshape(axes, -1), half) for each in own))
        hats, weights = _hats(np.asarray(time, float).tobytes())
        hats = hats[:, change.max(axis=0) @ hats > NEGLIGIBLE_ERROR * trial.noise.sd * weights]
        columns = trial.on_each_axis(hats) * change.reshape(-1, 1)
        vectors, sizes = directions(problem.whiten(trial, number, columns))
        found.append((vectors * sizes)[:, max(FORMULA_ERRORS) * sizes > NEGLIGIBLE_ERROR])
    return found


@lru_cache(maxsize=32)
def _hats(time_s: bytes) -> tuple[Array, Array]:
    """Return the hat functions of nodes at intervals of `NODES_S`, shape (samples, nodes), and their sums, (nodes,).

    The times are a byte string, so that the result can be cached: a fit repeats them. The arrays are read-only.
    """
    time = np.frombuffer(time_s)
    interval = max(NODES_S, float(np.ptp(time)) / MOST_NODES)
    nodes = np.arange(time[0], time[-1] + interval, interval)
    hats = np.maximum(1 - np.abs(time[:, None] - nodes) / interval, 0.0)
    weights = hats.sum(axis=0)
    hats.flags.writeable = weights.flags.writeable = False
    return hats, weights


def _local_variance(values: Array, half: int) -> Array:
    """Return the variance of values in windows of 2 `half` + 1 samples along the last axis."""
    width = 2 * half + 1
    centred = values - values.mean(axis=-1, keepdims=True)  # running sums lose the digits of the mean otherwise
    padded = np.pad(centred, ((0, 0), (half + 1, half)), mode="edge")
    padded[:, 0] = 0.0
    sums, squares = (np.cumsum(each, axis=-1) for each in (padded, padded**2))
    mean = (sums[:, width:] - sums[:, :-width]) / width
    return np.asarray(np.maximum((squares[:, width:] - squares[:, :-width]) / width - mean**2, 0.0))


def _turn_errors(trial: CalibratedTrial, law: float) -> Array:
    """Return the output changes by errors of the time, duration and length of each reversal, (samples, errors).

    `law` is the standard deviation of the law of reversal.
    """
    motion, predicted = trial.motion, trial.predicted
    if trial.model.channel is not Channel.FORCE:
        return np.zeros((len(predicted), 0))
    dt = motion.sampled_s if isinstance(motion, AveragedMotion) else float(np.median(motion.interval_s))
    sd = math.hypot(CLOCK_S, UNIFORM * dt)
    slope = np.gradient(predicted, motion.time_s)
    curve = np.gradient(slope, motion.time_s)
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.depth_mm)))])
    found = []
    for turn in turns_of(motion).tolist():
        end = int(np.searchsorted(travel, travel[turn] + TURN_TRAVEL * presliding_of(trial.model)))
        end = min(max(end, turn + TURN_FEWEST), turn + TURN_MOST, len(predicted))
        part, own = slice(max(turn - 2, 0), end), np.zeros((len(predicted), 3 + TURN_FEWEST))
        longer = STRETCH * law * slope * np.maximum(motion.time_s - motion.time_s[turn], 0.0)
        own[part, :3] = np.column_stack([sd * slope, sd * dt / 2 * curve, longer])[part]
        after = np.arange(turn, min(turn + TURN_FEWEST, len(predicted)))
        own[after, 3 + after - turn] = (
            SINGLE_SAMPLE * law * np.abs(predicted[after] - predicted[np.maximum(after - 1, 0)])
        )
        found.append(own[:, own.any(axis=0)])
    return np.hstack([np.zeros((len(predicted), 0)), *found])


def turns_of(motion: Motion) -> Indices:
    """Return the samples at which a movement begins in another direction than the one before, shape (turns,).

    The first movement counts, and a dwell without reversal does not.
    """
    speed = np.where(
        np.abs(motion.velocity_mm_s) < TURN_REST * np.abs(motion.velocity_mm_s).max(), 0, motion.velocity_mm_s
    )
    return np.flatnonzero(np.diff(np.where(speed == 0, motion.direction, np.sign(speed)), prepend=0.0))


def shared_base(trial: CalibratedTrial) -> Array:
    """Return columns that shift the prior means of the q base parameters equally in all trials, shape (n, q).

    The n rows are the whitened readings, then one row for the prior of each base parameter. Only the prior rows are
    not 0: a coefficient of 1 shifts a prior mean by the prior standard deviation of one trial.
    """
    columns: Array = np.zeros(trial.whitened.base.shape)
    columns[trial.readings :] = -np.eye(columns.shape[1])
    return columns


def other_length(trial: CalibratedTrial) -> Array:
    """Return the column of a presliding length that another law of reversal has in all trials, shape (n, 1).

    Its coefficient has the standard deviation of the law of reversal. A model without this length has no column.
    """
    free = [name for name, what in trial.model.parameters().items() if what.free]
    found: Array = np.zeros((len(trial.whitened.residual), int(PRESLIDING in free)))
    if PRESLIDING in free:
        prior_sd = channel_description(trial.model.channel).priors[PRESLIDING]
        found[trial.readings + free.index(PRESLIDING)] = -OTHER_LENGTH / prior_sd
    return found
