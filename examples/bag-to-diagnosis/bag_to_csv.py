"""Read depth and force of bags into one file with columns and units of needleplan. Change topics and signs to yours."""

from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from needleplan.recording import write_records
from needleplan.signals import Record, Role

ROLES = {"first": Role.TRAIN, "second": Role.TRAIN, "third": Role.HOLDOUT, "air": Role.NOISE}


def record(name: str, role: Role) -> Record:
    """Return a bag as a trial: the force interpolated to the times of the joint states."""
    joints, wrenches = [], []
    with AnyReader([Path(name)]) as bag:
        for connection, stamp, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            if connection.topic == "/needle/joint_states":
                joints.append((stamp / 1e9, 1e3 * message.position[0], 1e3 * message.velocity[0]))  # m to mm
            elif connection.topic == "/needle/wrench":
                wrenches.append((stamp / 1e9, -message.wrench.force.x))  # needleplan counts the push into the tissue
    time_s, depth_mm, velocity_mm_s = np.array(joints).T
    force_s, force_n = np.array(wrenches).T
    columns = {"time_s": time_s - time_s[0], "force_n": np.interp(time_s, force_s, force_n)}
    if role is not Role.NOISE:
        columns |= {"depth_mm": depth_mm, "velocity_mm_s": velocity_mm_s}
    return Record(columns, name, role)


write_records([record(name, role) for name, role in ROLES.items()], "trials.csv")
