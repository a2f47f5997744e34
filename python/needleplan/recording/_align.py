"""Interpolation of sensors with different rates to common times, and one trial from the channels of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.recording._sample_kinds import FIBRE, FORCE, IMAGE, POSE, STAGE
from needleplan.signals import FIBRE_COLUMNS, IMAGE_COLUMNS, Array, FrameName, Record, RecordFrame

__all__ = ["align", "good_samples", "resampled", "trial_of_channels"]

_GOOD = "good"

# Frame of a trial by the last of these kinds that it has: positions are those of the tracker.
_FRAMES = {
    STAGE.name: RecordFrame(FrameName.GUIDE, "zero of the stage"),
    POSE.name: RecordFrame(FrameName.TRACKER, "tracker"),
}

# Number of median intervals above which the interval between two samples counts as a gap
_GAP_INTERVALS = 5
# Largest number of samples of an interpolated trial; a rate that gives more is taken to be a mistake.
_MOST_SAMPLES = 20_000_000


def align(
    record: Record, other: Record, columns: Sequence[str] | None = None, *, longest_gap_s: float | None = None
) -> Record:
    """Return `record` with columns of `other`, interpolated linearly to the times of `record`.

    Nothing is extrapolated: samples of `record` outside of the time span of `other` are left out. Interpolation does
    not average, so smooth the columns of a faster sensor before aligning them.

    Parameters
    ----------
    record : Record
        Record that determines the times.
    other : Record
        Record that provides the columns.
    columns : sequence of str, optional
        Names of the columns to take from `other`; by default all columns that `record` lacks.
    longest_gap_s : float, optional
        Interval (s) between two finite values of a column beyond which the samples between them become NaN; by default
        five median intervals of `other`.

    Returns
    -------
    Record
        The samples of `record` within the time span of `other`. The notes count the samples left out and those in gaps.

    Raises
    ------
    DataError
        The records overlap by fewer than two samples, a column is missing from `other`, or no column is left to take.

    Examples
    --------
    >>> from needleplan.recording import align
    >>> from needleplan.signals import Record
    >>> force = Record({"time_s": [0.0, 0.1, 0.2, 0.3], "force_n": [0.0, 0.1, 0.2, 0.3]})
    >>> stage = Record({"time_s": [0.0, 0.2], "depth_mm": [0.0, 1.0]})
    >>> align(force, stage)["depth_mm"].tolist()
    [0.0, 0.5, 1.0]

    """
    names = [name for name in other.columns if name not in record.columns] if columns is None else list(columns)
    missing = [Mistake(name, "", "is not in the other record") for name in names if name not in other.columns]
    if missing or not names:
        raise DataError(missing or "the other record has no column that is missing from this record", other.trial)
    time, other_time = record["time_s"], other["time_s"]
    inside = (time >= other_time[0]) & (time <= other_time[-1])
    if inside.sum() < 2:
        rule = (
            f"must overlap {other_time[0]:.6g} to {other_time[-1]:.6g} s, the time of the other record, by two samples"
        )
        raise DataError(Mistake("time_s", f"{time[0]:.6g} to {time[-1]:.6g} s", rule), record.trial)
    notes = list(record.notes)
    early, late = int((time < other_time[0]).sum()), int((time > other_time[-1]).sum())
    if early or late:
        notes.append(f"{early} samples before and {late} after the time of the other record were left out")
    aligned = record.select(inside)
    for name in names:
        gap_s = _GAP_INTERVALS * float(np.median(np.diff(other_time))) if longest_gap_s is None else longest_gap_s
        values = _interpolated(aligned["time_s"], other_time, other[name], gap_s)
        in_gaps = int(np.isnan(values).sum())
        if in_gaps:
            notes.append(f"{name}: {in_gaps} of {values.size} samples fall into gaps of the other record")
        aligned = aligned.with_column(name, values)
    notes.append(f"{', '.join(names)} interpolated from {len(other)} to {len(aligned)} samples")
    return replace(aligned, notes=tuple(notes), frame=record.frame if record.frame.known else other.frame)


def trial_of_channels(
    channels: Sequence[tuple[str, str, Mapping[str, Any]]], force_axis: Sequence[float], source: str
) -> Record:
    """Return the samples of force sensor, stage and tracker as one trial, as described at `Recording.trial`.

    `channels` holds (topic, name of the message kind, columns) of each topic with samples. Raises DataError if no topic
    has one of the three kinds, or if their times do not overlap.
    """
    axis = np.array(force_axis)
    found: list[Record] = []
    notes: list[str] = []
    frame = RecordFrame()
    for kind in (FORCE, STAGE, POSE, FIBRE, IMAGE):
        matching = sorted((topic, columns) for topic, name, columns in channels if name == kind.name)
        if not matching:
            if kind not in (FIBRE, IMAGE):  # few insertions have these sensors
                notes.append(f"no samples of {kind.name}")
            continue
        topic, columns = matching[0]
        if len(matching) > 1:
            notes.append(f"of {', '.join(each for each, _ in matching)} only the first is in the trial")
        record, remarks = _increasing_in_time(_trial_columns(kind.name, columns, axis))
        frame = _FRAMES.get(kind.name, frame)
        notes += [f"{topic}: {remark}" for remark in remarks]
        found.append(record)
    if not found:
        raise DataError("holds no samples of a force sensor, a stage or a tracker", source)
    trial = found[0]
    for other in found[1:]:
        trial = _placed(trial, other) if IMAGE_COLUMNS[0] in other.columns else align(trial, other)
    return replace(trial, notes=(*notes, *trial.notes), frame=replace(frame, provenance=source))


def _placed(record: Record, images: Record) -> Record:
    """Return the record with each position of an image in its first row at or after the arrival; NaN in other rows.

    A position between two images is not interpolated: it would count as one more measurement.
    """
    rows = np.searchsorted(record["time_s"], images["time_s"])
    inside = rows < len(record)
    for name in IMAGE_COLUMNS:
        values = np.full(len(record), np.nan)
        values[rows[inside]] = images[name][inside]
        record = record.with_column(name, values)
    return replace(record, notes=(*record.notes, f"{', '.join(IMAGE_COLUMNS)}: {int(inside.sum())} images"))


def good_samples(columns: Mapping[str, Any], values: Mapping[str, Array]) -> dict[str, Array]:
    """Return a copy of `values` with NaN in the rows in which `columns["health"]` is not "good"."""
    good = columns["health"] == _GOOD
    return {name: np.where(good, each, np.nan) for name, each in values.items()}


def _interpolated(time: Array, other_time: Array, values: Array, gap_s: float) -> Array:
    finite = np.isfinite(values)
    if finite.sum() < 2:
        return np.full(time.size, np.nan)
    other_time, values = other_time[finite], values[finite]
    found: Array = np.interp(time, other_time, values, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(other_time, time), 1, other_time.size - 1)
    in_gap = other_time[after] - other_time[after - 1] > gap_s
    found[in_gap & (time != other_time[after]) & (time != other_time[after - 1])] = np.nan
    return found


def _trial_columns(kind: str, columns: Mapping[str, Any], axis: Array) -> dict[str, Array]:
    """Convert the columns of a topic to the columns of a data file; force and torque are projected onto `axis`.

    Samples that are not good become NaN.
    """
    if kind == FORCE.name:
        force = np.stack([columns[f"force_{each}_n"] for each in "xyz"], axis=1) @ axis
        torque = np.stack([columns[f"torque_{each}_n_mm"] for each in "xyz"], axis=1) @ axis
        values = {"force_n": force, "torque_n_mm": torque}
    elif kind == STAGE.name:
        names = {"depth_mm": "depth_mm", "velocity_mm_s": "velocity_mm_s", "angle_rad": "roll_rad"}
        values = {name: columns[field] for name, field in names.items()}
    elif kind == FIBRE.name:
        values = {name: columns[name] for name in FIBRE_COLUMNS if np.isfinite(columns[name]).any()}
    else:
        values = {name: columns[name] for name in (IMAGE_COLUMNS if kind == IMAGE.name else ("x_mm", "y_mm", "z_mm"))}
    return {"time_s": columns["time_s"], **good_samples(columns, values)}


def _increasing_in_time(columns: dict[str, Array]) -> tuple[Record, list[str]]:
    time = columns["time_s"]
    later = np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    record = Record({name: values[later] for name, values in columns.items()})
    missing = int(max(np.isnan(values).sum() for values in record.columns.values()))
    remarks = [f"samples that are not good became missing numbers: {missing}"] if missing else []
    repeated = int((~later).sum())
    return record, [
        *remarks,
        f"{repeated} samples with repeated or decreasing time were left out",
    ] if repeated else remarks


def resampled(record: Record, rate_hz: float) -> Record:
    """Return the record interpolated linearly to a rate, with a note. Beside missing measurements, values are missing.

    Parameters
    ----------
    record : Record
        The record.
    rate_hz : float
        Samples a second.

    Returns
    -------
    Record

    Raises
    ------
    DataError
        The rate is not positive and finite, or gives fewer than two or very many samples.

    Examples
    --------
    >>> from needleplan.recording import resampled
    >>> from needleplan.signals import Record
    >>> record = Record({"time_s": [0.0, 0.2, 0.4], "force_n": [0.0, 0.4, 0.0]})
    >>> resampled(record, 10.0)["force_n"].round(9).tolist()
    [0.0, 0.2, 0.4, 0.2, 0.0]

    """
    time = record["time_s"]
    count = int((time[-1] - time[0]) * rate_hz * (1 + 1e-12)) + 1 if 0 < rate_hz < np.inf else 0
    if not 2 <= count <= _MOST_SAMPLES:
        rule = f"must give from 2 to {_MOST_SAMPLES:,} samples for the {time[-1] - time[0]:.4g} s of {record.trial}"
        raise DataError(Mistake("rate", f"{rate_hz:g} Hz", rule))
    even = time[0] + np.arange(count) / rate_hz
    columns = {name: np.interp(even, time, each) for name, each in record.columns.items()} | {"time_s": even}
    before = np.searchsorted(time, even, side="right") - 1
    phase = tuple(record.phase[row] for row in before) if record.phase else ()
    note = f"interpolated from {len(time)} to {count} samples, at {rate_hz:g} Hz"
    return replace(record, columns=columns, phase=phase, notes=(*record.notes, note))
