"""The motion to measure next: expected information of further trials, from the posterior of the trials so far.

Every hypothesis k predicts the readings y of one more trial of a motion,

    y = m_k + Z_k u + B d + h U S z + e,        u, d, z, e standard normal,

where m_k is the output of its effects at their posterior mean, Z_k Z_k' the covariance by the uncertainty of all its
coefficients, and B d the base parameters of the new trial. With W the inverse covariance of the last three terms, which
all hypotheses share, everything follows from the normal matrix X'W X of X = [m_1 Z_1 m_2 Z_2 ...]. Normal matrices of
several trials add up: several at once cost no more than one. Equation (10) of docs/explanation/posterior.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.diagnosis._components import Components
from needleplan.diagnosis._constants import AMPLITUDE_SCALES
from needleplan.diagnosis._decision import Verdict
from needleplan.diagnosis._evidence import LinearModel
from needleplan.diagnosis._factors import RIDGE
from needleplan.diagnosis._hypothesis import Hypothesis, nuisances
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._programs import predicted_trial, programs, recorded_limits
from needleplan.diagnosis._result import Diagnosis
from needleplan.diagnosis._threads import one_thread
from needleplan.diagnosis.catalogue import with_effects
from needleplan.diagnosis.data import Lack
from needleplan.models import simulate
from needleplan.models.effects import effect_columns
from needleplan.signals import Array, Motion, Program, Role

__all__ = ["CandidateMotion", "NextTrials", "Prediction", "next_trials"]

# Largest number of hypotheses that are compared, least probability of one, and bits below which a trial gives nothing.
_MOST, _LEAST_PROBABLE, _NOTHING_BITS = 6, 0.005, 1e-3


@dataclass(frozen=True)
class CandidateMotion(CallRepr):
    """A motion that may be measured next: a program, or the motion of a trial so far (`program` is None)."""

    name: str
    motion: Motion
    program: Program | None = None
    repeats: str = ""
    """Name of the trial that the motion repeats; empty if it repeats no trial."""

    @property
    def about(self) -> str:
        """What the motion is, in words."""
        return self.program.about if self.program else "a trial so far, once more"


@dataclass(frozen=True)
class NextTrials(ShortRepr):
    """The motions to measure next, in this order, with the information that they are expected to give."""

    motions: tuple[CandidateMotion, ...]
    bits: float
    """Expected information (bits) of all these trials on the open question."""

    repeated_bits: float
    """The same, if the last motion were repeated as many times."""

    open_bits: float
    """Entropy of the probabilities of the hypotheses (bits): no number of trials gives more about which one is true."""

    considered: tuple[tuple[str, float], ...]
    """Name and expected information (bits) of one trial of each candidate, the largest first."""

    question: str
    """What the trials are to decide, in words."""

    role: Role = Role.TRAIN
    """Role of the recordings: holdout if a name waits for a held-out trial of another motion."""

    @property
    def why(self) -> str:
        """Reason for the motions, in two sentences."""
        count, names = len(self.motions), ", then ".join(motion.name for motion in self.motions)
        trials, again = ("One trial", "once more") if count == 1 else (f"{count} trials", f"{count} times more")
        return (
            f"Open: {self.question}. {trials} of {names} should give {self.bits:.2f} bits; the last motion, {again}, "
            f"{self.repeated_bits:.2f} bits."
        )


@dataclass(frozen=True)
class Prediction:
    """Predictions of hypotheses for trials: normal matrix X'W X, where each hypothesis has the columns [m Z]."""

    normal: Array
    """Shape (columns, columns)."""

    first: tuple[int, ...]
    """Index of each hypothesis' column m, and the number of all columns; its columns Z follow."""

    functions: tuple[int, ...]
    """Number of the first columns Z that belong to a function along an axis; 0 without such a component."""

    shared: int = 0
    """Number of further columns Z, before all others and not counted by `first`, that all hypotheses have."""

    def __add__(self, other: Prediction) -> Prediction:
        """Return the joint prediction for the trials of both predictions."""
        return replace(self, normal=self.normal + other.normal)

    def times(self, count: int) -> Prediction:
        """Return the prediction for `count` trials of this motion."""
        return replace(self, normal=count * self.normal)

    @cached_property
    def own(self) -> Array:
        """The normal matrix of the hypotheses' own columns, the coefficients of the shared ones integrated out."""
        if not self.shared:
            return self.normal
        known, cross = self.normal[: self.shared, : self.shared], self.normal[: self.shared, self.shared :]
        return self.normal[self.shared :, self.shared :] - cross.T @ np.linalg.solve(np.eye(self.shared) + known, cross)

    def spread(self, k: int, known: int = 0) -> float:
        """Return log |C| of hypothesis k, apart from a constant, if the first `known` coefficients u were known."""
        own = slice(self.first[k] + 1 + known, self.first[k + 1])
        inner = self.own[own, own]
        return float(np.linalg.slogdet(np.eye(len(inner)) + inner)[1])

    def distance(self, i: int, j: int) -> float:
        """Return the Bhattacharyya distance between the predictions of two hypotheses."""
        columns = np.concatenate([np.arange(self.first[k] + 1, self.first[k + 1]) for k in (i, j)])
        inner = np.eye(len(columns)) + self.own[np.ix_(columns, columns)] / 2
        sign = np.zeros(len(self.own))
        sign[self.first[i]], sign[self.first[j]] = 1.0, -1.0
        cross = self.own @ sign
        moved = float(sign @ cross) - float(cross[columns] @ np.linalg.solve(inner, cross[columns])) / 2
        mixed = float(np.linalg.slogdet(inner)[1]) - (self.spread(i) + self.spread(j)) / 2
        return max(moved, 0.0) / 8 + max(mixed, 0.0) / 2

    def bits(self, probabilities: Array) -> float:
        """Return the expected information (bits) of the trials: on the true hypothesis, and on its function.

        The first part is the lower bound of Kolchinsky and Tracey, Entropy 19 (2017) 361, from the Bhattacharyya
        distances of all pairs: 0 if all hypotheses predict the same, the entropy of the probabilities if they are far
        apart. The second part is exact.
        """
        count = len(probabilities)
        near: Array = np.zeros((count, count))
        for i in range(count):
            for j in range(i):
                near[i, j] = near[j, i] = -self.distance(i, j)
        identity = float(-probabilities @ logsumexp(near + np.log(probabilities), axis=1))
        functions = [
            (self.spread(k) - self.spread(k, known)) / 2 if known else 0.0 for k, known in enumerate(self.functions)
        ]
        return (max(identity, 0.0) + float(probabilities @ functions)) / math.log(2)


