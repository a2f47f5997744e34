"""Export of recordings: CSV, HDF5 and MATLAB files for `needleplan identify`, Parquet, and ROS 2 bags."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from typing import Any

from needleplan.artifacts import digest, write_whole
from needleplan.recording._data_files import PathLike
from needleplan.recording._export_target import NewFolder, optional_library, require_no_recording
from needleplan.recording._recording import Recording
from needleplan.recording.csv_file import to_csv
from needleplan.recording.hdf5_file import to_hdf5
from needleplan.recording.mat_file import mat_bytes, struct_of
from needleplan.recording.rosbag import write_rosbag

__all__ = ["FORMATS", "require_no_recording", "write_csv", "write_hdf5", "write_mat", "write_parquet"]


def write_csv(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write the trial of a recording to a CSV file, and return the notes of the trial.

    Raises DataError if the recording has no trial, OutputError if the file cannot be written or `path` is a recording.
    """
    require_no_recording(path)
    trial = recording.trial()
    write_whole(path, to_csv([trial]).encode())
    return trial.notes


def write_hdf5(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write the trial and all channels of a recording to an HDF5 file, and return the notes of the trial.

    The group `/trial_0001` holds the trial, which `needleplan identify` reads. `/trial_0001/channels/<topic>` holds the
    columns of a topic as recorded; JSON messages are texts in the dataset `json`. Raises DataError if the recording has
    no trial, OutputError if the file cannot be written or `path` is a recording.
    """
    import h5py

    require_no_recording(path)
    trial = recording.trial()
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


def write_mat(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write the trial and all channels of a recording to a MATLAB file, and return the notes of the trial.

    The struct `trial_0001` holds the trial, which `needleplan identify` reads. Its field `channels` has a struct for
    each topic with the columns as recorded; JSON messages are texts in the field `json`. Raises DataError if the
    recording has no trial, OutputError if the file cannot be written or `path` is a recording.
    """
    require_no_recording(path)
    trial = recording.trial()
    channels = {topic: _columns(recording, topic) for topic in recording.counts}
    digests = {"recording": digest(recording.path.read_bytes()), "session": json.dumps(recording.session.to_dict())}
    write_whole(path, mat_bytes({"trial_0001": struct_of(trial) | {"channels": channels} | digests}))
    return trial.notes


def write_parquet(recording: Recording, path: PathLike, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a folder with one Parquet file for each topic, and return the number of rows of each topic as texts.

    If `overwrite`, the folder may exist; only files with the same names are replaced. Raises OutputError if the package
    pyarrow is not installed, or if the folder exists or cannot be written; DataError if a message is damaged.
    """
    arrow = optional_library("pyarrow", path)
    parquet = optional_library("pyarrow.parquet", path)
    remarks = []
    with NewFolder(path, overwrite) as folder:
        for topic in recording.counts:
            table = arrow.table(_columns(recording, topic))
            session = json.dumps(recording.session.to_dict()).encode()
            table = table.replace_schema_metadata({"needleplan.topic": topic.encode(), "needleplan.session": session})
            parquet.write_table(table, folder / f"{topic.strip('/').replace('/', '.')}.parquet")
            remarks.append(f"{topic}: {table.num_rows:,} rows")
    return tuple(remarks)


def _columns(recording: Recording, topic: str) -> dict[str, Any]:
    import numpy as np

    if recording.is_table(topic):
        return recording.columns(topic)
    messages = list(recording.messages([topic]))
    time = np.array([message.time_ns - recording.start_ns for message in messages], dtype=np.int64) * 1e-9
    texts = np.array([json.dumps(message.values) for message in messages], dtype=object)
    return {"time_s": time, "json": texts}


FORMATS: Mapping[str, Callable[..., tuple[str, ...]]] = {
    "hdf5": write_hdf5,
    "csv": write_csv,
    "mat": write_mat,
    "parquet": write_parquet,
    "rosbag": write_rosbag,
}
"""Functions that write a recording, by the name of the format; each returns remarks on the exported data."""
