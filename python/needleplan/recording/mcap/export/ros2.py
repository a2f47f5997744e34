"""A ROS 2 bag (MCAP storage) of the standard messages, in metres as ROS has it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from needleplan.recording.files import PathLike
from needleplan.recording.mcap.export.tables import new_folder, optional
from needleplan.recording.mcap.kinds import FORCE, POSE, STAGE
from needleplan.recording.mcap.recording import Message, Recording

__all__ = ["write_rosbag"]

_MM = 1e-3


def write_rosbag(recording: Recording, path: PathLike) -> tuple[str, ...]:
    """Write a ROS 2 bag and return remarks. Raises OutputError where rosbags is missing, or it fails.

    Forces become geometry_msgs/WrenchStamped (N, N m), poses geometry_msgs/PoseStamped (m), the stage
    sensor_msgs/JointState (insertion in m, roll in rad), everything else std_msgs/String with JSON. Samples of a
    tracker that sees nothing have no pose and are left out, which is remarked.
    """
    rosbag2 = optional("rosbags.rosbag2", path)
    typesys = optional("rosbags.typesys", path)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    remarks = []
    with new_folder(path) as folder:
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
    """Move the files of a bag up into its folder, named after it as ROS does."""
    metadata = (bag / "metadata.yaml").read_text(encoding="utf-8").replace("bag.mcap", f"{name}.mcap")
    (folder / "metadata.yaml").write_text(metadata, encoding="utf-8")
    (bag / "bag.mcap").rename(folder / f"{name}.mcap")
    (bag / "metadata.yaml").unlink()
    bag.rmdir()


def _header(store: Any, wall_ns: int, frame: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=wall_ns // 10**9, nanosec=wall_ns % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _vector(store: Any, message: Message, names: str, factor: float, kind: str = "Vector3") -> Any:
    x, y, z = (factor * message.values[name] for name in names.split())
    return store.types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)


def _wrench(store: Any, message: Message, wall_ns: int) -> Any:
    force = _vector(store, message, "force_x_n force_y_n force_z_n", 1.0)
    torque = _vector(store, message, "torque_x_n_mm torque_y_n_mm torque_z_n_mm", _MM)
    wrench = store.types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
    header = _header(store, wall_ns, message.topic.strip("/"))
    return store.types["geometry_msgs/msg/WrenchStamped"](header=header, wrench=wrench)


def _pose(store: Any, message: Message, wall_ns: int) -> Any:
    w, x, y, z = (message.values[f"q{each}"] for each in "wxyz")
    orientation = store.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    position = _vector(store, message, "x_mm y_mm z_mm", _MM, "Point")
    pose = store.types["geometry_msgs/msg/Pose"](position=position, orientation=orientation)
    header = _header(store, wall_ns, message.topic.strip("/"))
    return store.types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)


def _joints(store: Any, message: Message, wall_ns: int) -> Any:
    values = message.values
    return store.types["sensor_msgs/msg/JointState"](
        header=_header(store, wall_ns, message.topic.strip("/")),
        name=["insertion", "roll"],
        position=np.array([_MM * values["depth_mm"], values["roll_rad"]]),
        velocity=np.array([_MM * values["velocity_mm_s"], np.nan]),
        effort=np.array([]),
    )


def _text(store: Any, message: Message, _: int) -> Any:
    return store.types["std_msgs/msg/String"](data=json.dumps(message.values))


_CONVERSIONS: dict[str, tuple[str, Callable[[Any, Message, int], Any]]] = {
    FORCE.name: ("geometry_msgs/msg/WrenchStamped", _wrench),
    POSE.name: ("geometry_msgs/msg/PoseStamped", _pose),
    STAGE.name: ("sensor_msgs/msg/JointState", _joints),
}