@one_thread
def next_trials(found: Diagnosis, motions: Sequence[Program] | None = None, count: int = 1) -> NextTrials | None:
    """Return the `count` trials from which the most information is expected.

    Candidates are the programs and all motions recorded so far, so that the result is never worse than a repetition,
    unless a name waits for a held-out trial of another motion.
    The trials are chosen one after the other, each with the largest gain beside those before. If one motion that is
    repeated `count` times gives more, it is taken. If a name waits for a held-out trial of another motion, one of
    the programs is proposed, even if it is not expected to give information.

    Parameters
    ----------
    found
        The diagnosis so far.
    motions
        Candidate motions; by default `programs` within the recorded depths and speeds.
    count
        Number of trials to plan at once.

    Returns
    -------
    NextTrials or None
        None if the answer is NAMED, or if no candidate gives information.
    """
    if found.verdict is Verdict.NAMED:
        return None
    if motions is None:
        limits = recorded_limits(found.calibration)
        motions = programs(found.given.channel, limits) if limits else ()
    trials = found.posterior.problem.trials
    rate_hz = 1 / float(np.median(trials[-1].motion.interval_s))
    lacks = found.checked.lacks
    waits = found.lacks_data and (Lack.HELD_OUT in lacks or Lack.OTHER_MOTION in lacks)  # for another motion
    candidates = [
        *(CandidateMotion(motion.name, motion.motion(rate_hz), motion) for motion in motions),
        *(CandidateMotion(f"{trial.record.trial}, again", trial.motion, None, trial.record.trial) for trial in trials),
    ]
    permitted = len(motions) if waits and motions else len(candidates)
    asked = _question(found, [candidate.motion for candidate in candidates])
    known = asked.known.bits(asked.probabilities) if asked.known is not None else 0.0

    def gained(prediction: Prediction) -> float:
        whole = prediction if asked.known is None else asked.known + prediction
        return whole.bits(asked.probabilities) - known

    single = [gained(each) for each in asked.predictions]
    chosen = [int(np.argmax(single[:permitted]))]
    together, bits = asked.predictions[chosen[0]], max(single[:permitted])
    for _ in range(count - 1):
        further = [gained(together + each) for each in asked.predictions[:permitted]]
        chosen.append(int(np.argmax(further)))
        together, bits = together + asked.predictions[chosen[-1]], max(further)
    again = [gained(each.times(count)) for each in asked.predictions]
    if max(again[:permitted]) > bits:
        chosen, bits = [int(np.argmax(again[:permitted]))] * count, max(again[:permitted])
    if bits <= _NOTHING_BITS and not waits:
        return None
    order = np.argsort(-np.array(single), kind="stable").tolist()
    entropy = float(-asked.probabilities @ np.log2(asked.probabilities))
    return NextTrials(
        tuple(candidates[each] for each in chosen), bits, again[-1], entropy - known,
        tuple((candidates[each].name, single[each]) for each in order), asked.words,
        Role.HOLDOUT if waits and Lack.TRIALS not in lacks else Role.TRAIN,
    )  # fmt: skip


