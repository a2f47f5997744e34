"""Where the needle enters, as the tracker sees it before: it is straight there, and points where it will go."""

from __future__ import annotations

import math

import numpy as np

from needleplan.control.needle import Needle
from needleplan.control.options import Options
from needleplan.errors import Mistake, PoseError
from needleplan.estimation.registration import Registration

__all__ = ["measured_entry", "require_expected"]


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
