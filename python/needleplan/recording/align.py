"""Sensors with different rates: one record at the times of another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array, Record

__all__ = ["align"]


def align(
    record: Record, other: Record, columns: Sequence[str] | None = None, *, longest_gap_s: float | None = None
) -> Record:
    """Return `record` with columns of `other`, interpolated linearly to its times.

    `columns` defaults to those of `other` that `record` does not have. Nothing is extrapolated: samples of `record`
    outside of the time of `other` are left out. A sample in a gap of `other`, from number to number of the column more
    than `longest_gap_s` (default: five of its median intervals), becomes NaN. Both are counted in the notes. Velocities
    and forces of a faster sensor should be smoothed before: interpolation picks samples, it does not average.
    Raises DataError where the two do not overlap, or a column is missing or there is nothing to bring.
    """
    names = [name for name in other.columns if name not in record.columns] if columns is None else list(columns)
    missing = [Mistake(name, "", "is not in the other record") for name in names if name not in other.columns]
    if missing or not names:
        raise DataError(missing or "the other record has no column that this one lacks", other.trial)
    time, there = record["time_s"], other["time_s"]
    inside = (time >= there[0]) & (time <= there[-1])
    if inside.sum() < 2:
        rule = f"must overlap {there[0]:.6g} to {there[-1]:.6g} s, the time of the other record, by two samples"
        raise DataError(Mistake("time_s", f"{time[0]:.6g} to {time[-1]:.6g} s", rule), record.trial)
    notes = list(record.notes)
    early, late = int((time < there[0]).sum()), int((time > there[-1]).sum())
    if early or late:
        notes.append(f"{early} samples before and {late} after the time of the other record were left out")
    aligned = record.select(inside)
    for name in names:
        gap = 5 * float(np.median(np.diff(there))) if longest_gap_s is None else longest_gap_s
        values = _interpolated(aligned["time_s"], there, other[name], gap)
        lost = int(np.isnan(values).sum())
        if lost:
            notes.append(f"{name}: {lost} of {values.size} samples fall into gaps of the other record")
        aligned = aligned.with_column(name, values)
    notes.append(f"{', '.join(names)} interpolated from {len(other)} to {len(aligned)} samples")
    return replace(aligned, notes=tuple(notes))


def _interpolated(time: Array, there: Array, values: Array, gap: float) -> Array:
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(time.size, np.nan)
    there, values = there[known], values[known]
    found: Array = np.interp(time, there, values, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(there, time), 1, there.size - 1)
    found[(there[after] - there[after - 1] > gap) & (time != there[after]) & (time != there[after - 1])] = np.nan
    return found
