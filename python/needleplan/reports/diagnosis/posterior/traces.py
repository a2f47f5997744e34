"""Measured and modelled output and residuals of every trial, for figures."""

from __future__ import annotations

from needleplan.diagnosis.posterior import PosteriorDiagnosis, residuals_of
from needleplan.reports.diagnosis.traces import TrialTrace

__all__ = ["traces_of"]


def traces_of(found: PosteriorDiagnosis) -> tuple[TrialTrace, ...]:
    """Return the traces of the training trials, followed by those of the held-out trials.

    "Before" is the fit without effects. "After" is the fit of the most probable set; it is missing if no effect is
    named, unless only missing data prevent a name.
    """
    before, after = found.nothing, found.named
    shown = bool(found.names) or found.lacks_data
    left_before, left_after = residuals_of(before, after), residuals_of(after)
    training = len(found.calibration.training)
    traces = []
    for number, (case, other) in enumerate(zip(before.trials, after.trials, strict=True)):
        samples = len(case.motion)
        traces.append(
            TrialTrace(
                case.record.trial, number >= training, case.motion, case.measured.reshape(-1, samples),
                case.predicted.reshape(-1, samples), other.predicted.reshape(-1, samples) if shown else None,
                left_before[number], left_after[number] if shown else None, case.samples(),
            )
        )  # fmt: skip
    return tuple(traces)
