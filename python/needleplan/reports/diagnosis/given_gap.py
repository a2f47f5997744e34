"""The gap of the given model, before anything is fitted, and what takes it up: other parameters, laws and tissue.

A diagnosis fits the parameters of the model to each trial and gives its laws a tolerance. Both close a gap without the
name of an effect; here each says how much it closes. The energies are those of whitened residuals, in which the noise
has the variance 1:

- given: readings minus the output of the given model,
- fitted: readings minus the output of the fitted model, with the effects of the most probable set,
- left: the rest after the laws and the tissue at their posterior mean.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis import Diagnosis
from needleplan.models import simulate
from needleplan.signals import UNITS

__all__ = ["GivenGap", "GivenParameter", "LawShare", "gap_of_given"]

# Share of the gap below which a law is not named.
_LEAST_SHARE = 0.05

# Standard deviations of the energy of noise by which the given model must be off for the gap to have shares.
_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class GivenParameter:
    """A parameter of the given model beside its value in the data.

    `low` and `high` are the ends of the interval in the data. `file_low` and `file_high` are those of the model file,
    or None if it has no interval. `departs`: the value in the data is outside the interval of the file; without one,
    the given value is outside the interval in the data.
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

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.file_low is None or self.file_high is None:
            where = f"the model has {self.given:.3g}, without an interval"
        else:
            where = "outside" if self.departs else "inside"
            where += f" the interval of the model file, {self.file_low:.3g} to {self.file_high:.3g}"
        return f"{self.name} is {self.value:.3g}{unit} in the data ({self.low:.3g} to {self.high:.3g}), {where}"


@dataclass(frozen=True)
class LawShare:
    """A law of the base model whose tolerance takes up a share of the gap."""

    law: str
    share: float

    def __str__(self) -> str:
        return f"another law of {self.law} takes up {self.share:.0%} of the gap"


@dataclass(frozen=True)
class GivenGap:
    """RMS of readings minus output of the given model, and what takes up this gap.

    The shares are of the energy above that of the noise; NaN if the given model is off by no more than the noise.
    """

    rms: float
    noise_rms: float
    unit: str
    trials: dict[str, float]
    """RMS by trial."""

    fitted_share: float
    """Share of other parameters, sensor lag and effects."""

    laws_share: float
    """Share of laws and tissue."""

    parameters: tuple[GivenParameter, ...]
    """The free parameters, with the intervals of the model file."""

    laws: tuple[LawShare, ...]
    has_effects: bool

    def sentences(self) -> Iterator[str]:
        """Yield sentences without a full stop: the gap, then everything that takes it up."""
        times = self.rms / self.noise_rms
        yield (
            f"the given model is off by {self.rms:.3g} {self.unit} RMS, {times:.2g} times the noise "
            f"({self.noise_rms:.3g} {self.unit})"
        )
        if math.isnan(self.fitted_share):
            yield "this is no more than the noise"
        else:
            fitted = "other parameters and the effects" if self.has_effects else "other values of its parameters"
            yield (
                f"{fitted} take up {self.fitted_share:.0%} of this gap, other laws and the tissue {self.laws_share:.0%}"
            )
        yield from (str(parameter) for parameter in self.parameters if parameter.departs)
        yield from map(str, self.laws)


def gap_of_given(found: Diagnosis) -> GivenGap:
    """Return the gap of the given model in all training and held-out trials, and what takes it up."""
    best, h = found.named, found.named.best
    trials, off, given, fitted, readings = {}, [], 0.0, 0.0, 0
    for trial in best.trials:
        plain = trial.measured - simulate(found.given, trial.motion).output.ravel()
        off.append(plain)
        trials[trial.record.trial] = float(np.sqrt(np.nanmean(plain**2)))
        given += float((trial.noise.whiten(plain)[trial.rows] ** 2).sum())
        fitted += float((trial.whitened.residual[: trial.readings] ** 2).sum())
        readings += trial.readings

    def left(coefficients: np.ndarray) -> float:
        rows = best.linear.residuals(h, coefficients)
        return float(sum((row[: trial.readings] ** 2).sum() for trial, row in zip(best.trials, rows, strict=True)))

    mean, gap = best.linear.mean[h], given - readings
    rest = left(mean)
    known = gap > _SIGNIFICANT * math.sqrt(2 * readings)
    laws = []
    for law, columns in best.groups.items() if known else ():
        without = mean.copy()
        without[columns] = 0.0
        share = (left(without) - rest) / gap
        if str(law) != "effects" and share > _LEAST_SHARE:
            laws.append(LawShare(str(law), min(share, 1.0)))
    return GivenGap(
        rms=float(np.sqrt(np.nanmean(np.concatenate(off) ** 2))),
        noise_rms=found.calibration.noise.rms,
        unit=UNITS[found.given.channel.columns[0]],
        trials=trials,
        fitted_share=_share(given - fitted, gap) if known else math.nan,
        laws_share=_share(fitted - rest, gap) if known else math.nan,
        parameters=tuple(_parameters(found)),
        laws=tuple(sorted(laws, key=lambda law: -law.share)),
        has_effects=bool(best.effects),
    )  # fmt: skip


def _share(part: float, whole: float) -> float:
    return min(max(part / whole, 0.0), 1.0)


def _parameters(found: Diagnosis) -> Iterator[GivenParameter]:
    for name, estimate in found.estimates().items():
        given, known = float(getattr(found.given, name)), found.intervals.get(name)
        departs = not known.low <= estimate.value <= known.high if known else not estimate.low <= given <= estimate.high
        yield GivenParameter(
            name, estimate.value, estimate.low, estimate.high, given, known.low if known else None,
            known.high if known else None, departs, estimate.unit,
        )  # fmt: skip
