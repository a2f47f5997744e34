"""HDF5 files of trials: one dataset for each column, in the root of the file or in one group for each trial.

If the root contains several trials, the root needs the column `trial`. A group may have the attributes `trial` and
`role`. Texts are UTF-8 strings. needleplan writes groups; MATLAB reads a column with
`h5read(file, '/trial_0001/force_n')`.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from needleplan.artifacts import version
from needleplan.errors import DataError, Mistake
from needleplan.recording.columns import NUMBERS, TEXTS, validate_names
from needleplan.recording.table import Table
from needleplan.signals import UNITS, Record

__all__ = ["FORMAT", "parse_hdf5", "to_hdf5"]

FORMAT = "needleplan.records/1"
_MOST_NUMBERS = 200_000_000  # largest accepted length of a dataset, in entries


def parse_hdf5(content: bytes, source: str) -> list[Table]:
    """Return one table for each group of an HDF5 file, or one table for the datasets in its root.

    Raises DataError if the file is damaged or empty, has both groups and datasets in its root, or has a wrong column.
    """
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            members = {name: file[name] for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)}
            groups = {name: each for name, each in members.items() if isinstance(each, h5py.Group)}
            if any(isinstance(each, h5py.Dataset) for each in members.values()):
                if groups:
                    rule = "must not be beside datasets: columns are in the root, or in one group for each trial"
                    raise DataError([Mistake(name, "", rule) for name in groups], source)
                return [_table(file, "", source)]
            if not groups:
                raise DataError("is empty: it holds neither columns nor groups", source)
            return [_table(group, name, source) for name, group in groups.items()]
    except DataError:
        raise
    except Exception as error:  # h5py raises many types of exceptions for damaged files
        raise DataError(f"is damaged, or not a file of records: {error}", source) from error


def to_hdf5(records: Sequence[Record]) -> bytes:
    """Return an HDF5 file with the columns, phases, names and roles of the records; the notes are not stored."""
    import h5py

    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs.update({"format": FORMAT, "made_by": f"needleplan {version()}"})
        for number, record in enumerate(records, start=1):
            group = file.create_group(f"trial_{number:04}")
            group.attrs.update({"trial": record.trial, "role": str(record.role)})
            for name, values in record.columns.items():
                group.create_dataset(name, data=values)
                group[name].attrs["units"] = UNITS[name]
            if record.phase:
                group.create_dataset("phase", data=list(record.phase), dtype=h5py.string_dtype())
    return image.getvalue()


def _table(group: Any, name: str, source: str) -> Table:
    import h5py

    datasets = {
        key: group[key]
        for key in group
        if isinstance(group.get(key, getlink=True), h5py.HardLink) and isinstance(group[key], h5py.Dataset)
    }
    unknown, mistakes = validate_names(datasets)
    if not mistakes:
        mistakes = _shapes({key: each for key, each in datasets.items() if key not in unknown})
    if mistakes:
        raise DataError([Mistake(f"{name}/{each.key}".lstrip("/"), each.value, each.rule) for each in mistakes], source)
    length = datasets["time_s"].shape[0]
    texts = {key: _texts(datasets[key]) for key in TEXTS if key in datasets}
    for key in ("trial", "role"):
        if key in group.attrs and key not in texts:
            texts[key] = (_text(group.attrs[key]),) * length
    if name and "trial" not in texts:
        texts["trial"] = (name,) * length
    return Table(
        {key: datasets[key][()].astype(float) for key in NUMBERS if key in datasets},
        texts,
        tuple(f"{name}[{row}]" if name else f"row {row}" for row in range(length)),
        (f"unknown columns were left out: {', '.join(unknown)}",) if unknown else (),
    )


def _shapes(datasets: dict[str, Any]) -> list[Mistake]:
    """Return a mistake for each dataset with the wrong shape, length or type."""
    mistakes = []
    shape = datasets["time_s"].shape
    for key, each in datasets.items():
        if each.is_virtual or each.external:
            mistakes.append(Mistake(key, "", "must be stored in the file itself"))
        elif each.shape is None or len(each.shape) != 1 or each.shape != shape:
            mistakes.append(Mistake(key, f"shape {each.shape}", f"must have the shape of time_s, {shape}"))
        elif each.size > _MOST_NUMBERS:
            mistakes.append(Mistake(key, f"{each.size:,}", f"must have at most {_MOST_NUMBERS:,} entries"))
        elif key in TEXTS and each.dtype.kind not in "OSiu":
            mistakes.append(Mistake(key, str(each.dtype), "must hold strings"))
        elif key in NUMBERS and each.dtype.kind not in "fiu":
            mistakes.append(Mistake(key, str(each.dtype), f"must hold numbers in {UNITS[key]}"))
    return mistakes


def _texts(dataset: Any) -> tuple[str, ...]:
    return tuple(_text(value) for value in dataset[()].tolist())


def _text(value: object) -> str:
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)
