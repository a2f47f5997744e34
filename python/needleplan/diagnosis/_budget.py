"""The gap budget: what closes the gap between the given model and the readings, and the findings that do it.

Each stage is a fit of its own model, which contains the model of the stage before: the model as given, the model with
other values of its parameters in each trial, the same with the missing effects, and the same with other laws and
heterogeneous tissue, which belong to no model yet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from needleplan.artifacts import CallRepr
from needleplan.diagnosis._constants import CHANCE, LEAST_SHARE, SCATTER, SCATTER_FREEDOM, SIGNIFICANT, SURE_NATS
from needleplan.diagnosis._decision import DiagnosisDecision
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._tangents import in_trial, unblended
from needleplan.diagnosis.calibration import Calibration, calibrate_trial
from needleplan.diagnosis.catalogue import with_effects
from needleplan.models import Estimate, Model, simulate
from needleplan.signals import UNITS, Array, Role

__all__ = [
    "FindingKind",
    "GapBudget",
    "GapFinding",
    "GapStage",
    "OtherLaw",
    "OtherParameter",
    "findings_of",
    "gap_budget",
]


class FindingKind(StrEnum):
    """What closes a part of the gap."""

    EFFECT = "effect"
    """An effect that the model lacks."""

    PARAMETER = "parameter"
    """Another value of a parameter of the model."""

    LAW = "law"
    """Another law of the model than its own, such as that by which friction reverses, or a function of one variable."""

    FAMILY = "family"
    """Effects that explain a part, but that these data do not separate or do not support alone."""


@dataclass(frozen=True)
class GapFinding:
    """A part of the gap with its cause."""

    kind: FindingKind
    name: str
    """Effect, parameter or law; the effects of a family joined by " or "."""

    words: str
    """One sentence without a full stop."""

    probability: float = math.nan
    """Probability of an effect or a family; NaN for parameters and laws."""


@dataclass(frozen=True)
class OtherParameter(CallRepr):
    """A parameter of the given model beside its value in the data.

    `low` and `high` are the ends of the interval in the data. `file_low` and `file_high` are those of the model file,
    or None if it has no interval. `departs`: both intervals are apart; without a file, the given value is farther
    from the data than trials scatter.
    """

    name: str
    value: float
    low: float
    high: float
    given: float
    file_low: float | None
    file_high: float | None
    departs: bool
    unit: str

    @classmethod
    def of(cls, name: str, estimate: Estimate, given: float, known: Estimate | None, trials: int) -> OtherParameter:
        """Return a parameter with its estimate in the data, its given value, and its estimate in the model file.

        One trial does not show how far a parameter scatters between trials: it departs from a model file only.

        Parameters
        ----------
        name
            Name of the parameter.
        estimate
            Value and 95 % interval in the data.
        given
            Value in the given model, in the unit of the estimate.
        known
            Value and 95 % interval in the model file, or None if it has none.
        trials
            Number of trials of the estimate.

        Returns
        -------
        OtherParameter
            The parameter; `departs` tells whether the data contradict the given value.

        Examples
        --------
        >>> from needleplan.diagnosis import OtherParameter
        >>> from needleplan.models import Estimate
        >>> data = Estimate(value=0.2, sd=0.01, low=0.18, high=0.22, unit="mm", identified=True)
        >>> OtherParameter.of("presliding_mm", data, 0.05, None, trials=3).departs
        True
        """
        ends = np.array([given, estimate.value, estimate.low, estimate.high])
        here, value, low, high = (np.log(ends) if ends.min() > 0 else ends).tolist()
        apart = trials > 1 and abs(here - value) > _clear_distance(high - low, trials, log=ends.min() > 0)
        departs = known.high < estimate.low or estimate.high < known.low if known else apart
        first, last = (known.low, known.high) if known else (None, None)
        return cls(name, estimate.value, estimate.low, estimate.high, given, first, last, departs, estimate.unit)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.file_low is None or self.file_high is None:
            where = f"the model has {self.given:.3g}, without an interval"
        else:
            where = "outside" if self.departs else "inside"
            where += f" the interval of the model file, {self.file_low:.3g} to {self.file_high:.3g}"
        return f"{self.name} is {self.value:.3g}{unit} in the data ({self.low:.3g} to {self.high:.3g}), {where}"


@dataclass(frozen=True)
class OtherLaw(CallRepr):
    """A law of the base that differs from the model's, with the effects that would look alike."""

    law: str
    words: str
    alike: str
    nats: float
    """Log odds of the other law."""

    multiple: float
    """RMS of its deviation, in units of the noise RMS."""

    def __str__(self) -> str:
        odds = f"{math.exp(self.nats):.0f} to 1" if self.nats < math.log(1e4) else "above 10,000 to 1"
        size = f"odds {odds}; RMS {self.multiple:.1f} times the noise"
        return (
            f"{self.words} by another law than the model's ({size}): this needs no effect, but {self.alike} would "
            "look alike"
        )


