"""Trials as somebody would record them, and their files."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray


class Role(StrEnum):
    TRAIN = "train"
    HOLDOUT = "holdout"
    NOISE = "noise"


class FileKind(StrEnum):
    CSV = "csv"
    HDF5 = "h5"


_DIGITS = {"time_s": 4, "depth_mm": 4, "velocity_mm_s": 4, "force_n": 4, "angle_rad": 6}


@dataclass(frozen=True)
class Trial:
    """One trial: columns by the names of docs/reference/data.md, all of one length; phase is text."""

    name: str
    role: Role
    columns: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.columns["time_s"])


@dataclass(frozen=True)
class DataSet:
    """Training, held-out and noise records of one needle in one tissue. Holds nothing of the truth."""

    trials: tuple[Trial, ...]

    def of(self, role: Role) -> tuple[Trial, ...]:
        return tuple(each for each in self.trials if each.role is role)

    def write(self, folder: Path, kind: FileKind = FileKind.CSV) -> tuple[Path, ...]:
        """A file a trial in folder (made if it is missing), named by the trial."""
        folder.mkdir(parents=True, exist_ok=True)
        return tuple(_WRITERS[kind](each, folder) for each in self.trials)


def _write_csv(trial: Trial, folder: Path) -> Path:
    names = [*trial.columns, "trial", "role"]
    cells = [[f"{value}" for value in values] if values.dtype.kind == "U"
             else [f"{value:.{_DIGITS.get(name, 5)}f}" for value in values.tolist()]
             for name, values in trial.columns.items()]  # fmt: skip
    cells += [[trial.name] * len(trial), [trial.role.value] * len(trial)]
    lines = [",".join(names), *(",".join(row) for row in zip(*cells, strict=True)), ""]
    path = folder / f"{trial.name}.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def _write_hdf5(trial: Trial, folder: Path) -> Path:
    path = folder / f"{trial.name}.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group(trial.name)
        group.attrs["trial"], group.attrs["role"] = trial.name, trial.role.value
        for name, values in trial.columns.items():
            group[name] = values.astype(h5py.string_dtype()) if values.dtype.kind == "U" else np.asarray(values)
    return path


_WRITERS = {FileKind.CSV: _write_csv, FileKind.HDF5: _write_hdf5}
