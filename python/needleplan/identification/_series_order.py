"""The order of the insertions of a series by the times of their recordings, and insertions that are given twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Record

__all__ = ["in_order", "require_different"]

# Time (s) between the beginnings of two insertions from which a new set-up between them is likely.
_APART_S = 3600.0
# Columns of a position, and share of equal positions from which on two records are of one insertion.
_PLACES, _COMMON = ("x_mm", "y_mm", "z_mm"), 0.5


def in_order(records: Sequence[Record]) -> tuple[list[Record], list[str]]:
    """Return the insertions of a series in the order of their times, if all are known, and remarks."""
    known = [record.begun_s for record in records if record.begun_s is not None]
    if not len(known) == len(records) > 1:
        return list(records), []
    order = np.argsort(known, kind="stable")
    sorted_records = [records[number] for number in order]
    remarks = []
    if (np.diff(order) < 0).any():
        names = ", ".join(record.trial for record in sorted_records)
        remarks.append(f"the insertions were put in the order of their times: {names}")
    for number in np.flatnonzero(np.diff(np.array(known)[order]) > _APART_S):
        before, after = sorted_records[number : number + 2]
        hours = (float(after.begun_s or 0) - float(before.begun_s or 0)) / 3600
        remarks.append(
            f"{after.trial} began {hours:.1f} hours after {before.trial}: if needle, guide or tissue were set up again "
            "between them, they are two series: give the other one with --other-series (other_series)"
        )
    return sorted_records, remarks


def require_different(records: Sequence[Record]) -> None:
    """Raise DataError if two records are of one insertion.

    Two records are of one insertion if they begin at the same time, or if most samples of the shorter record are in the
    other record too.
    """
    points = [
        set(zip(*(record[name] for name in _PLACES if name in record.columns), strict=True)) for record in records
    ]
    for number, record in enumerate(records):
        for before in range(number):
            other = records[before]
            fewest = min(len(points[number]), len(points[before]))
            common = len(points[number] & points[before]) > _COMMON * fewest > 0
            if common or (record.begun_s is not None and record.begun_s == other.begun_s):
                rule = f"is the same insertion as {other.trial}: one insertion must not count twice"
                raise DataError(Mistake("trial", record.trial, rule))
