"""The trial in a recording, in the columns of the data files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from needleplan.errors import DataError
from needleplan.recording.align import align
from needleplan.recording.mcap.kinds import FORCE, POSE, STAGE, Packed
from needleplan.recording.mcap.recording import Message, Recording
from needleplan.signals import Array, Record

__all__ = ["columns_of", "is_table", "trial_of"]

_GOOD = "good"


def columns_of(recording: Recording, topic: str) -> dict[str, Any]:
    """Return the fields of a packed topic as columns, and `time_s` since the beginning of the recording."""
    return _columns(recording, recording.messages([topic]))


def trial_of(recording: Recording) -> Record:
    """Return force, stage and tracker of a recording as one trial, at the times of the first of them that is there.

    Force and torque are those along and about the session's `force_axis`; x, y, z those of the tracker, in its own
    frame. Where several topics are of one kind, the first in the alphabet is taken. Samples that are not good are
    missing numbers; times that repeat or decrease are left out. The notes count both. Raises DataError where there is
    none of the three kinds, or they do not overlap.
    """
    found: list[Record] = []
    notes: list[str] = []
    for kind, columns in ((FORCE, _force), (STAGE, _stage), (POSE, _pose)):
        topics = sorted(topic for topic in recording.counts if recording.kinds[topic].name == kind.name)
        topics = [topic for topic in topics if recording.counts[topic] > 1]
        if not topics:
            notes.append(f"no samples of {kind.name}")
            continue
        if len(topics) > 1:
            notes.append(f"of {', '.join(topics)} only the first is in the trial")
        record, remarks = _increasing(columns(recording, columns_of(recording, topics[0])))
        notes += [f"{topics[0]}: {remark}" for remark in remarks]
        found.append(record)
    if not found:
        raise DataError("holds no samples of a force sensor, a stage or a tracker", str(recording.path))
    trial = found[0]
    for other in found[1:]:
        trial = align(trial, other)
    return replace(trial, trial=recording.session.title or recording.path.stem, notes=(*notes, *trial.notes))


def _columns(recording: Recording, messages: Iterable[Message]) -> dict[str, Any]:
    kept = list(messages)
    time = np.array([each.time_ns - recording.start_ns for each in kept], dtype=np.int64)
    columns: dict[str, Any] = {"time_s": time * 1e-9}
    for name in kept[0].values if kept else ():
        columns[name] = np.array([each.values[name] for each in kept])
    return columns


def _force(recording: Recording, columns: dict[str, Any]) -> dict[str, Array]:
    axis = np.array(recording.session.force_axis)
    force = np.stack([columns[f"force_{each}_n"] for each in "xyz"], axis=1) @ axis
    torque = np.stack([columns[f"torque_{each}_n_mm"] for each in "xyz"], axis=1) @ axis
    return _of_good(columns, {"force_n": force, "torque_n_mm": torque})


def _stage(_: Recording, columns: dict[str, Any]) -> dict[str, Array]:
    names = {"depth_mm": "depth_mm", "velocity_mm_s": "velocity_mm_s", "angle_rad": "roll_rad"}
    return _of_good(columns, {name: columns[its] for name, its in names.items()})


def _pose(_: Recording, columns: dict[str, Any]) -> dict[str, Array]:
    return _of_good(columns, {name: columns[name] for name in ("x_mm", "y_mm", "z_mm")})


def _of_good(columns: dict[str, Any], values: dict[str, Array]) -> dict[str, Array]:
    good = columns["health"] == _GOOD
    return {"time_s": columns["time_s"], **{name: np.where(good, each, np.nan) for name, each in values.items()}}


def _increasing(columns: dict[str, Array]) -> tuple[Record, list[str]]:
    time = columns["time_s"]
    later = np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    record = Record({name: values[later] for name, values in columns.items()})
    missing = int(max(np.isnan(values).sum() for values in record.columns.values()))
    remarks = [f"samples that are not good, and are missing numbers here: {missing}"] if missing else []
    repeated = int((~later).sum())
    return record, [*remarks, f"{repeated} samples with the time of another were left out"] if repeated else remarks


def is_table(recording: Recording, topic: str) -> bool:
    """Whether a topic consists of numbers."""
    return isinstance(recording.kinds[topic], Packed)
