"""Export of recordings to other formats: CSV and HDF5 for `needleplan identify`, Parquet, and ROS 2 bags."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import MCAP0_MAGIC

from needleplan.artifacts import digest, require_writable, write_whole
from needleplan.errors import Mistake, OutputError
from needleplan.recording._data_files import PathLike
from needleplan.recording._recording import RecordedMessage, Recording
from needleplan.recording._sample_kinds import FORCE, POSE, STAGE
from needleplan.recording.csv_file import to_csv
from needleplan.recording.hdf5_file import to_hdf5

__all__ = ["FORMATS", "require_no_recording", "write_csv", "write_hdf5", "write_parquet", "write_rosbag"]


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


def write_parquet(recording: Recording, path: PathLike, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a folder with one Parquet file for each topic, and return the number of rows of each topic as texts.

    If `overwrite`, the folder may exist; only files with the same names are replaced. Raises OutputError if the package
    pyarrow is not installed, or if the folder exists or cannot be written; DataError if a message is damaged.
    """
    arrow = _optional("pyarrow", path)
    parquet = _optional("pyarrow.parquet", path)
    remarks = []
    with _NewFolder(path, overwrite) as folder:
        for topic in recording.counts:
            table = arrow.table(_columns(recording, topic))
            session = json.dumps(recording.session.to_dict()).encode()
            table = table.replace_schema_metadata({"needleplan.topic": topic.encode(), "needleplan.session": session})
            parquet.write_table(table, folder / f"{topic.strip('/').replace('/', '.')}.parquet")
            remarks.append(f"{topic}: {table.num_rows:,} rows")
    return tuple(remarks)


def _optional(module: str, path: PathLike) -> Any:
    """Import an optional dependency and return it. If it is missing, raises OutputError with the install command."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        rule = f"needs {package}: install it with `pip install needleplan[export]`"
        raise OutputError(Mistake("", "", rule), os.fspath(path)) from error


class _NewFolder:
    """Context manager that gives a temporary folder, which gets its final name at the end of the block.

    If the folder exists and may be overwritten, the new files are moved into it. After an exception the temporary
    folder is removed. Raises OutputError if the folder exists and may not be overwritten, or cannot be written.
    """

    def __init__(self, path: PathLike, overwrite: bool) -> None:
        self._target = Path(path)
        if self._target.is_dir() and overwrite:
            return
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
            if self._target.is_dir():
                for file in self._made.iterdir():
                    file.replace(self._target / file.name)
                self._made.rmdir()
            else:
                self._made.rename(self._target)
            return
        shutil.rmtree(self._made, ignore_errors=True)
        if isinstance(error, OSError):
            raise OutputError(f"cannot be written: {error.strerror or error}", str(self._target)) from error


def require_no_recording(path: PathLike) -> None:
    """Raise OutputError if `path` cannot be written, or is a recording, because its data cannot be measured again."""
    require_writable(path)
    with contextlib.suppress(OSError):
        if Path(path).is_file():
            with Path(path).open("rb") as stream:
                if stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                    raise OutputError("is a recording, which is never overwritten", os.fspath(path))


def _columns(recording: Recording, topic: str) -> dict[str, Any]:
    import numpy as np

    if recording.is_table(topic):
        return recording.columns(topic)
    messages = list(recording.messages([topic]))
    time = np.array([each.time_ns - recording.start_ns for each in messages], dtype=np.int64) * 1e-9
    texts = np.array([json.dumps(each.values) for each in messages], dtype=object)
    return {"time_s": time, "json": texts}


_MM = 1e-3


def write_rosbag(recording: Recording, path: PathLike, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a ROS 2 bag (MCAP storage) with standard messages in SI units, and return one remark for each topic.

    Forces become geometry_msgs/WrenchStamped (N, N m), poses geometry_msgs/PoseStamped (m), samples of the stage
    sensor_msgs/JointState (insertion in m, roll in rad), and other messages std_msgs/String with JSON. Tracker samples
    without a pose are left out and counted in the remarks. If `overwrite`, the folder may exist; only files with the
    same names are replaced. Raises OutputError if the package rosbags is not installed, or if the folder exists or
    cannot be written; DataError if a message is damaged.
    """
    rosbag2 = _optional("rosbags.rosbag2", path)
    typesys = _optional("rosbags.typesys", path)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    remarks = []
    with _NewFolder(path, overwrite) as folder:
        bag_folder = folder / "bag"
        plugin = rosbag2.StoragePlugin.MCAP
        with rosbag2.Writer(bag_folder, version=9, storage_plugin=plugin) as bag:
            for topic in recording.counts:
                its_type, convert = _CONVERSIONS.get(recording.kinds[topic].name, ("std_msgs/msg/String", _text))
                connection = bag.add_connection(topic, its_type, typestore=store)
                left_out = 0
                for each in recording.messages([topic]):
                    if its_type.endswith("PoseStamped") and each.values["health"] == "missing":
                        left_out += 1
                        continue
                    wall_ns = recording.session.wall_of(each.time_ns)
                    message = convert(store, each, wall_ns)
                    bag.write(connection, wall_ns, store.serialize_cdr(message, its_type))
                remarks.append(f"{topic}: {its_type}" + (f"; {left_out} without a pose left out" if left_out else ""))
        _lift(bag_folder, folder, Path(path).name)
    return tuple(remarks)


