"""Records from what a caller has: records, tables of columns such as a DataFrame, or files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals._record import Record, Role

__all__ = ["records_of"]

# Columns of a table that hold texts, one a row.
_TRIAL, _ROLE, _PHASE = "trial", "role", "phase"


def records_of(data: object, read: Callable[[str | os.PathLike[str]], Iterable[Record]] | None = None) -> list[Record]:
    """Return the trials in what a caller gives.

    Parameters
    ----------
    data : Record, mapping, DataFrame, structured array, path, or iterable of these
        Records; or a table of columns by the names of data files, with a trial for each value of its column `trial`;
        or the path of a data file.
    read : callable, optional
        Reads the trials of a file. Without it, paths are refused.

    Returns
    -------
    list of Record

    Raises
    ------
    DataError
        If it is something else, a column is not known, or the file cannot be read.
    """
    if isinstance(data, Record):
        return [data]
    if isinstance(data, str | os.PathLike):
        if read is None:
            raise DataError("is a file: read it with `needleplan.recording.read_records`", os.fspath(data))
        return list(read(data))
    columns = _columns(data)
    if columns is not None:
        return list(_trials(columns))
    if not isinstance(data, Iterable) or isinstance(data, bytes | np.ndarray):
        rule = "must be a record, a table of columns such as a DataFrame, the path of a data file, or a list of them"
        raise DataError(Mistake("records", f"<{type(data).__name__}>", rule))
    return [record for each in data for record in records_of(each, read)]


def _columns(data: Any) -> dict[str, Any] | None:
    """Return the columns of a table by name, or None if it is no table."""
    if isinstance(data, np.ndarray):
        return {name: data[name] for name in data.dtype.names} if data.dtype.names else None
    if isinstance(data, Mapping):
        return {str(name): np.asarray(values) for name, values in data.items()}
    names = getattr(data, "columns", None)
    return None if names is None else {str(name): np.asarray(data[name]) for name in names}


def _trials(columns: dict[str, Any]) -> Iterable[Record]:
    lengths = {name: np.shape(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise DataError(
            [Mistake(name, f"shape {shape}", "must be as long as the others") for name, shape in lengths.items()]
        )
    texts = {name: np.asarray(columns.pop(name)).astype(str) for name in (_TRIAL, _ROLE, _PHASE) if name in columns}
    names = texts.get(_TRIAL, np.full(next(iter(lengths.values()), (0,)), ""))
    for trial in dict.fromkeys(names.tolist()):
        rows = names == trial
        roles = sorted(set(texts[_ROLE][rows].tolist())) if _ROLE in texts else [Role.TRAIN]
        if len(roles) != 1 or roles[0] not in list(Role):
            rule = f"must be the same in all rows of a trial, and one of {', '.join(Role)}"
            raise DataError(Mistake(_ROLE, ", ".join(roles), rule), trial)
        phase = tuple(texts[_PHASE][rows].tolist()) if _PHASE in texts else ()
        try:
            values = {name: np.asarray(column[rows], float) for name, column in columns.items()}
        except (TypeError, ValueError) as error:
            raise DataError(f"has a column that is no numbers: {error}", trial) from None
        yield Record(values, trial, Role(roles[0]), phase)
