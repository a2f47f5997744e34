"""What many insertions have in common: shares with intervals, means, percentiles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.planning import wilson
from needleplan_thesis.steering.trial import Trial

__all__ = ["Summary", "gap_closed", "summarized"]

_RESAMPLED = 2000


@dataclass(frozen=True)
class Summary:
    """Numbers of many insertions of one kind; lengths in mm, intervals of 95 %.

    `success` has the interval of Wilson, means those of the bootstrap. `failures` counts what kept the others from
    success, `seeds` says which they are.
    """

    runs: int
    predicted: float
    success: float
    success_interval: tuple[float, float]
    error_mm: float
    error_interval_mm: tuple[float, float]
    error_median_mm: float
    error_95_mm: float
    deviation_mm: float
    turns: float
    replans: float
    failures: Mapping[str, int]
    seeds: tuple[int, ...]


def summarized(trials: Sequence[Trial]) -> Summary:
    """Return what insertions of one kind have in common; there must be some."""
    errors = np.array([each.error_mm for each in trials])
    failed = [each for each in trials if not each.success]
    return Summary(
        runs=len(trials),
        predicted=trials[0].predicted,
        success=1 - len(failed) / len(trials),
        success_interval=wilson(len(trials) - len(failed), len(trials)),
        error_mm=float(errors.mean()),
        error_interval_mm=_mean_interval(errors),
        error_median_mm=float(np.median(errors)),
        error_95_mm=float(np.percentile(errors, 95)),
        deviation_mm=float(np.mean([each.deviation_mm for each in trials])),
        turns=float(np.mean([each.turns for each in trials])),
        replans=float(np.mean([each.replans for each in trials])),
        failures=dict(Counter(map(_failure, failed)).most_common()),
        seeds=tuple(each.task.seed for each in failed),
    )


def gap_closed(promised: float, kept: float, replanned: float) -> float | None:
    """Return by which share planning again narrows what is missing from a promise; None where nothing is missing."""
    gap = promised - kept
    return None if gap <= 0 else (replanned - kept) / gap


def _failure(trial: Trial) -> str:
    if trial.touched:
        return "an obstacle"
    if trial.left:
        return "out of the workspace"
    if trial.ending in ("", "target"):
        return "beside the target"
    return trial.ending


def _mean_interval(values: np.ndarray) -> tuple[float, float]:
    drawn = np.random.default_rng(1).choice(values, (_RESAMPLED, len(values))).mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5]).tolist()
    return low, high
