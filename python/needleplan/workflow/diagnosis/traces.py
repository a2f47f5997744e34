"""What a report shows of every trial: what was measured, what the model says before and after, what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from needleplan.diagnosis import Diagnosis
from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.refit import cases_with
from needleplan.signals import Array, Motion

__all__ = ["Phase", "Trace", "correlation", "gap_map", "traces_of"]

_AT_REST = 0.02
_REVERSAL_MM = 2.0
_DEPTHS = 10


class Phase(StrEnum):
    """What the needle does."""

    ADVANCE = "advance"
    HOLD = "hold"
    REVERSAL = "after a reversal"
    RETRACTION = "retraction"


@dataclass(frozen=True)
class Trace:
    """One trial: rows of shape (axes, samples), and whitened residuals with the samples that they are of."""

    trial: str
    held_out: bool
    motion: Motion
    measured: Array
    before: Array
    after: Array | None
    """With what was named; None where nothing was."""

    left_before: Array
    left_after: Array | None
    sample: NDArray[np.intp]


def traces_of(found: Diagnosis) -> tuple[Trace, ...]:
    """Return the training trials, then those held out."""
    calibration, joint = found.calibration, found.joint
    training = joint.cases if joint else None
    held_out = cases_with(joint.added, calibration, calibration.held_out) if joint else None
    return (
        *_traces(calibration.training, training, held_out=False),
        *_traces(calibration.held_out, held_out, held_out=True),
    )


def gap_map(traces: Sequence[Trace], *, after: bool) -> tuple[Array, Array]:
    """Return edges of depth, and the mean square of the whitened residual by phase and depth: 1 is noise alone.

    Shape (phases, depths); NaN where the needle never was.
    """
    deepest = max(float(each.motion.depth_mm.max()) for each in traces)
    edges = np.linspace(min(0.0, *(float(each.motion.depth_mm.min()) for each in traces)), deepest, _DEPTHS + 1)
    total, count = np.zeros((len(Phase), _DEPTHS)), np.zeros((len(Phase), _DEPTHS))
    for each in traces:
        left = each.left_after if after and each.left_after is not None else each.left_before
        depth = np.clip(np.searchsorted(edges, each.motion.depth_mm[each.sample], side="right") - 1, 0, _DEPTHS - 1)
        phase = _phases(each.motion)[each.sample]
        np.add.at(total, (phase, depth), left**2)
        np.add.at(count, (phase, depth), 1)
    return edges, np.where(count >= 5, total / np.maximum(count, 1), np.nan)


def correlation(traces: Sequence[Trace], lags: int, *, after: bool) -> tuple[Array, float]:
    """Return the autocorrelation of the whitened residual at lags 1 to `lags`, and the 99 % bound of white noise."""
    rows = [each.left_after if after and each.left_after is not None else each.left_before for each in traces]
    products = np.array([sum(float(row[lag:] @ row[:-lag]) for row in rows) for lag in range(1, lags + 1)])
    samples = sum(map(len, rows))
    return products / max(sum(float(row @ row) for row in rows), 1e-12), 2.576 / float(np.sqrt(samples))


def _traces(before: Sequence[Case], after: Sequence[Case] | None, *, held_out: bool) -> list[Trace]:
    found = []
    for index, case in enumerate(before):
        other = after[index] if after else None
        samples = len(case.motion)
        count = int(case.rows.sum())
        # Rows are of one axis after the other, each without the first samples, whose past is not known.
        known = len(case.rows) // (len(case.measured) // samples)
        sample = np.flatnonzero(case.rows) % known + samples - known
        found.append(
            Trace(
                case.record.trial, held_out, case.motion, case.measured.reshape(-1, samples),
                case.predicted.reshape(-1, samples), other.predicted.reshape(-1, samples) if other else None,
                case.block.residual[:count],
                other.block.residual[:count] if other else None, sample,
            )
        )  # fmt: skip
    return found


def _phases(motion: Motion) -> NDArray[np.intp]:
    """Return the place of each sample's phase in `Phase`, shape (samples,)."""
    order = list(Phase)
    speed = np.abs(motion.velocity_mm_s)
    found = np.where(motion.direction < 0, order.index(Phase.RETRACTION), order.index(Phase.ADVANCE))
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.depth_mm)))])
    for index in np.flatnonzero(np.diff(motion.direction) != 0) + 1:
        if motion.direction[index - 1] != 0:
            found[(way >= way[index]) & (way < way[index] + _REVERSAL_MM)] = order.index(Phase.REVERSAL)
    found[speed <= _AT_REST * max(float(speed.max()), 1e-12)] = order.index(Phase.HOLD)
    return np.asarray(found, np.intp)
