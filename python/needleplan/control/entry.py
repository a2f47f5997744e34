"""Where the needle enters, as the tracker sees it before: it is straight there, and points where it will go."""

from __future__ import annotations

import math

import numpy as np

from needleplan.control.needle import Needle
from needleplan.estimation.registration import Registration

__all__ = ["measured_entry"]


def measured_entry(needle: Needle, registration: Registration, frames: int) -> tuple[float, float, float]:
    """Return the pose at which the needle enters, x_mm, y_mm and heading_rad: the mean over so many frames, at rest.

    Raises DeviceFault where there are no good frames.
    """
    rows = []
    for _ in range(frames):
        needle.settle(1)
        pose = needle.pose
        assert pose is not None
        position, direction = registration.place(pose.position_mm, pose.quaternion)
        ahead = registration.coil_offset_mm - needle.path_mm
        rows.append([*(at + ahead * along for at, along in zip(position, direction, strict=True)), *direction])
    x, y, _, dx, dy, _ = np.mean(rows, axis=0).tolist()
    return x, y, math.atan2(dy, dx)
