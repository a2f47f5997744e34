"""What was measured in one trial."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals.array import Array
from needleplan.signals.motion import Motion

__all__ = ["UNITS", "Record", "Role"]

UNITS = {
    "time_s": "s",
    "depth_mm": "mm",
    "velocity_mm_s": "mm/s",
    "force_n": "N",
    "torque_n_mm": "N mm",
    "angle_rad": "rad",
    "x_mm": "mm",
    "y_mm": "mm",
    "z_mm": "mm",
}
"""Unit of every column of numbers; the names are those of the data files."""


class Role(StrEnum):
    """What a trial is for."""

    TRAIN = "train"
    """Parameters are identified from it."""

    HOLDOUT = "holdout"
    """It only judges what was identified."""

    NOISE = "noise"
    """The sensors with nothing happening."""


@dataclass(frozen=True)
class Record:
    """One trial: columns of one length, named and in the units of `UNITS`; `time_s` is always there.

    `phase` holds the name of the phase of every sample, or is empty. `digest` names the file that it came from, and
    is empty for synthetic data.
    """

    columns: dict[str, Array]
    trial: str = ""
    role: Role = Role.TRAIN
    phase: tuple[str, ...] = ()
    digest: str = ""
    notes: tuple[str, ...] = field(default=())
    """What reading it had to say: rows left out, suspicious units."""

    def __post_init__(self) -> None:
        if "time_s" not in self.columns:
            raise DataError(Mistake("time_s", "", "is missing"))
        columns = {name: np.asarray(values, float) for name, values in self.columns.items()}
        unknown = [Mistake(name, "", f"must be one of {', '.join(UNITS)}") for name in columns if name not in UNITS]
        shape = columns["time_s"].shape
        unknown += [
            Mistake(name, f"shape {values.shape}", f"must be a row as long as time_s, {shape}")
            for name, values in columns.items()
            if values.shape != shape or values.ndim != 1
        ]
        if unknown:
            raise DataError(unknown, self.trial)
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return int(self.columns["time_s"].size)

    def __getitem__(self, name: str) -> Array:
        """Return a column, shape (samples,). Raises DataError where the trial does not have it."""
        if name not in self.columns:
            raise DataError(Mistake(name, "", "is missing, and is needed here"), self.trial)
        return self.columns[name]

    def motion(self) -> Motion:
        """Return what drove the trial: `depth_mm`, and where they are there `velocity_mm_s` and `angle_rad`."""
        return Motion.sampled(
            self["time_s"], self["depth_mm"], self.columns.get("velocity_mm_s"), self.columns.get("angle_rad")
        )

    def with_column(self, name: str, values: Array) -> Record:
        """Return the record with a column added or replaced."""
        return replace(self, columns={**self.columns, name: values})

    def select(self, rows: Array | slice) -> Record:
        """Return the record with only some rows: a slice, a mask or indices."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        phase = tuple(np.asarray(self.phase, object)[rows]) if self.phase else ()
        return replace(self, columns=columns, phase=phase)
