"""Other people's formats, as records: two public sets of measurements on needles."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleplan.artifacts import digest
from needleplan.errors import DataError, Mistake
from needleplan.recording.files import PathLike
from needleplan.signals import Record

__all__ = ["read_depth_force", "read_stepwise_insertion"]

_STEPWISE = ("Timestamp sec", "Timestamp nanosec", "Tip x", "Tip y", "Tip z", "Tip sec", "Tip nanosec")


def read_stepwise_insertion(path: PathLike) -> Record:
    """Read a file of the step-wise insertions of maribernardes/mpc_stepwise_trajcontrol (tracked tips, 2 Hz).

    Depth is -`Tip y`, which becomes `depth_mm` and `x_mm`; `y_mm` is `Tip x` and `z_mm` is `Tip z`, all in the frame of
    that study. Times are those at which the tip was measured, from the first on. Rows without a tip, and those that
    repeat a measurement, are left out and counted in the notes. Raises DataError for anything else.
    """
    source, content = _content(path)
    rows = list(csv.reader(io.StringIO(content.decode("utf-8", "replace").replace("\0", ""))))
    header = [cell.strip() for cell in rows[0]] if rows else []
    missing = [
        Mistake(name, "", "is missing: not a file of step-wise insertions") for name in _STEPWISE if name not in header
    ]
    if missing:
        raise DataError(missing, source)
    try:
        table = np.array([[float(row[header.index(name)]) for name in _STEPWISE] for row in rows[1:] if row])
    except (ValueError, IndexError) as error:
        raise DataError(f"has a row that is not numbers: {error}", source) from None
    if len(table) < 2:
        raise DataError("has fewer than two rows", source)
    _, _, x, y, z, seconds, nanoseconds = table.T
    measured = seconds > 0
    time = np.where(measured, seconds - seconds.max(), -np.inf) + 1e-9 * nanoseconds
    new = np.concatenate([[True], np.diff(time) > 0]) & measured
    notes = [f"{int((~measured).sum())} rows without a tip were left out"] * bool((~measured).any())
    repeated = int((measured & ~new).sum())
    notes += [f"{repeated} rows that repeat a measurement were left out"] * bool(repeated)
    if new.sum() < 2:
        raise DataError("has fewer than two measurements of the tip", source)
    columns = {"time_s": time[new] - time[new][0], "depth_mm": -y[new], "x_mm": -y[new], "y_mm": x[new], "z_mm": z[new]}
    return Record(columns, Path(source).stem, digest=digest(content), notes=tuple(notes))


def read_depth_force(path: PathLike, speed_mm_s: float) -> Record:
    """Read a digitised curve: two columns without a header, depth in m and force in N, inserted at a constant speed.

    Points are put into the order of their depth, since a digitised curve goes back and forth a little; those at a
    depth that is there already are averaged. Both are counted in the notes. Times follow from the speed. Raises
    DataError.
    """
    source, content = _content(path)
    if not speed_mm_s > 0:
        raise DataError(Mistake("speed_mm_s", f"{speed_mm_s:g}", "must be above 0"), source)
    try:
        table = np.array([[float(cell) for cell in row] for row in csv.reader(io.StringIO(content.decode())) if row])
    except (ValueError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"is not two columns of numbers: {error}", source) from None
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise DataError("is not two columns of finite numbers", source)
    depth = 1000 * table[:, 0]
    back = int((np.diff(depth) < 0).sum())
    places, group = np.unique(depth, return_inverse=True)
    force = np.bincount(group, table[:, 1]) / np.bincount(group)
    notes = [f"{back} points behind the one before them were put in order"] * bool(back)
    notes += [f"{depth.size - places.size} points at the depth of another were averaged"] * bool(
        depth.size > places.size
    )
    speed = np.full(places.size, float(speed_mm_s))
    columns = {"time_s": places / speed_mm_s, "depth_mm": places, "velocity_mm_s": speed, "force_n": force}
    record = Record(columns, Path(source).stem, digest=digest(content))
    return replace(record, notes=tuple(notes))


def _content(path: PathLike) -> tuple[str, bytes]:
    source = os.fspath(path)
    try:
        return source, Path(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", source) from error
