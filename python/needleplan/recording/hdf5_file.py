"""HDF5 files of trials: one dataset for each column, in the root of the file or in one group for each trial.

If the root contains several trials, the root needs the column `trial`. A group may have the attributes `trial`,
`role` and `coordinate_frame`. Texts are UTF-8 strings. needleplan writes groups; MATLAB reads a column with
`h5read(file, '/trial_0001/force_n')`.

A child process (`needleplan.artifacts.hdf5_guard`) reads the file, because one damaged byte may make libhdf5 loop for
ever or crash.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from needleplan.artifacts import hdf5_guard, version
from needleplan.errors import DataError, Mistake
from needleplan.recording.columns import NUMBERS, TEXTS, validate_names
from needleplan.recording.table import DataTable
from needleplan.signals import UNITS, Record

__all__ = ["FORMAT", "parse_hdf5", "to_hdf5"]

FORMAT = "needleplan.records/1"
_MOST_NUMBERS = 200_000_000  # largest accepted length of a dataset, in entries


def parse_hdf5(content: bytes, source: str) -> list[DataTable]:
    """Return one table for each group of an HDF5 file, or one table for the datasets in its root.

    Raises DataError if the file is damaged or empty, takes too much time or memory, has both groups and datasets in its
    root, or has a wrong column.
    """
    _require_whole(content, source)
    record, floats = _read(content, source)
    if record["columns"] and record["groups"]:
        rule = "must not be beside datasets: columns are in the root, or in one group for each trial"
        raise DataError([Mistake(name, "", rule) for name in record["groups"]], source)
    if not record["tables"]:
        raise DataError("is empty: it holds neither columns nor groups", source)
    return [_table(group, floats, name, source) for name, group in record["tables"].items()]


def _require_whole(content: bytes, source: str) -> None:
    """Raise DataError if the superblock does not describe a file of this length."""
    kind = content[8] if len(content) > 8 else 255
    at = {0: 40, 1: 44, 2: 28, 3: 28}.get(kind, -1)  # offset of the end-of-file address
    if at < 0 or len(content) < at + 8 or content[13 if kind < 2 else 9] != 8:
        raise DataError("is damaged, or not a file of records: its first bytes are not a superblock of HDF5", source)
    expected = struct.unpack_from("<Q", content, at)[0]
    if len(content) < expected:
        raise DataError(f"is damaged: it is truncated to {len(content):,} of {expected:,} bytes", source)


def _read(content: bytes, source: str) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """Return the record and the numbers that the child process reads. Raises DataError if it cannot read the file."""
    said = hdf5_guard.in_child([str(_MOST_NUMBERS), ",".join(NUMBERS), ",".join(TEXTS)], content, len(content), source)
    length = int.from_bytes(said[:8], "little")
    record: dict[str, Any] = json.loads(said[8 : 8 + length])
    if "error" in record:
        raise DataError(f"is damaged, or not a file of records: {record['error']}", source)
    return record, np.frombuffer(said, dtype="<f8", offset=8 + length)


def to_hdf5(records: Sequence[Record]) -> bytes:
    """Return an HDF5 file with the columns, phases, names and roles of the records; the notes are not stored."""
    import h5py

    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs.update({"format": FORMAT, "made_by": f"needleplan {version()}"})
        for number, record in enumerate(records, start=1):
            group = file.create_group(f"trial_{number:04}")
            group.attrs.update({"trial": record.trial, "role": str(record.role)})
            if record.frame.known:
                group.attrs["coordinate_frame"] = record.frame.text
            for name, values in record.columns.items():
                group.create_dataset(name, data=values)
                group[name].attrs["units"] = UNITS[name]
            if record.phase:
                group.create_dataset("phase", data=list(record.phase), dtype=h5py.string_dtype())
    return image.getvalue()


def _table(group: dict[str, Any], floats: np.ndarray[Any, Any], name: str, source: str) -> DataTable:
    columns = {each["name"]: each for each in group["columns"]}
    unknown, mistakes = validate_names(columns)
    if not mistakes:
        mistakes = _shapes({key: each for key, each in columns.items() if key not in unknown})
    if mistakes:
        raise DataError(
            [Mistake(f"{name}/{mistake.key}".lstrip("/"), mistake.value, mistake.rule) for mistake in mistakes], source
        )
    length = columns["time_s"]["length"]
    texts = {key: tuple(columns[key]["values"]) for key in TEXTS if key in columns}
    texts |= {key: (value,) * length for key, value in group["attributes"].items() if key not in texts}
    if name and "trial" not in texts:
        texts["trial"] = (name,) * length
    return DataTable(
        {key: floats[columns[key]["values"] :][:length].astype(float) for key in NUMBERS if key in columns},
        texts,
        tuple(f"{name}[{row}]" if name else f"row {row}" for row in range(length)),
        (f"unknown columns were left out: {', '.join(unknown)}",) if unknown else (),
    )


def _shapes(columns: dict[str, Any]) -> list[Mistake]:
    """Return a mistake for each column with the wrong shape, length or type."""
    mistakes = []
    time = columns["time_s"]
    for key, each in columns.items():
        if not each["stored"]:
            mistakes.append(Mistake(key, "", "must be stored in the file itself"))
        elif each["dimensions"] != 1 or each["length"] != time["length"]:
            mistakes.append(Mistake(key, f"shape {each['shape']}", f"must have the shape of time_s, {time['shape']}"))
        elif each["length"] > _MOST_NUMBERS:
            mistakes.append(Mistake(key, f"{each['length']:,}", f"must have at most {_MOST_NUMBERS:,} entries"))
        elif key in TEXTS and each["kind"] not in "OSiu":
            mistakes.append(Mistake(key, each["type"], "must hold strings"))
        elif key in NUMBERS and each["kind"] not in "fiu":
            mistakes.append(Mistake(key, each["type"], f"must hold numbers in {UNITS[key]}"))
    return mistakes
