"""The order of the insertions of a series by the times of their recordings, and insertions that are given twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Record

__all__ = ["in_order", "require_different"]

# Time (s) between the beginnings of two insertions from which a new set-up between them is likely.
_APART_S = 3600.0


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
    """Raise DataError if two records are of one insertion: equal positions, or the same time of their beginning."""
    seen: dict[object, Record] = {}
    for record in records:
        keys: list[object] = [b"".join(record[name].tobytes() for name in ("x_mm", "y_mm") if name in record.columns)]
        keys += [record.begun_s] * (record.begun_s is not None)
        for key in keys:
            if key in seen:
                rule = f"is the same insertion as {seen[key].trial}: one insertion must not count twice"
                raise DataError(Mistake("trial", record.trial, rule))
            seen[key] = record
