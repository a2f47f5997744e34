"""Where the needle enters, as the tracker sees it before: it is straight there, and points where it will go."""

from __future__ import annotations

import math

import numpy as np

from needleplan.control.needle import Needle
from needleplan.control.options import Options
from needleplan.errors import DeviceFault, Mistake, PoseError
from needleplan.estimation.registration import Registration

__all__ = ["measured_entry", "require_expected"]


def measured_entry(
    needle: Needle, registration: Registration, frames: int, oldest_s: float
) -> tuple[float, float, float]:
    """Return the pose at which the needle enters, x_mm, y_mm and heading_rad: the mean over so many frames, at rest.

    Raises DeviceFault where there are no good frames, or where they come so seldom that the last one would be
    older than `oldest_s`, which is what the guard allows, before the next comes: the needle would do nothing but pause.
    """
    rows, times_ns = [], []
    for _ in range(frames):
        needle.settle(1)
        pose = needle.pose
        assert pose is not None
        times_ns.append(pose.stamp.received_ns)
        position, direction = registration.place(pose.position_mm, pose.quaternion)
        ahead = registration.coil_offset_mm - needle.path_mm
        rows.append([*(at + ahead * along for at, along in zip(position, direction, strict=True)), *direction])
    interval_s = float(np.median(np.diff(times_ns))) * 1e-9
    if interval_s >= oldest_s:
        raise DeviceFault(
            f"tracker: its frames come every {1e3 * interval_s:.0f} ms, and a pose may be {1e3 * oldest_s:.0f} ms old: "
            "ask it for more frames, or set safety.pose_age_s to more than the time between two"
        )
    x, y, _, dx, dy, _ = np.mean(rows, axis=0).tolist()
    return x, y, math.atan2(dy, dx)


def require_expected(entry: tuple[float, float, float], options: Options) -> None:
    """Raise PoseError where the needle stands elsewhere than it should."""
    expected = options.expected_start
    if expected is None:
        return
    off_mm = math.dist(entry[:2], expected[:2])
    off_rad = abs(math.remainder(entry[2] - expected[2], 2 * math.pi))
    if off_mm > options.start_within_mm or off_rad > options.start_within_rad:
        found = f"x {entry[0]:.2f} mm, y {entry[1]:.2f} mm, heading {math.degrees(entry[2]):.2f} deg"
        rule = f"is {off_mm:.1f} mm and {math.degrees(off_rad):.1f} deg from the start that is wanted"
        raise PoseError(Mistake("start", found, rule))
