"""Export to ROS 2 bags: standard messages in SI units, and typed messages of the package `needleplan_msgs`.

The definitions of the typed messages are in `needleplan/ros2/needleplan_msgs`, a ROS 2 package to build with colcon.
The bag contains all definitions, so rosbags and Foxglove read it without this package.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.recording._data_files import PathLike
from needleplan.recording._export_target import NewFolder, optional_library
from needleplan.recording._message_kinds import MessageKind, Packed
from needleplan.recording._recording import RecordedMessage, Recording
from needleplan.recording._sample_kinds import FORCE, POSE, STAGE

__all__ = ["DEFINITIONS", "write_rosbag"]

DEFINITIONS = Path(__file__).parents[1] / "ros2" / "needleplan_msgs" / "msg"
"""Folder of the message definitions of `needleplan_msgs`."""

_PACKAGE = "needleplan_msgs/msg/"
_VALUES = f"{_PACKAGE}Values"  # named numbers and texts, for messages without a type of their own
_HEADER = "std_msgs/Header header\n"

_MM = 1e-3


def write_rosbag(recording: Recording, path: PathLike, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a ROS 2 bag (MCAP storage) with standard messages in SI units, and return one remark for each topic.

    Forces become geometry_msgs/WrenchStamped (N, N m), poses geometry_msgs/PoseStamped (m), samples of the stage
    sensor_msgs/JointState (insertion in m, roll in rad). Other messages keep the units that their names state: packed
    messages keep their fields; decisions, events and the status of the recorder have types in `needleplan_msgs`; JSON
    messages without such a type become needleplan_msgs/Values. Tracker samples without a pose are left out and counted
    in the remarks.

    If `overwrite`, the folder may exist; only files with the same names are replaced. Raises OutputError if the package
    rosbags is not installed, or if the folder exists or cannot be written; DataError if a message is damaged.
    """
    rosbag2 = optional_library("rosbags.rosbag2", path)
    typesys = optional_library("rosbags.typesys", path)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    store.register(_definitions(typesys, recording.kinds))
    remarks = []
    with NewFolder(path, overwrite) as folder:
        bag_folder = folder / "bag"
        plugin = rosbag2.StoragePlugin.MCAP
        with rosbag2.Writer(bag_folder, version=9, storage_plugin=plugin) as bag:
            for topic in recording.counts:
                its_type, convert = _conversion(recording.kinds[topic])
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


def _definitions(typesys: Any, kinds: Mapping[str, MessageKind]) -> dict[str, Any]:
    """Return the definitions of `needleplan_msgs`, and of all packed messages of a recording, for a type store."""
    found: dict[str, Any] = {}
    texts = {f"{_PACKAGE}{file.stem}": file.read_text(encoding="utf-8") for file in sorted(DEFINITIONS.glob("*.msg"))}
    texts |= {kind.name: _HEADER + kind.schema.decode() for kind in kinds.values() if _keeps_fields(kind)}
    for name, text in texts.items():
        found |= typesys.get_types_from_msg(text, name)
    return found


def _keeps_fields(kind: MessageKind) -> bool:
    """Return whether a kind has fields with types and a name that ROS 2 permits, and no standard message."""
    named = re.fullmatch(r"[a-z]\w*/msg/[A-Z]\w*", kind.name)
    return (
        isinstance(kind, Packed)
        and named is not None
        and kind.name not in _CONVERSIONS
        and all(field.name != "header" for field in kind.fields)
    )


def _conversion(kind: MessageKind) -> tuple[str, _Convert]:
    """Return the type of the ROS 2 messages for messages of a kind, and the function that makes them."""
    if kind.name in _CONVERSIONS:
        return _CONVERSIONS[kind.name]
    if isinstance(kind, Packed) and _keeps_fields(kind):
        return kind.name, _Fields(kind)
    own = kind.name.removeprefix("needleplan.")
    its_type = f"{_PACKAGE}{own}" if (DEFINITIONS / f"{own}.msg").is_file() else _VALUES
    return its_type, _Typed(its_type)


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


@dataclass(frozen=True)
class _Fields:
    """Makes ROS 2 messages with the fields of a packed message and a header."""

    kind: Packed

    def __call__(self, store: Any, message: RecordedMessage, wall_ns: int) -> Any:
        numbered = {field.name: field.choices for field in self.kind.fields if field.choices}
        values = {name: numbered[name].index(value) if name in numbered else value
                  for name, value in message.values.items()}  # fmt: skip
        header = _header(store, wall_ns, message.topic.strip("/"))
        return store.types[self.kind.name](header=header, **values)


@dataclass(frozen=True)
class _Typed:
    """Makes messages of `needleplan_msgs`: fields by name; what is left over becomes named numbers and texts."""

    type: str

    def __call__(self, store: Any, message: RecordedMessage, wall_ns: int) -> Any:
        left, fields = dict(message.values), {}
        for name, (node, detail) in store.fielddefs[self.type][1]:
            if name in ("header", "numbers", "texts"):
                continue
            (kind, _) = detail if node == node.BASE else detail[0][1]
            make = _MAKERS[kind] if node == node.BASE else _array_of(kind)
            try:
                fields[name] = make(left.get(name))
            except (TypeError, ValueError, OverflowError):  # of another type: it stays among the named values
                fields[name] = make(None)
            else:
                left.pop(name, None)
        number, text = store.types[f"{_PACKAGE}Number"], store.types[f"{_PACKAGE}Text"]
        flat = list(_flat(left))
        numbers = [number(key=key, value=value) for key, value in flat if isinstance(value, float)]
        texts = [text(key=key, value=value) for key, value in flat if isinstance(value, str)]
        header = _header(store, wall_ns, message.topic.strip("/"))
        return store.types[self.type](header=header, **fields, numbers=numbers, texts=texts)


def _flat(value: object, key: str = "") -> Iterator[tuple[str, float | str]]:
    """Yield the numbers and texts in nested values, with their keys joined by points; null becomes NaN."""
    if isinstance(value, Mapping):
        entries = [(str(name), each) for name, each in value.items()]
    elif isinstance(value, list | tuple):
        entries = [(f"{index}", each) for index, each in enumerate(value)]
    else:
        yield key, value if isinstance(value, str) else _number(value)
        return
    for name, each in entries:
        yield from _flat(each, f"{key}.{name}" if key else name)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _integer(value: Any) -> int:
    return int(np.int64(value or 0))


def _array_of(kind: str) -> Callable[[Any], NDArray[Any]]:
    return lambda values: np.array([_MAKERS[kind](each) for each in values or ()], np.dtype(kind))


def _word(value: Any) -> str:
    return "" if value is None else str(value)


# Functions that make the value of a field from a value of a recording, or from None, by the type of the field.
_MAKERS: dict[str, Callable[[Any], Any]] = {
    "float64": _number,
    "int64": _integer,
    "bool": bool,
    "string": _word,
}

_Convert = Callable[[Any, RecordedMessage, int], Any]

_CONVERSIONS: dict[str, tuple[str, _Convert]] = {
    FORCE.name: ("geometry_msgs/msg/WrenchStamped", _wrench),
    POSE.name: ("geometry_msgs/msg/PoseStamped", _pose),
    STAGE.name: ("sensor_msgs/msg/JointState", _joints),
}
