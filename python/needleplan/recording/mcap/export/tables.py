"""HDF5, CSV and Parquet."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from mcap.writer import MCAP0_MAGIC

from needleplan.artifacts import digest, require_writable, write_whole
from needleplan.errors import Mistake, OutputError
from needleplan.recording.csv_file import to_csv
from needleplan.recording.files import PathLike
from needleplan.recording.hdf5_file import to_hdf5
from needleplan.recording.mcap.export.trial import columns_of, is_table, trial_of
from needleplan.recording.mcap.recording import Recording

__all__ = ["new_folder", "optional", "write_csv", "write_hdf5", "write_parquet"]


def write_csv(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write the trial of a recording as CSV, and return remarks. Raises DataError and OutputError."""
    _require_no_recording(path)
    trial = trial_of(recording)
    write_whole(path, to_csv([trial]).encode())
    return trial.notes


def write_hdf5(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write the trial of a recording as HDF5, with all channels, and return remarks. Raises DataError and OutputError.

    `/trial_0001` is what `identify` reads; `/trial_0001/channels/<topic>` holds the columns of a topic as they were
    recorded, at their own times; messages that are not of numbers are JSON texts, in `json`.
    """
    import h5py

    _require_no_recording(path)
    trial = trial_of(recording)
    image = io.BytesIO(to_hdf5([trial]))
    with h5py.File(image, "r+") as file:
        file.attrs["recording"] = digest(recording.path.read_bytes())
        file.attrs["session"] = json.dumps(recording.session.to_dict())
        channels = file["trial_0001"].create_group("channels")
        for topic in recording.counts:
            group = channels.create_group(topic.strip("/"))
            group.attrs["topic"] = topic
            for name, values in _columns(recording, topic).items():
                texts = values.dtype.kind in "UO"
                group.create_dataset(name, data=values.astype(object) if texts else values,
                                     dtype=h5py.string_dtype() if texts else None)  # fmt: skip
    write_whole(path, image.getvalue())
    return trial.notes


def write_parquet(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a folder with a Parquet file for every topic. Raises OutputError where pyarrow is missing, or it fails."""
    arrow = optional("pyarrow", path)
    parquet = optional("pyarrow.parquet", path)
    remarks = []
    with new_folder(path) as folder:
        for topic in recording.counts:
            table = arrow.table(_columns(recording, topic))
            session = json.dumps(recording.session.to_dict()).encode()
            table = table.replace_schema_metadata({"needleplan.topic": topic.encode(), "needleplan.session": session})
            parquet.write_table(table, folder / f"{topic.strip('/').replace('/', '.')}.parquet")
            remarks.append(f"{topic}: {table.num_rows:,} rows")
    return tuple(remarks)


def optional(module: str, path: PathLike) -> Any:
    """Return a module that only exporting needs. Raises OutputError with what to install."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        rule = f"needs {package}: install it with `pip install needleplan[export]`"
        raise OutputError(Mistake("", "", rule), os.fspath(path)) from error


class new_folder:  # noqa: N801  used like a function
    """A folder that takes its name when all is in it, or leaves nothing behind. Raises OutputError."""

    def __init__(self, path: PathLike) -> None:
        self._target = Path(path)
        if self._target.exists():
            raise OutputError("is there already", os.fspath(path))
        require_writable(path)

    def __enter__(self) -> Path:
        try:
            self._made = Path(tempfile.mkdtemp(prefix=f".{self._target.name}.", dir=self._target.resolve().parent))
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", str(self._target)) from error
        return self._made

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if error is None:
            self._made.chmod(0o755)
            self._made.rename(self._target)
            return
        shutil.rmtree(self._made, ignore_errors=True)
        if isinstance(error, OSError):
            raise OutputError(f"cannot be written: {error.strerror or error}", str(self._target)) from error


def _require_no_recording(path: PathLike) -> None:
    """Raise OutputError where a recording would be overwritten: what it holds cannot be had again."""
    require_writable(path)
    with contextlib.suppress(OSError):
        if Path(path).is_file():
            with Path(path).open("rb") as stream:
                if stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                    raise OutputError("is a recording, which is never overwritten", os.fspath(path))


def _columns(recording: Recording, topic: str) -> dict[str, Any]:
    import numpy as np

    if is_table(recording, topic):
        return columns_of(recording, topic)
    messages = list(recording.messages([topic]))
    time = np.array([each.time_ns - recording.start_ns for each in messages], dtype=np.int64) * 1e-9
    texts = np.array([json.dumps(each.values) for each in messages], dtype=object)
    return {"time_s": time, "json": texts}
