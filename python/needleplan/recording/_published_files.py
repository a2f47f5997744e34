"""Reading of two formats of published needle measurements."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleplan.artifacts import digest
from needleplan.errors import DataError, Mistake
from needleplan.recording.columns import questionable_units
from needleplan.signals import FrameName, Record, RecordFrame

__all__ = ["is_stepwise_insertion", "parse_stepwise_insertion", "read_depth_force", "read_stepwise_insertion"]

_STEPWISE = ("Timestamp sec", "Timestamp nanosec", "Tip x", "Tip y", "Tip z", "Tip sec", "Tip nanosec")
# Position (m) of the needle guide, and the time of its measurement.
_GUIDE = ("Robot x", "Robot z", "Robot sec")
# Largest distance (mm) of a needle guide from the origin of a study.
_FARTHEST_MM = 2000.0


def read_stepwise_insertion(path: str | os.PathLike[str]) -> Record:
    r"""Read a stepwise insertion of the data set maribernardes/mpc_stepwise_trajcontrol (tracked tip, 2 Hz).

    The depth is -`Tip y`, stored as `depth_mm` and `x_mm`; `y_mm` is `Tip x` and `z_mm` is `Tip z`, both relative to
    the first measured position of the needle guide (`Robot x`, `Robot z`); without one, in the frame of the study.
    Times are the measurement times of the tip since the first one. `read_records` reads such a file in the same way.

    Parameters
    ----------
    path : str or path
        The CSV file of the data set.

    Returns
    -------
    Record
        The insertion. Rows without a tip and rows that repeat a measurement are left out and counted in the notes.

    Raises
    ------
    DataError
        The file cannot be read or is not a file of this data set.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import read_stepwise_insertion
    >>> header = "Timestamp sec,Timestamp nanosec,Tip x,Tip y,Tip z,Tip sec,Tip nanosec"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "insertion.csv"
    ...     _ = path.write_text(header + "\n7,0,0.1,-5,0,7,0\n8,0,0.2,-10,0,7,500000000\n")
    ...     record = read_stepwise_insertion(path)
    >>> record["time_s"].tolist(), record["depth_mm"].tolist()
    ([0.0, 0.5], [5.0, 10.0])

    """
    source, content = _content(path)
    return parse_stepwise_insertion(content, source)


def is_stepwise_insertion(content: bytes) -> bool:
    """Return whether the bytes of a file begin with the header of a stepwise insertion."""
    names = {cell.strip() for cell in content.partition(b"\n")[0].decode("utf-8", "replace").split(",")}
    return names.issuperset(_STEPWISE)


def parse_stepwise_insertion(content: bytes, source: str) -> Record:
    """Return the record in the bytes of a stepwise insertion; see `read_stepwise_insertion`."""
    rows = list(csv.reader(io.StringIO(content.decode("utf-8", "replace").replace("\0", ""))))
    header = [cell.strip() for cell in rows[0]] if rows else []
    missing = [
        Mistake(name, "", "is missing: not a file of step-wise insertions") for name in _STEPWISE if name not in header
    ]
    if missing:
        raise DataError(missing, source)
    names = _STEPWISE + _GUIDE * (set(_GUIDE) <= set(header))
    try:
        table = np.array([[float(row[header.index(name)]) for name in names] for row in rows[1:] if row])
    except (ValueError, IndexError) as error:
        raise DataError(f"has a row that does not hold numbers: {error}", source) from None
    if len(table) < 2:
        raise DataError("has fewer than two rows", source)
    _, _, x, y, z, seconds, nanoseconds, *guide = table.T
    measured = seconds > 0
    time = np.where(measured, seconds - seconds.max(), -np.inf) + 1e-9 * nanoseconds
    new = np.concatenate([[True], np.diff(time) > 0]) & measured
    notes = [f"{int((~measured).sum())} rows without a tip were left out"] * bool((~measured).any())
    repeated = int((measured & ~new).sum())
    notes += [f"{repeated} rows that repeat a measurement were left out"] * bool(repeated)
    if new.sum() < 2:
        raise DataError("has fewer than two measurements of the tip", source)
    frame = RecordFrame(provenance="the frame of the study, whose origin its files do not say")
    if guide and (guide[2] > 0).any():
        first = int(np.argmax(guide[2] > 0))
        across, up = 1000 * guide[0][first], 1000 * guide[1][first]
        if max(abs(across), abs(up)) > _FARTHEST_MM:
            rule = "are the position of the needle guide in m: this is too far away; are they in mm?"
            raise DataError(Mistake("Robot x, Robot z", f"{across / 1000:g}, {up / 1000:g}", rule), source)
        x, z = x - across, z - up
        notes.append(f"y_mm and z_mm count from the needle guide at {across:.2f} and {up:.2f} mm")
        frame = RecordFrame(FrameName.GUIDE, "needle guide", "its columns Robot x and Robot z")
    columns = {"time_s": time[new] - time[new][0], "depth_mm": -y[new], "x_mm": -y[new], "y_mm": x[new], "z_mm": z[new]}
    begun_s = float(seconds[new][0] + 1e-9 * nanoseconds[new][0])
    return Record(columns, Path(source).stem, digest=digest(content), notes=tuple(notes), frame=frame, begun_s=begun_s)


def read_depth_force(path: str | os.PathLike[str], speed_mm_s: float) -> Record:
    r"""Read a digitised force-depth curve of an insertion at constant speed.

    Points are sorted by depth, and points at equal depth are averaged, because the depth of a digitised curve may
    decrease from point to point.

    Parameters
    ----------
    path : str or path
        A CSV file without header: depth in m, force in N.
    speed_mm_s : float
        Speed of the insertion, mm/s, which determines the times.

    Returns
    -------
    Record
        The insertion; its notes count the sorted and the averaged points.

    Raises
    ------
    DataError
        The file cannot be read or does not hold two columns of numbers, a column is implausible for its unit, or the
        speed is not positive.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.recording import read_depth_force
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "curve.csv"
    ...     _ = path.write_text("0.0,0.0\n0.01,0.4\n")
    ...     record = read_depth_force(path, speed_mm_s=5.0)
    >>> record["time_s"].tolist(), record["depth_mm"].tolist()
    ([0.0, 2.0], [0.0, 10.0])

    """
    source, content = _content(path)
    if not speed_mm_s > 0:
        raise DataError(Mistake("speed_mm_s", f"{speed_mm_s:g}", "must be above 0"), source)
    try:
        table = np.array([[float(cell) for cell in row] for row in csv.reader(io.StringIO(content.decode())) if row])
    except (ValueError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"must be two columns of numbers: {error}", source) from None
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise DataError("must be two columns of finite numbers", source)
    depth = 1000 * table[:, 0]
    back = int((np.diff(depth) < 0).sum())
    places, group = np.unique(depth, return_inverse=True)
    force = np.bincount(group, table[:, 1]) / np.bincount(group)
    notes = [f"{back} points were sorted by depth"] * bool(back)
    notes += [f"{depth.size - places.size} points at equal depth were averaged"] * bool(depth.size > places.size)
    speed = np.full(places.size, float(speed_mm_s))
    columns = {"time_s": places / speed_mm_s, "depth_mm": places, "velocity_mm_s": speed, "force_n": force}
    frame = RecordFrame(provenance=f"{source} does not say")
    record = Record(columns, Path(source).stem, digest=digest(content), frame=frame)
    mistakes = questionable_units(record)
    if mistakes:
        raise DataError(mistakes, f"{source}, read as depth in m and force in N")
    return replace(record, notes=tuple(notes))


def _content(path: str | os.PathLike[str]) -> tuple[str, bytes]:
    source = os.fspath(path)
    try:
        return source, Path(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", source) from error
