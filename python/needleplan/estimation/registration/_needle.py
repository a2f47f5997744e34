"""Registration of a needle from two files: poses about a fixed tip, and points in both frames."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.artifacts import Parent
from needleplan.errors import DataError
from needleplan.estimation.registration._measurements import Points, Poses, read_points, read_poses
from needleplan.estimation.registration._pivot import Pivot, calibrate_axis
from needleplan.estimation.registration._registration import Registration
from needleplan.estimation.registration._rigid import Outlier, RigidMotion, register, worst_pair
from needleplan.signals import Array

__all__ = ["Registered", "register_needle"]

# Number of poses below which a remark asks for more.
_FEW_POSES = 100

# Spread of the directions (rad) below which a remark warns of a biased offset.
_NARROW_RAD = math.radians(10)

# Ratio, FRE of the best reflection to FRE of the fit, below which a remark reports a wrong sign of an axis.
_MIRRORED = 0.5


@dataclass(frozen=True)
class Registered:
    """Outcome of `register_needle`: the fits, the registration, and remarks about the data.

    If the poses do not determine the offset of the coil, `registration`, `motion` and `outlier` are None, and the
    remarks give the reason. `outlier` is also None if no pair of points contradicts the others. `names` are the names
    of the points.
    """

    pivot: Pivot
    motion: RigidMotion | None
    outlier: Outlier | None
    registration: Registration | None
    names: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether there is a registration."""
        return self.registration is not None


def register_needle(
    poses_file: str | os.PathLike[str], points_file: str | os.PathLike[str], title: str = ""
) -> Registered:
    """Register a needle from a file of poses and a file of points.

    If the poses do not determine the offset of the coil, the result has no registration, and nothing is raised. Raises
    DataError for files with mistakes, fewer than 3 points and collinear points.
    """
    poses, points = read_poses(poses_file), read_points(points_file)
    pivot = calibrate_axis(poses.positions_mm, _axes(poses.quaternions))
    remarks = list(_pivot_remarks(pivot, poses))
    if not pivot.ok:
        return Registered(pivot, None, None, None, points.names, tuple(remarks))
    offset = float(pivot.tip_mm[0])
    tracker = points.tracker_mm
    if points.quaternions is not None:
        tracker = tracker + offset * _axes(points.quaternions)
    try:
        motion = register(tracker, points.plan_mm)
        outlier = worst_pair(tracker, points.plan_mm)
    except DataError as error:
        raise DataError(error.mistakes, os.fspath(points_file)) from None
    remarks += _motion_remarks(motion, outlier, points)
    x, y, z, w = motion.rotation.as_quat().tolist()
    tx, ty, tz = motion.translation_mm.tolist()
    pairs = tuple(
        ((ax, ay, az), (bx, by, bz))
        for (ax, ay, az), (bx, by, bz) in zip(tracker.tolist(), points.plan_mm.tolist(), strict=True)
    )
    parents = (Parent(Path(poses_file).name, poses.digest), Parent(Path(points_file).name, points.digest))
    made = Registration(
        quaternion=(w, x, y, z), translation_mm=(tx, ty, tz), coil_offset_mm=abs(offset),
        coil_offset_sd_mm=float(pivot.tip_sd_mm[0]), coil_axis=1 if offset >= 0 else -1, pivot_rms_mm=pivot.rms_mm,
        pivot_poses=pivot.poses, points=pairs, parents=parents, title=title,
    )  # fmt: skip
    return Registered(pivot, motion, outlier, made, points.names, tuple(remarks))


def _axes(quaternions: Array) -> Array:
    """Return the z axis rotated by quaternions (n, 4) with w first, shape (n, 3)."""
    from scipy.spatial.transform import Rotation

    if not len(quaternions):
        return np.zeros((0, 3))
    return np.asarray(Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).apply([0.0, 0.0, 1.0]))


def _pivot_remarks(pivot: Pivot, poses: Poses) -> list[str]:
    spread = f"{math.degrees(pivot.spread_rad):.2g} degrees"
    if not pivot.ok:
        return [f"the coil is not determined, {pivot.status}: {pivot.poses} poses, directions spread by {spread}"]
    remarks = []
    if poses.missing:
        remarks.append(f"{poses.missing} rows without a pose are left out")
    if pivot.poses < _FEW_POSES:
        remarks.append(f"{pivot.poses} poses are few: record at least {_FEW_POSES}")
    if pivot.spread_rad < _NARROW_RAD:
        remarks.append(f"the directions spread by only {spread}: their noise makes the offset too small")
    if pivot.outliers:
        named = ", ".join(str(poses.lines[number]) for number in pivot.outliers[:5])
        more = f" and {len(pivot.outliers) - 5} more" if len(pivot.outliers) > 5 else ""
        remarks.append(f"outliers among the poses, not left out: line {named}{more}")
    if abs(float(pivot.tip_mm[0])) < 2 * float(pivot.tip_sd_mm[0]):
        remarks.append("the coil may be at the tip: the sign of its axis along the needle is not determined")
    return remarks


def _motion_remarks(motion: RigidMotion, outlier: Outlier | None, points: Points) -> list[str]:
    remarks = []
    if motion.mirrored_fre_mm < _MIRRORED * motion.fre_mm and motion.fre_mm > 1e-6:
        fits = f"the mirror image fits to {motion.mirrored_fre_mm:.3g} mm"
        remarks.append(f"{fits}: one axis of one of the frames has the wrong sign")
    elif outlier:
        remarks.append(
            f"{points.names[outlier.number]} is {outlier.distance_mm:.3g} mm from where the other points put it "
            f"(p {outlier.p_value:.2g}): measure it again"
        )
    if motion.points == 3:
        remarks.append("three points: a wrong point cannot be found; measure at least four")
    return remarks
