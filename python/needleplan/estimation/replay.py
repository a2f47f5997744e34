"""The open loop: a model simulated along records, with nothing fed back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.models import Model, simulate
from needleplan.signals import Array, MovingAverage, Record

__all__ = ["mean_absolute_error", "replay"]


def replay(model: Model, record: Record, *, smooth: MovingAverage | None = None) -> Array:
    """Return what the model predicts for a record, shape (samples,), averaged as the sensor does if told."""
    output = simulate(model, record.motion()).output
    return output if smooth is None else smooth.apply(output)


def mean_absolute_error(model: Model, records: Sequence[Record], *, smooth: MovingAverage | None = None) -> float:
    """Return the mean of |measured - replayed| over all samples that were measured, in the channel's unit.

    Infinite where the simulation grows without bound, NaN where nothing was measured.
    """
    measured = np.concatenate([np.isfinite(record[model.channel]) for record in records])
    if not measured.any():
        return float("nan")
    with np.errstate(over="ignore", invalid="ignore"):
        errors = [np.abs(record[model.channel] - replay(model, record, smooth=smooth)) for record in records]
        error = float(np.mean(np.concatenate(errors)[measured]))
    return error if np.isfinite(error) else float("inf")
