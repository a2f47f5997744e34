"""MATLAB files (.mat, as `save -v7` writes) of trials: columns as vectors, in the root or in one struct for each trial.

A struct may have the fields `trial`, `role` and `coordinate_frame`, texts; `phase` is a cell array of texts. needleplan
writes structs `trial_0001`, `trial_0002` ... MATLAB's `-v7.3` is another format, which is refused with the remedy.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from needleplan.artifacts import version
from needleplan.errors import DataError, Mistake
from needleplan.recording.columns import NUMBERS, TEXTS, validate_names
from needleplan.recording.table import DataTable
from needleplan.signals import UNITS, Record

__all__ = ["MAT_BEGINS", "mat_bytes", "parse_mat", "struct_of", "to_mat"]

MAT_BEGINS = b"MATLAB "
"""First bytes of a MATLAB file of version 5 and newer."""

_NEWEST = b"MATLAB 7.3 MAT-file"
_FORMAT = "needleplan.records/1"
# Variables and fields of needleplan's files that are no columns.
_OWN = ("format", "made_by", "channels", "recording", "session")
# Largest length of the name of a variable or field in MATLAB.
_LONGEST_NAME = 63


def parse_mat(content: bytes, source: str) -> list[DataTable]:
    """Return one table for each struct of a MATLAB file, or one table for the vectors in its root.

    Raises DataError if the file is damaged, empty or of version 7.3, has both structs and columns in its root, or has a
    wrong column.
    """
    from scipy.io import loadmat

    if content.startswith(_NEWEST):
        raise DataError("is a MATLAB file of version 7.3: save it with `save(name, '-v7')`", source)
    try:
        found = loadmat(io.BytesIO(content), simplify_cells=True)  # type: ignore[arg-type]
    except Exception as error:  # scipy raises many types of exceptions for damaged files
        raise DataError(f"is damaged, or not a MATLAB file: {error}", source) from error
    variables = {name: value for name, value in found.items() if not name.startswith("__") and name not in _OWN}
    structs = {name: value for name, value in variables.items() if isinstance(value, Mapping)}
    if structs and len(structs) < len(variables) and "time_s" in variables:
        rule = "must not be beside columns: columns are in the root, or in one struct for each trial"
        raise DataError([Mistake(name, "", rule) for name in structs], source)
    trials = structs or {"": variables}
    if not variables:
        raise DataError("is empty: it holds neither columns nor structs", source)
    return [_table(fields, name, source) for name, fields in trials.items()]


def to_mat(records: Sequence[Record]) -> bytes:
    """Return a MATLAB file with the columns, phases, names and roles of the records; the notes are not stored."""
    return mat_bytes({f"trial_{number:04}": struct_of(record) for number, record in enumerate(records, start=1)})


def mat_bytes(variables: Mapping[str, Any]) -> bytes:
    """Return a compressed MATLAB file with the variables; mappings become structs. Names are made valid for MATLAB."""
    from scipy.io import savemat

    image = io.BytesIO()
    named = {"format": _FORMAT, "made_by": f"needleplan {version()}"} | _valid(variables)
    # The stubs of scipy do not know streams.
    savemat(image, named, long_field_names=True, do_compression=True, oned_as="column")  # type: ignore[arg-type]
    return image.getvalue()


def struct_of(record: Record) -> dict[str, Any]:
    """Return the fields of the struct of a record."""
    texts: dict[str, Any] = {"trial": record.trial, "role": str(record.role)}
    if record.frame.known:
        texts["coordinate_frame"] = record.frame.text
    if record.phase:
        texts["phase"] = np.array(record.phase, dtype=object)
    return {**record.columns, **texts}


def _valid(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values with names that MATLAB permits for variables and fields."""
    named = {}
    for name, value in values.items():
        word = re.sub(r"\W", "_", name.strip("/"), flags=re.ASCII)
        word = word if re.match(r"[A-Za-z]", word) else f"x{word}"
        if isinstance(value, np.ndarray) and value.dtype.kind == "U":
            value = value.astype(object)  # texts become a cell array, not rows of letters of one length
        named[word[:_LONGEST_NAME]] = _valid(value) if isinstance(value, Mapping) else value
    return named


def _table(fields: Mapping[str, Any], name: str, source: str) -> DataTable:
    unknown, mistakes = validate_names(field for field in fields if field not in _OWN)
    numbers = {key: np.atleast_1d(np.asarray(fields[key])) for key in NUMBERS if key in fields}
    length = numbers["time_s"].size if "time_s" in numbers else 0
    for key, values in numbers.items():
        if values.dtype.kind not in "fiu":
            mistakes.append(Mistake(key, str(values.dtype), f"must hold numbers in {UNITS[key]}"))
        elif values.ndim != 1 or values.size != length:
            mistakes.append(Mistake(key, f"size {values.shape}", f"must be a vector as long as time_s, {length}"))
    texts: dict[str, tuple[str, ...]] = {}
    for key in TEXTS:
        if key in fields:
            words = np.atleast_1d(np.asarray(fields[key], dtype=object)).ravel().tolist()
            texts[key] = tuple(map(str, words * length if len(words) == 1 else words))
            if len(texts[key]) != length:
                mistakes.append(Mistake(key, f"{len(words)} texts", f"must be one text, or {length}, as time_s"))
    if mistakes:
        raise DataError(
            [Mistake(f"{name}.{mistake.key}".lstrip("."), mistake.value, mistake.rule) for mistake in mistakes], source
        )
    if name and "trial" not in texts:
        texts["trial"] = (name,) * length
    return DataTable(
        {key: values.astype(float) for key, values in numbers.items()},
        texts,
        tuple(f"{name}({row + 1})" if name else f"row {row + 1}" for row in range(length)),
        (f"unknown columns were left out: {', '.join(unknown)}",) if unknown else (),
    )