@dataclass(frozen=True)
class _Question:
    """An open question: the hypotheses with their probabilities, and what they predict of one trial of each motion."""

    words: str
    probabilities: Array
    predictions: tuple[Prediction, ...]
    known: Prediction | None = None
    """What the hypotheses predict of the trials so far, if the probabilities do not include these."""


def _question(found: Diagnosis, motions: Sequence[Motion]) -> _Question:
    """Return the open question of a diagnosis."""
    old = found.posterior.problem.trials
    new = [predicted_trial(found.calibration.model, found.calibration, motion) for motion in motions]
    joint = replace(found.posterior.problem, trials=(*old, *new))
    hidden = found.posterior.probability(()) >= found.settings.named
    return _of_hidden_effects(found, joint) if hidden else _of_hypotheses(found, joint)


def _of_hypotheses(found: Diagnosis, joint: Problem) -> _Question:
    """Return the open question: which of the probable hypotheses is true, and the form of its function."""
    posterior, count = found.posterior, len(found.posterior.problem.trials)
    fitted = [each for each in posterior.ranked if each[1] in posterior.hypotheses]
    probable = [each for each in fitted if each[0] >= _LEAST_PROBABLE][:_MOST] or fitted[:_MOST]
    learnt, names = [], []
    every: Components | None = None
    for _, effects, component in probable:
        hypothesis = posterior.hypotheses[effects]
        # The columns that all trials share are computed beside the same effects in the trials so far and in new ones.
        trials = (*(replace(each, shared=None) for each in hypothesis.trials), *joint.trials[count:])
        linear = Hypothesis.at(joint, hypothesis.effects, trials, scales=hypothesis.scales).linear
        functions = 0
        if component:
            every = every or Components(joint)
            columns, scale = _component(posterior.components, every, hypothesis, component)
            functions = columns[0].shape[1]
            basis = [
                np.hstack([joint.whiten(trial, number, columns[number]), linear.basis[number]])
                for number, trial in enumerate(trials)
            ]
            precision = np.concatenate([np.full(functions, scale**-2), linear.precision])
            linear = LinearModel(linear.blocks, basis, precision, linear.share)
        learnt.append(_Learnt.of(hypothesis, linear, functions, count))
        names.append(" and ".join(each for each in (*dict.fromkeys(effects), component) if each) or "nothing")
    weights = np.array([each for each, *_ in probable])
    predictions = []
    for number in range(count, len(joint.trials)):
        shared = _Shared.of(joint, number, found.named.best)
        columns = [each.columns(joint, number, shared) for each in learnt]
        predictions.append(shared.prediction(columns, [each.functions for each in learnt]))
    return _Question("which is missing: " + ", ".join(names), weights / weights.sum(), tuple(predictions))