@dataclass(frozen=True)
class GapStage:
    """RMS of the residual of some trials after a stage, and the share of the given model's gap that the stage closes.

    Shares are of the energy above that of the noise; NaN if the given model is off by no more than the noise.
    """

    name: str
    rms: float
    share: float


@dataclass(frozen=True)
class GapBudget(CallRepr):
    """What closes the gap of the given model, by trial and by role.

    Examples
    --------
    >>> from needleplan.diagnosis import GapBudget
    >>> budget = GapBudget("N", 0.02, {"first": {"given": 0.1, "parameters": 0.05, "laws": 0.02}}, {"first": "train"})
    >>> for stage in budget.stages():
    ...     print(f"{stage.name}: {stage.rms:g} N, closes {stage.share:.0%}")
    given: 0.1 N, closes 0%
    parameters: 0.05 N, closes 78%
    laws: 0.02 N, closes 22%
    """

    unit: str
    noise_rms: float
    trials: dict[str, dict[str, float]]
    """RMS after each stage, by trial: given, parameters, effects (if some were found), laws."""

    roles: dict[str, str]
    """Role of each trial."""

    readings: dict[str, int] = field(default_factory=dict)
    """Number of readings by trial, its weight in a mean; by default all trials count alike."""

    def stages(self, role: str = "") -> tuple[GapStage, ...]:
        """Return the stages of the trials of a role together; by default of training and held-out trials.

        Parameters
        ----------
        role
            Role of the trials, such as "holdout"; none if no trial has it.

        Returns
        -------
        tuple of GapStage
            The stages in their order, beginning with the given model.
        """
        wanted = (role,) if role else (str(Role.TRAIN), str(Role.HOLDOUT))
        some = [name for name in self.trials if self.roles[name] in wanted]
        if not some:
            return ()
        weights = np.array([self.readings.get(name, 1) for name in some], float)
        energies = {
            stage: float(weights @ [self.trials[name][stage] ** 2 for name in some] / weights.sum())
            for stage in self.trials[some[0]]
        }
        gap = energies["given"] - self.noise_rms**2
        count = weights.sum() if self.readings else math.inf
        known = gap > SIGNIFICANT * math.sqrt(2 / count) * self.noise_rms**2
        before, found = energies["given"], []
        for stage, energy in energies.items():
            found.append(GapStage(stage, math.sqrt(energy), (before - energy) / gap if known else math.nan))
            before = energy
        return tuple(found)

    def closes(self, name: str) -> bool:
        """Return whether a stage closes a part of the gap that is not negligible."""
        return any(stage.name == name and stage.share > LEAST_SHARE for stage in self.stages())

    def sentences(self) -> Iterator[str]:
        """Yield sentences without a full stop: the gap of the given model, then what closes it."""
        given, *others = self.stages()
        times = given.rms / self.noise_rms
        yield (
            f"the given model is off by {given.rms:.3g} {self.unit} RMS, {times:.2g} times the noise "
            f"({self.noise_rms:.3g} {self.unit})"
        )
        if math.isnan(given.share):
            yield "this is no more than the noise"
            return
        words = {"parameters": "other values of its parameters", "effects": "the effects", "laws": "laws and tissue"}
        parts = [f"{words[other.name]} close {other.share:.0%} ({other.rms:.3g} {self.unit} left)" for other in others]
        yield ", then ".join(parts)


