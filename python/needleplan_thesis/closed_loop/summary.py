"""What many rounds with one hidden effect have in common, and by how much the gaps shrink."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis import Verdict
from needleplan.planning import wilson
from needleplan_thesis.closed_loop.hidden import HiddenEffect
from needleplan_thesis.closed_loop.loop import OpenLoopInsertion, Round

__all__ = ["EffectSummary", "InsertionStatistics", "OverallResult", "ParameterMedians", "shrink", "summarized", "total"]

_FEWEST = 1e-9


@dataclass(frozen=True)
class InsertionStatistics:
    """Insertions by the plans of many seeds: success promised (mean) and realised, median error (mm)."""

    runs: int
    promised: float
    success: float
    success_interval: tuple[float, float]
    error_mm: float

    @property
    def gap(self) -> float:
        """Between the success that was planned and the one that was realised."""
        return abs(self.promised - self.success)

    @classmethod
    def of(cls, each: Sequence[OpenLoopInsertion]) -> InsertionStatistics:
        """Return what insertions have in common; there must be some."""
        good = sum(one.success for one in each)
        return cls(
            len(each), float(np.mean([one.promised for one in each])), good / len(each), wilson(good, len(each)),
            float(np.median([one.error_mm for one in each])),
        )  # fmt: skip


@dataclass(frozen=True)
class ParameterMedians:
    """A parameter of a named effect: medians over the rounds of its value and of the ends of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class EffectSummary:
    """What came of one hidden effect.

    `verdicts` counts how the last diagnosis of a round ended, `named` the sets of names that were given, `motions` the
    motions that were asked for and made; `sizes` are those of the set named most often.
    """

    hidden: HiddenEffect
    verdicts: Mapping[Verdict, int]
    named: Mapping[tuple[str, ...], int]
    motions: Mapping[str, int]
    sizes: Mapping[str, ParameterMedians]
    before: InsertionStatistics
    after: InsertionStatistics
    known: InsertionStatistics


def summarized(hidden: HiddenEffect, rounds: Sequence[Round]) -> EffectSummary:
    """Return what rounds with one hidden effect have in common; there must be some."""
    named = Counter(tuple(each.name for each in one.named) for one in rounds if one.named)
    motions = Counter(motion for one in rounds for motion in one.motions)
    return EffectSummary(
        hidden,
        dict(Counter(one.verdicts[-1] for one in rounds).most_common()),
        dict(named.most_common()),
        dict(motions.most_common()),
        _sizes(rounds, next(iter(dict(named.most_common())), ())),
        InsertionStatistics.of([each for one in rounds for each in one.before]),
        InsertionStatistics.of([each for one in rounds for each in one.after]),
        InsertionStatistics.of([each for one in rounds for each in one.known]),
    )


def _sizes(rounds: Sequence[Round], names: tuple[str, ...]) -> dict[str, ParameterMedians]:
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


def shrink(before: float, after: float, least: float = 0.0) -> float | None:
    """Return by which share something shrinks above the least that it can be; None where nothing is above that."""
    return 1 - (after - least) / (before - least) if before - least > _FEWEST else None


@dataclass(frozen=True)
class OverallResult:
    """Over all hidden effects: gaps of success, the sum of those of each, and the median error of all insertions (mm).

    `gap` and `error_mm` are before, after, and by the first plan where nothing is hidden.
    """

    gap: tuple[float, float, float]
    error_mm: tuple[float, float, float]


def total(summaries: Sequence[EffectSummary], rounds: Sequence[Round]) -> OverallResult:
    """Return both over all hidden effects; there must be some."""
    return OverallResult(
        (
            sum(each.before.gap for each in summaries), sum(each.after.gap for each in summaries),
            sum(each.known.gap for each in summaries),
        ),
        (
            float(np.median([each.error_mm for one in rounds for each in one.before])),
            float(np.median([each.error_mm for one in rounds for each in one.after])),
            float(np.median([each.error_mm for one in rounds for each in one.known])),
        ),
    )  # fmt: skip