def _of_hidden_effects(found: Diagnosis, joint: Problem) -> _Question:
    """Return the question whether an effect is hidden whose output has the RMS that matters, and which one."""
    posterior, count = found.posterior, len(found.posterior.problem.trials)
    curvature = posterior.screened.curvature[0]
    middle = [
        each.first + int(np.argsort(curvature[each.first : each.last])[len(each.grid) // 2])
        for each in posterior.entries
    ]  # fmt: skip
    sizes = found.settings.relevant * posterior.units[middle]
    made = []
    for number, trial in enumerate(joint.trials):
        shared = _Shared.of(joint, number, found.named.best)
        sds = posterior.hypotheses[()].linear.precision ** -0.5
        spread = shared.output(nuisances(joint, trial, number, ()) * sds)
        columns = [np.zeros((len(spread), 1))]
        for entry, index, size in zip(posterior.entries, middle, sizes.tolist(), strict=True):
            at = [entry.grid[index - entry.first]]
            one = trial.lag_sensitivity[:, None].copy() if entry.effect.is_lag else trial.whiten(
                effect_columns(entry.effect, trial.model, trial.motion, at)
            )  # fmt: skip
            shift = shared.output(joint.decorrelated(number, one))
            columns.append(size * shift)
        made.append(shared.prediction(columns, [0] * len(columns), spread))
    known = made[0]
    for each in made[1:count]:
        known = known + each
    any_effect, effects = found.settings.any_effect, len(posterior.entries)
    probabilities = np.array([1 - any_effect, *[any_effect / effects] * effects])
    words = f"whether an effect of {found.settings.relevant:g} noise RMS is hidden, and which"
    return _Question(words, probabilities, tuple(made[count:]), known)


@dataclass(frozen=True)
class _Shared:
    """What all hypotheses share of one trial: base parameters and tissue."""

    base: Array
    """Whitened change of the output by base parameters of their prior standard deviation, shape (rows, q)."""

    noise: Array
    """`base` and tissue side by side: columns of variance 1 beside the white noise."""

    @classmethod
    def of(cls, problem: Problem, number: int, h: int) -> _Shared:
        """Return the columns that all hypotheses share in the trial `number`, at the heterogeneity index `h`."""
        trial = problem.trials[number]
        block = problem.block(trial, number)
        rows = trial.readings
        base = block.base[:rows] / np.diag(block.base[rows:])
        tissue = block.modes[:rows] * np.sqrt(block.varied[h])
        return cls(base, np.hstack([base, tissue]))

    def output(self, columns: Array) -> Array:
        """Return columns with rows of priors as changes of the output: the base follows the shift of its prior."""
        rows = len(self.base)
        return columns[:rows] - self.base @ columns[rows:]

    def prediction(self, columns: Sequence[Array], functions: Sequence[int], common: Array | None = None) -> Prediction:
        """Return the predictions of hypotheses with the columns [m Z], base parameters and tissue integrated out.

        `common` are further columns Z that all hypotheses have.
        """
        x = np.hstack(columns if common is None else [common, *columns])
        known = self.noise.T @ self.noise + np.eye(self.noise.shape[1])
        half = np.linalg.solve(np.linalg.cholesky(known), self.noise.T @ x)
        first = np.concatenate([[0], np.cumsum([column.shape[1] for column in columns])])
        shared = 0 if common is None else common.shape[1]
        return Prediction(x.T @ x - half.T @ half, tuple(first.tolist()), tuple(functions), shared)


@dataclass(frozen=True)
class _Learnt:
    """A hypothesis with the posterior of its coefficients given the trials so far."""

    hypothesis: Hypothesis
    linear: LinearModel
    mean: Array
    root: Array
    """Lower triangular root of the covariance."""

    functions: int
    """Number of the first coefficients, those of a function along an axis."""

    @classmethod
    def of(cls, hypothesis: Hypothesis, linear: LinearModel, functions: int, count: int) -> _Learnt:
        """Return a hypothesis with the coefficients that the first `count` trials determine."""
        parts, f = linear.parts[:count, hypothesis.best].sum(axis=0), len(linear.precision)
        precision = parts[:f, :f] + np.diag(linear.precision)
        scale = 1 / np.sqrt(np.diag(precision))
        covariance = np.linalg.inv(scale[:, None] * precision * scale + RIDGE * np.eye(f))
        root = scale[:, None] * np.linalg.cholesky((covariance + covariance.T) / 2)
        return cls(hypothesis, linear, root @ (root.T @ parts[:f, f]), root, functions)

    def columns(self, joint: Problem, number: int, shared: _Shared) -> Array:
        """Return the mean m and the columns Z of a further trial side by side."""
        trial = joint.trials[number]
        plain = simulate(trial.model, trial.motion).output
        effects = [effect.in_trial(number) for effect in self.hypothesis.effects]
        whole = simulate(with_effects(trial.model, effects), trial.motion).output
        mean = shared.output(joint.whiten(trial, number, (whole - plain).ravel()[:, None]))
        basis = shared.output(self.linear.basis[number])
        return np.column_stack([mean[:, 0] + basis @ self.mean, basis @ self.root])


def _component(old: Components, joint: Components, hypothesis: Hypothesis, name: str) -> tuple[list[Array], float]:
    """Return the columns of a component for all trials, at its best place and scale beside a hypothesis."""
    gains = old.evidence(hypothesis).gains[name]
    scale, _, group = np.unravel_index(int(gains.argmax()), gains.shape)
    before = next(component for component in old.components if component.name == name)
    after = next(component for component in joint.components if component.name == name)
    at = int(np.abs(after.places - before.places[group]).argmin()) if len(before.places) else 0
    return [each[:, after.groups[at]] for each in joint.raw], float(AMPLITUDE_SCALES[scale])