def gap_budget(given: Model, calibration: Calibration, best: Hypothesis) -> GapBudget:
    """Return the budget of the gap of the given model; `best` is the set of effects that the report shows."""
    noise = calibration.noise.rms
    left = best.linear.residuals(best.best, best.linear.mean[best.best])
    trials: dict[str, dict[str, float]] = {}
    roles, readings = {}, {}
    for number, (alone, trial, rest) in enumerate(zip(calibration.trials, best.trials, left, strict=True)):
        name, beside = alone.record.trial, in_trial(best.effects, trial, number)
        both = calibrate_trial(
            unblended(trial.model), trial.record, calibration.noise, calibration.free,
            whole=partial(with_effects, effects=beside), start_lag_s=trial.lag_s, about=calibration.given,
        ) if best.names else alone  # fmt: skip
        trials[name] = {
            "given": _rms(alone.measured - simulate(given, alone.motion).output.ravel()),
            "parameters": _rms(alone.measured - alone.predicted),
            **({"effects": _rms(alone.measured - both.predicted)} if best.names else {}),
            "laws": noise * _rms(rest[: alone.readings]),
        }
        roles[name], readings[name] = str(alone.record.role), alone.readings
    budget = GapBudget(UNITS[given.channel.columns[0]], noise, trials, roles, readings)
    return replace(budget, trials=_nested(budget))


def _nested(budget: GapBudget) -> dict[str, dict[str, float]]:
    """Return the RMS by trial and stage; a stage that leaves more in training keeps the fit of the stage before.

    The model of each stage contains that fit. Its own fit may leave more, because the priors of the parameters count.
    """
    stages = [each.name for each in budget.stages(Role.TRAIN)]
    kept = {stages[0]: stages[0]}
    left = {each.name: each.rms for each in budget.stages(Role.TRAIN)}
    for before, stage in pairwise(stages):
        kept[stage] = stage if left[stage] <= left[kept[before]] else kept[before]
    return {name: {stage: own[kept[stage]] for stage in stages} for name, own in budget.trials.items()}


def findings_of(
    decision: DiagnosisDecision,
    budget: GapBudget,
    parameters: Sequence[OtherParameter],
    laws: Sequence[OtherLaw],
    effects: Mapping[str, tuple[str, float]],
) -> Iterator[GapFinding]:
    """Yield the causes that explain a part of the gap between the given model and the measurement.

    The causes are the named effects. If no effect is named, they are the family or the axis of the undecided answer.
    Then follow parameters and laws that differ from the given model and close a part of the budget. `effects` maps the
    name of each named effect to its description and its probability.
    """
    for name, (words, probability) in effects.items():
        yield GapFinding(FindingKind.EFFECT, name, words, probability)
    if not effects and decision.tied:
        some = decision.family or decision.tied[0]
        yield GapFinding(FindingKind.FAMILY, " or ".join(some), decision.because, decision.probability)
    elif not effects and decision.axis:
        yield GapFinding(FindingKind.LAW, str(decision.axis), decision.because, decision.probability)
    if budget.closes("parameters"):
        for parameter in parameters:
            if parameter.departs:
                yield GapFinding(FindingKind.PARAMETER, parameter.name, str(parameter))
    for law in laws:
        if law.nats > SURE_NATS and budget.closes("laws"):
            yield GapFinding(FindingKind.LAW, law.law, str(law))


def _clear_distance(width: float, trials: int, *, log: bool) -> float:
    """Return the distance from the mean of some trials beyond which a given value is not by chance.

    `width` is that of the 95 % interval of the mean. Two or three trials hardly tell how far a parameter scatters, so
    the variance of a logarithm is combined with the usual one, weighted by the degrees of freedom. Of other
    coordinates, such as angles, no scatter is usual.
    """
    freedom, usual = trials - 1, SCATTER_FREEDOM if log else 0
    variance = trials * (width / 2 / stdtrit(freedom, 0.975)) ** 2
    variance = (usual * SCATTER**2 + freedom * variance) / (usual + freedom)
    return float(stdtrit(usual + freedom, 1 - CHANCE / 2) * math.sqrt(variance / trials))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
