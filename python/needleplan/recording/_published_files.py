"""Step-wise insertions of the data set maribernardes/mpc_stepwise_trajcontrol: tip tracked at 2 Hz."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from needleplan.artifacts import digest
from needleplan.errors import DataError, Mistake
from needleplan.signals import FrameName, Record, RecordFrame

__all__ = ["is_stepwise_insertion", "parse_stepwise_insertion"]

_STEPWISE = ("Timestamp sec", "Timestamp nanosec", "Tip x", "Tip y", "Tip z", "Tip sec", "Tip nanosec")
# Position (m) of the needle guide, and the time of its measurement.
_GUIDE = ("Robot x", "Robot z", "Robot sec")
# Largest distance (mm) of a needle guide from the origin of a study.
_FARTHEST_MM = 2000.0


def is_stepwise_insertion(content: bytes) -> bool:
    """Return whether the bytes of a file begin with the header of a stepwise insertion."""
    names = {cell.strip() for cell in content.partition(b"\n")[0].decode("utf-8", "replace").split(",")}
    return names.issuperset(_STEPWISE)


def parse_stepwise_insertion(content: bytes, source: str) -> Record:
    """Return the record in the bytes of a stepwise insertion.

    The depth is -`Tip y`, stored as `depth_mm` and `x_mm`; `y_mm` is `Tip x` and `z_mm` is `Tip z`, both relative to
    the first measured position of the needle guide (`Robot x`, `Robot z`); without one, in the frame of the study.
    Times are the measurement times of the tip since the first one. Rows without a tip and rows that repeat a
    measurement are left out and counted in the notes.
    """
    rows = list(csv.reader(io.StringIO(content.decode("utf-8", "replace").replace("\0", ""))))
    header = [cell.strip() for cell in rows[0]]
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