def _lift(bag: Path, folder: Path, name: str) -> None:
    """Move the files of `bag` up into `folder`, remove `bag`, and name the files after `name`, as ROS does."""
    metadata = (bag / "metadata.yaml").read_text(encoding="utf-8").replace("bag.mcap", f"{name}.mcap")
    (folder / "metadata.yaml").write_text(metadata, encoding="utf-8")
    (bag / "bag.mcap").rename(folder / f"{name}.mcap")
    (bag / "metadata.yaml").unlink()
    bag.rmdir()


def _header(store: Any, wall_ns: int, frame: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=wall_ns // 10**9, nanosec=wall_ns % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _vector(store: Any, message: RecordedMessage, names: str, factor: float, kind: str = "Vector3") -> Any:
    x, y, z = (factor * message.values[name] for name in names.split())
    return store.types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)


def _wrench(store: Any, message: RecordedMessage, wall_ns: int) -> Any:
    force = _vector(store, message, "force_x_n force_y_n force_z_n", 1.0)
    torque = _vector(store, message, "torque_x_n_mm torque_y_n_mm torque_z_n_mm", _MM)
    wrench = store.types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
    header = _header(store, wall_ns, message.topic.strip("/"))
    return store.types["geometry_msgs/msg/WrenchStamped"](header=header, wrench=wrench)


def _pose(store: Any, message: RecordedMessage, wall_ns: int) -> Any:
    w, x, y, z = (message.values[f"q{each}"] for each in "wxyz")
    orientation = store.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    position = _vector(store, message, "x_mm y_mm z_mm", _MM, "Point")
    pose = store.types["geometry_msgs/msg/Pose"](position=position, orientation=orientation)
    header = _header(store, wall_ns, message.topic.strip("/"))
    return store.types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)


def _joints(store: Any, message: RecordedMessage, wall_ns: int) -> Any:
    values = message.values
    return store.types["sensor_msgs/msg/JointState"](
        header=_header(store, wall_ns, message.topic.strip("/")),
        name=["insertion", "roll"],
        position=np.array([_MM * values["depth_mm"], values["roll_rad"]]),
        velocity=np.array([_MM * values["velocity_mm_s"], np.nan]),
        effort=np.array([]),
    )


def _text(store: Any, message: RecordedMessage, _: int) -> Any:
    return store.types["std_msgs/msg/String"](data=json.dumps(message.values))


_CONVERSIONS: dict[str, tuple[str, Callable[[Any, RecordedMessage, int], Any]]] = {
    FORCE.name: ("geometry_msgs/msg/WrenchStamped", _wrench),
    POSE.name: ("geometry_msgs/msg/PoseStamped", _pose),
    STAGE.name: ("sensor_msgs/msg/JointState", _joints),
}


FORMATS: Mapping[str, Callable[..., tuple[str, ...]]] = {
    "hdf5": write_hdf5,
    "csv": write_csv,
    "parquet": write_parquet,
    "rosbag": write_rosbag,
}
"""Functions that write a recording, by the name of the format; each returns remarks on the exported data."""
