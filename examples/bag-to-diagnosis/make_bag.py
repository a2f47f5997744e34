"""Write three trials and a record of noise as ROS 2 bags: depth as joint state, force as wrench."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from needleplan.models import ShaftAndTip, simulate
from needleplan.models.effects import effect_named
from needleplan.signals import lspb

TRIALS = {
    "first": ([-2, 30, 20, 60, -2], [4, 8, 6, 12]),
    "second": ([-2, 45, 35, 60, -2], [9, 5, 3, 10]),
    "third": ([-2, 20, 60, -2], [10, 4, 8]),
}
BASE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
HIDDEN = effect_named("viscous").apply(BASE, {"size": 2e-4})

types = get_typestore(Stores.ROS2_HUMBLE)
Header, Time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
Joint, Wrench = types.types["sensor_msgs/msg/JointState"], types.types["geometry_msgs/msg/WrenchStamped"]
Force, Vector = types.types["geometry_msgs/msg/Wrench"], types.types["geometry_msgs/msg/Vector3"]


def write(name: str, time_s: np.ndarray, depth_mm: np.ndarray, velocity_mm_s: np.ndarray, force_n: np.ndarray) -> None:
    """Write one bag. ROS counts in m, and in N towards the robot."""
    with Writer(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        joints = bag.add_connection("/needle/joint_states", Joint.__msgtype__, typestore=types)
        wrench = bag.add_connection("/needle/wrench", Wrench.__msgtype__, typestore=types)
        for time, depth, velocity, force in zip(time_s, depth_mm, velocity_mm_s, force_n, strict=True):
            stamp = round(1e9 * float(time))
            header = Header(Time(stamp // 10**9, stamp % 10**9), "needle")
            joint = Joint(header, ["insertion"], np.array([depth / 1e3]), np.array([velocity / 1e3]), np.array([]))
            bag.write(joints, stamp, types.serialize_cdr(joint, Joint.__msgtype__))
            load = Force(Vector(-float(force), 0.0, 0.0), Vector(0.0, 0.0, 0.0))
            bag.write(wrench, stamp, types.serialize_cdr(Wrench(header, load), Wrench.__msgtype__))


random = np.random.default_rng(1)
for name, (depths, speeds) in TRIALS.items():
    motion = lspb(depths, speeds, rate_hz=50)
    measured = simulate(HIDDEN, motion).output + random.normal(0, 0.02, len(motion))
    write(name, motion.time_s, motion.depth_mm, motion.velocity_mm_s, measured)
still = np.zeros(1500)
write("air", np.arange(1500) / 50, still - 2, still, random.normal(0, 0.02, 1500))
