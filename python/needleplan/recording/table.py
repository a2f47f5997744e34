"""The rows of a data file, their validation, and their division into one record for each trial."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals import Array, Record, RecordFrame, Role, fault_notes

__all__ = ["DataTable", "disordered", "records_of"]


@dataclass(frozen=True)
class DataTable(ShortRepr):
    """Rows of a data file: columns of numbers and columns of texts, all of the same length; missing numbers are NaN.

    `places[i]` names the position of row i in the file, for messages, such as "line 7". `frame` is the frame of depths
    and positions, unless a column `coordinate_frame` gives it.
    """

    numbers: dict[str, Array]
    texts: dict[str, tuple[str, ...]]
    places: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())
    frame: RecordFrame = RecordFrame()

    def __len__(self) -> int:
        return len(self.places)

    def rows(self, index: np.ndarray[tuple[int], np.dtype[np.intp]]) -> DataTable:
        """Return a table with the rows `index`."""
        return replace(
            self,
            numbers={name: values[index] for name, values in self.numbers.items()},
            texts={name: tuple(values[row] for row in index) for name, values in self.texts.items()},
            places=tuple(self.places[row] for row in index),
        )


_DRIVERS = ("depth_mm", "velocity_mm_s", "angle_rad")
_GAP = 5.0  # number of median intervals above which an interval is noted as a gap
_MOST_MISSING = 0.05  # share of rows with a missing number in a motion column above which the trial is refused
_DISORDER = 0.1  # share of decreasing times above which the rows are not in order: no clock is reset so often
_FEW = 10  # number of samples below which the trial is noted as short


def records_of(table: DataTable, name: str, file_digest: str, source: str) -> list[Record]:
    """Return the trials of a table, ordered by their first row; without a column `trial`, the only trial is `name`.

    The notes of a record list the rows that were left out and unusual properties. Raises DataError with the mistakes of
    all trials.
    """
    trials = table.texts.get("trial", (name,) * len(table))
    records = []
    mistakes: list[Mistake] = []
    for trial in dict.fromkeys(trials):
        rows = table.rows(np.flatnonzero(np.array([each == trial for each in trials])))
        role, wrong = _role(rows)
        frame, unclear = _frame(rows, source)
        wrong += unclear
        where = f"trial {trial}, " if len(set(trials)) > 1 else ""
        wrong += _times(rows)
        kept, notes, missing = _whole_rows(rows)
        mistakes += [Mistake(f"{where}{each.key}", each.value, each.rule) for each in [*wrong, *missing]]
        if mistakes:
            continue
        notes = [*table.notes, *notes, *_unusual(kept)]
        phase = kept.texts.get("phase", ())
        record = Record(kept.numbers, trial or name, role, phase, file_digest, frame=frame)
        records.append(replace(record, notes=(*notes, *fault_notes(record))))
    if mistakes:
        raise DataError(mistakes, source)
    return records


def _role(rows: DataTable) -> tuple[Role, list[Mistake]]:
    found = set(rows.texts.get("role", ("",))) or {""}
    if len(found) > 1:
        return Role.TRAIN, [Mistake("role", ", ".join(sorted(found)), "must be the same in a whole trial")]
    (only,) = found
    if only not in ("", *Role):
        return Role.TRAIN, [Mistake("role", only, f"must be one of {', '.join(Role)}")]
    return Role(only) if only else Role.TRAIN, []


def _frame(rows: DataTable, source: str) -> tuple[RecordFrame, list[Mistake]]:
    """Return the frame that the rows name, else that of the table, whose provenance is then the file."""
    found = set(rows.texts.get("coordinate_frame", ())) - {""}
    if len(found) > 1:
        return rows.frame, [Mistake("coordinate_frame", ", ".join(sorted(found)), "must be the same in a whole trial")]
    if not found:
        return rows.frame if rows.frame.provenance else replace(rows.frame, provenance=f"{source} does not say"), []
    try:
        return RecordFrame.parse(next(iter(found)), source), []
    except DataError as error:
        return rows.frame, list(error.mistakes)


def _times(rows: DataTable) -> list[Mistake]:
    time = rows.numbers["time_s"]
    if len(rows) < 2:
        return [Mistake("time_s", f"{len(rows)} samples", "too short: a trial has at least 2 samples")]
    lost = np.flatnonzero(~np.isfinite(time))
    if lost.size:
        return [Mistake(f"time_s ({rows.places[lost[0]]})", str(time[lost[0]]), f"must be a number{_more(lost.size)}")]
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if back.size:
        kinds = Counter("repeated" if step == 0 else "decreasing" for step in steps[back])
        counts = " and ".join(f"{number} {kind}" for kind, number in kinds.items())
        first = back[0] + 1
        likely = "The rows are not in order of time: sort them" if disordered(time) else _likely(kinds)
        rule = f"must be greater than the time before it, {time[first - 1]:.10g}; {counts} in the trial. {likely}"
        return [Mistake(f"time_s ({rows.places[first]})", f"{time[first]:.10g}", rule)]
    return []


def disordered(time: Array) -> bool:
    """Return whether the rows are not in order of time, as opposed to a clock that was reset or stood still."""
    return bool(np.mean(np.diff(time) < 0) > _DISORDER)


def _likely(kinds: Counter[str]) -> str:
    """Return the likely cause of times that do not increase, and what to do."""
    if kinds["decreasing"] and not kinds["repeated"]:
        return (
            "If the clock was reset, name the parts in a column trial; if the rows are not in order, sort them by time"
        )
    if kinds["decreasing"]:
        return "Sort the rows by time and keep one of the rows with equal times"
    if kinds["repeated"] > 1:
        return "If the clock is coarser than the sampling, compute times from the sampling rate; else delete the copies"
    return "Delete the copy"


def _whole_rows(rows: DataTable) -> tuple[DataTable, list[str], list[Mistake]]:
    """Return the rows with complete motion columns, notes on the rest, and mistakes.

    Rows with missing measurements are kept. A column without any number is removed.
    """
    notes: list[str] = []
    mistakes: list[Mistake] = []
    kept = np.ones(len(rows), bool)
    empty: list[str] = []
    for name, values in rows.numbers.items():
        missing = ~np.isfinite(values)
        count = int(missing.sum())
        if not count or name == "time_s":
            continue
        if count == len(rows):
            empty.append(name)
            notes.append(f"{name} has no number in this trial, and was left out")
        elif name not in _DRIVERS:
            notes.append(f"{name} is missing in {count} of {len(rows)} rows, which are ignored by a fit")
        elif count > _MOST_MISSING * len(rows):
            first = rows.places[int(np.flatnonzero(missing)[0])]
            rule = f"is missing in {count} of {len(rows)} rows, first {first}: a motion must be nearly complete"
            mistakes.append(Mistake(name, "", rule))
        else:
            kept &= ~missing
            notes.append(f"{count} of {len(rows)} rows without {name} were left out")
    numbers = {name: values for name, values in rows.numbers.items() if name not in empty}
    return replace(rows, numbers=numbers).rows(np.flatnonzero(kept)), notes, mistakes


def _unusual(rows: DataTable) -> list[str]:
    """Return notes on properties that are unusual but permitted: gaps in time, few samples, constant columns."""
    time = rows.numbers["time_s"]
    steps = np.diff(time)
    median = float(np.median(steps))
    gaps = np.flatnonzero(steps > _GAP * median)
    notes = []
    if gaps.size:
        widest = int(gaps[np.argmax(steps[gaps])])
        notes.append(
            f"{gaps.size} gap{'s' * (gaps.size > 1)} in time_s; the longest, after {time[widest]:.6g} s "
            f"({rows.places[widest]}), is {steps[widest]:.3g} s, {steps[widest] / median:.3g} intervals"
        )
    if len(rows) < _FEW:
        notes.append(f"only {len(rows)} samples: too few to identify a model reliably")
    for name, values in rows.numbers.items():
        good = values[np.isfinite(values)]
        if name not in ("time_s", "duty_cycle") and good.size > 1 and not np.ptp(good):
            notes.append(f"{name} is constant, {good[0]:g}: its cause cannot be identified from this trial")
    return notes


def _more(count: int) -> str:
    return f"; {count} of them are not" if count > 1 else ""
