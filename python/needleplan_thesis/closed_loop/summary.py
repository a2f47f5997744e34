"""Statistics of the rounds with one hidden effect and of all rounds, and the relative reduction of gaps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis import Verdict
from needleplan.planning import wilson
from needleplan_thesis.closed_loop.hidden import HiddenEffect
from needleplan_thesis.closed_loop.loop import OpenLoopInsertion, Round

__all__ = [
    "EffectSummary",
    "InsertionStatistics",
    "OverallResult",
    "ParameterMedians",
    "reduction",
    "summarized",
    "total",
]

# Gap (or error, mm) below which a relative reduction is undefined.
_NO_GAP = 1e-9


@dataclass(frozen=True)
class InsertionStatistics:
    """Statistics of insertions: mean predicted success, realised success, and median error (mm)."""

    runs: int
    predicted: float
    success: float
    success_interval: tuple[float, float]
    error_mm: float

    @property
    def gap(self) -> float:
        """Absolute difference of predicted and realised success."""
        return abs(self.predicted - self.success)

    @classmethod
    def of(cls, each: Sequence[OpenLoopInsertion]) -> InsertionStatistics:
        """Return the statistics of at least one insertion."""
        good = sum(one.success for one in each)
        return cls(
            len(each), float(np.mean([one.predicted for one in each])), good / len(each), wilson(good, len(each)),
            float(np.median([one.error_mm for one in each])),
        )  # fmt: skip


@dataclass(frozen=True)
class ParameterMedians:
    """A parameter of a named effect: the medians, over the rounds, of estimate and 95 % limits."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class EffectSummary:
    """Results for one hidden effect.

    `verdicts` counts the verdicts of the final diagnosis of each round, `named` the sets of named effects, `motions`
    the recorded next motions. `parameters` holds the parameters of the most frequently named set of effects, by
    "effect.parameter". `before`, `after` and `known` are the insertions of `Round`.
    """

    hidden: HiddenEffect
    verdicts: Mapping[Verdict, int]
    named: Mapping[tuple[str, ...], int]
    motions: Mapping[str, int]
    parameters: Mapping[str, ParameterMedians]
    before: InsertionStatistics
    after: InsertionStatistics
    known: InsertionStatistics


def summarized(hidden: HiddenEffect, rounds: Sequence[Round]) -> EffectSummary:
    """Return the results of at least one round with the same hidden effect."""
    named = Counter(tuple(each.name for each in one.named) for one in rounds if one.named)
    motions = Counter(motion for one in rounds for motion in one.motions)
    return EffectSummary(
        hidden,
        dict(Counter(one.verdicts[-1] for one in rounds).most_common()),
        dict(named.most_common()),
        dict(motions.most_common()),
        _parameters(rounds, next(iter(dict(named.most_common())), ())),
        InsertionStatistics.of([each for one in rounds for each in one.before]),
        InsertionStatistics.of([each for one in rounds for each in one.after]),
        InsertionStatistics.of([each for one in rounds for each in one.known]),
    )


def _parameters(rounds: Sequence[Round], names: tuple[str, ...]) -> dict[str, ParameterMedians]:
    found: dict[str, ParameterMedians] = {}
    alike = [one for one in rounds if names and tuple(each.name for each in one.named) == names]
    for index, name in enumerate(names):
        for key, first in alike[0].named[index].estimates.items():
            rows = np.array([
                (each.value, each.low, each.high) for each in (one.named[index].estimates[key] for one in alike)
            ])  # fmt: skip
            value, low, high = np.median(rows, axis=0).tolist()
            found[f"{name}.{key}"] = ParameterMedians(value, low, high, first.unit)
    return found


def reduction(before: float, after: float, floor: float = 0.0) -> float | None:
    """Return the relative reduction, from `before` to `after`, of the part above `floor`.

    Returns None if `before` does not exceed `floor`.
    """
    return 1 - (after - floor) / (before - floor) if before - floor > _NO_GAP else None


@dataclass(frozen=True)
class OverallResult:
    """Results over all hidden effects: summed gaps of success, and median error (mm) of all insertions.

    Both have three values: first plan, plan with the diagnosed model, and first plan in a lab without a hidden effect.
    """

    gap: tuple[float, float, float]
    error_mm: tuple[float, float, float]


def total(summaries: Sequence[EffectSummary], rounds: Sequence[Round]) -> OverallResult:
    """Return the results over at least one hidden effect."""
    return OverallResult(
        (
            sum(summary.before.gap for summary in summaries), sum(summary.after.gap for summary in summaries),
            sum(summary.known.gap for summary in summaries),
        ),
        (
            float(np.median([each.error_mm for one in rounds for each in one.before])),
            float(np.median([each.error_mm for one in rounds for each in one.after])),
            float(np.median([each.error_mm for one in rounds for each in one.known])),
        ),
    )  # fmt: skip
