"""Registration of a needle from two files, poses about a fixed tip and points in both frames, with a verdict."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.artifacts import Parent, ShortRepr
from needleplan.errors import DataError
from needleplan.estimation.registration._alternatives import pairings, quaternion_orders
from needleplan.estimation.registration._measurements import Points, Poses, axes_of, read_points, read_poses
from needleplan.estimation.registration._pivot import Pivot, calibrate_axis
from needleplan.estimation.registration._registration import Registration
from needleplan.estimation.registration._rigid import Outlier, RigidMotion, register, worst_pair
from needleplan.estimation.registration._status import RegistrationVerdict, VerdictStatus
from needleplan.estimation.registration._verdict import (
    PoseNoise,
    Refusal,
    RefusalReason,
    pivot_refusals,
    points_refusals,
)
from needleplan.signals import Array

__all__ = ["CalibratedNeedle", "Registered", "calibrate_needle", "register_tracker"]

# Names of the points of the two frames in messages
_NAMES = ("points of the tracker", "points of the plan")

# Number of poses below which a remark asks for more.
_FEW_POSES = 100

# Spread of the directions (rad) below which a remark warns of a biased offset.
_NARROW_RAD = math.radians(10)

# Factor between the FRE of two pairings below which neither is the better one.
_AMBIGUOUS = 2.0

# Ratio of the smallest to the largest extent of points below which they lie in one plane.
_FLAT = 0.02


@dataclass(frozen=True)
class CalibratedNeedle(ShortRepr):
    """Outcome of `calibrate_needle`: the calibration, the reasons against it, and remarks about the data."""

    pivot: Pivot
    refusals: tuple[Refusal, ...]
    remarks: tuple[str, ...]
    verdict: RegistrationVerdict

    @property
    def ok(self) -> bool:
        """Whether the calibration may be used."""
        return self.verdict.ok


@dataclass(frozen=True)
class Registered(ShortRepr):
    """Outcome of `register_tracker`: the fits, the verdict with its reasons, and remarks about the data.

    `registration` is None unless the verdict is passed or accepted. If the poses do not determine the offset of the
    coil, `motion` and `outlier` are None as well. `outlier` is also None if no pair of points contradicts the others.
    `names` are the names of the points.
    """

    pivot: Pivot
    motion: RigidMotion | None
    outlier: Outlier | None
    registration: Registration | None
    names: tuple[str, ...]
    refusals: tuple[Refusal, ...]
    remarks: tuple[str, ...]
    verdict: RegistrationVerdict

    @property
    def ok(self) -> bool:
        """Whether there is a registration: it passed, or a person accepted it."""
        return self.registration is not None


def calibrate_needle(
    poses_file: str | os.PathLike[str],
    noise: PoseNoise | None = None,
    *,
    columns: str | Sequence[str] | None = None,
    accepted: str = "",
) -> CalibratedNeedle:
    """Determine the distance of a coil from the tip, from a file of poses about the fixed tip.

    Parameters
    ----------
    poses_file : path
        Poses of the coil, see `read_poses`.
    noise : PoseNoise, optional
        Noise of the tracker. Without it the calibration is refused.
    columns : str or sequence of str, optional
        Columns of the file, see `read_poses`.
    accepted : str, optional
        Reason for which a person accepts a refused calibration.

    Returns
    -------
    CalibratedNeedle
        The calibration and the verdict.

    Raises
    ------
    InputError
        The map of the columns is wrong.
    DataError
        The file has mistakes.

    """
    return _calibrated(read_poses(poses_file, columns), noise, accepted)


def register_tracker(
    poses_file: str | os.PathLike[str],
    points_file: str | os.PathLike[str],
    title: str = "",
    *,
    noise: PoseNoise | None = None,
    pivot_columns: str | Sequence[str] | None = None,
    points_columns: str | Sequence[str] | None = None,
    accepted: str = "",
) -> Registered:
    """Register the tracker to the plan from points, with the needle calibrated from poses, and judge the registration.

    Parameters
    ----------
    poses_file, points_file : path
        Poses of the coil about the fixed tip, and points in both frames; see `read_poses` and `read_points`.
    title : str, optional
        Title of the registration.
    noise : PoseNoise, optional
        Noise of the tracker. Without it the registration is refused.
    pivot_columns, points_columns : str or sequence of str, optional
        Columns of the files.
    accepted : str, optional
        Reason for which a person accepts a refused registration.

    Returns
    -------
    Registered
        The fits and the verdict. A refused registration is a value, and nothing is raised.

    Raises
    ------
    InputError
        A map of columns is wrong.
    DataError
        A file has mistakes, or there are fewer than 3 points, or the points are collinear.

    """
    poses, points = read_poses(poses_file, pivot_columns), read_points(points_file, points_columns)
    needle = _calibrated(poses, noise, accepted)
    pivot = needle.pivot
    if not pivot.ok:
        return Registered(pivot, None, None, None, points.names, needle.refusals, needle.remarks, needle.verdict)
    offset = float(pivot.tip_mm[0])
    touched = offset if points.quaternions is not None else 0.0
    tracker = points.tracker_mm + touched * (0.0 if points.quaternions is None else axes_of(points.quaternions))
    try:
        motion = register(tracker, points.plan_mm, _NAMES)
        outlier = worst_pair(tracker, points.plan_mm)
    except DataError as error:
        raise DataError(error.mistakes, os.fspath(points_file)) from None
    against = points_refusals(motion, tracker, points.plan_mm, points.names, noise, abs(touched))
    against += _touch_refusals(points, motion, offset, noise)
    refusals = (*needle.refusals, *against)
    remarks = (*needle.remarks, *_motion_remarks(motion, outlier, tracker, points))
    verdict = _verdict(refusals, noise, accepted)
    made = None
    if verdict.ok:
        parents = (Parent(Path(poses_file).name, poses.digest), Parent(Path(points_file).name, points.digest))
        made = _registration(pivot, motion, tracker, points.plan_mm, parents, title, verdict)
    return Registered(pivot, motion, outlier, made, points.names, refusals, remarks, verdict)


def _calibrated(poses: Poses, noise: PoseNoise | None, accepted: str) -> CalibratedNeedle:
    pivot = calibrate_axis(poses.positions_mm, poses.axes)
    refusals = tuple(pivot_refusals(poses, pivot, noise))
    verdict = _verdict(refusals, noise, accepted)
    return CalibratedNeedle(pivot, refusals, tuple(_pivot_remarks(pivot, poses)), verdict)


def _verdict(refusals: Sequence[Refusal], noise: PoseNoise | None, accepted: str) -> RegistrationVerdict:
    """Return the verdict; a person can accept everything but a coil that is not determined."""
    status = VerdictStatus.REFUSED if refusals else VerdictStatus.PASSED
    if refusals and accepted.strip() and not any(one.reason is RefusalReason.UNDETERMINED for one in refusals):
        status = VerdictStatus.ACCEPTED
    return RegistrationVerdict(
        status=status,
        noise_mm=noise.position_mm if noise else 0.0,
        noise_source=noise.source if noise else "",
        accepted=accepted.strip() if status is VerdictStatus.ACCEPTED else "",
        reasons=tuple(f"{refusal}" for refusal in refusals),
    )


def _registration(
    pivot: Pivot,
    motion: RigidMotion,
    tracker_mm: Array,
    plan_mm: Array,
    parents: tuple[Parent, ...],
    title: str,
    verdict: RegistrationVerdict,
) -> Registration:
    offset = float(pivot.tip_mm[0])
    x, y, z, w = motion.rotation.as_quat().tolist()
    tx, ty, tz = motion.translation_mm.tolist()
    pairs = tuple(
        ((ax, ay, az), (bx, by, bz))
        for (ax, ay, az), (bx, by, bz) in zip(tracker_mm.tolist(), plan_mm.tolist(), strict=True)
    )
    return Registration(
        quaternion=(w, x, y, z), translation_mm=(tx, ty, tz), coil_offset_mm=abs(offset),
        coil_offset_sd_mm=float(pivot.tip_sd_mm[0]), coil_axis=1 if offset >= 0 else -1, pivot_rms_mm=pivot.rms_mm,
        pivot_poses=pivot.poses, points=pairs, parents=parents, title=title, verdict=verdict,
    )  # fmt: skip


def _touch_refusals(points: Points, motion: RigidMotion, offset_mm: float, noise: PoseNoise | None) -> list[Refusal]:
    """Return a refusal if another reading of the quaternions of the touched points halves their residual."""
    if points.quaternions is None or (noise and motion.fre_mm < noise.position_mm):
        return []
    for reading, axes in quaternion_orders(points.quaternions).items():
        other = register(points.tracker_mm + offset_mm * axes, points.plan_mm)
        if 2 * other.fre_mm < motion.fre_mm:
            text = f"of the points: if {reading}, the FRE is {other.fre_mm:.3g} mm instead of {motion.fre_mm:.3g} mm"
            return [Refusal(RefusalReason.QUATERNION_ORDER, text)]
    return []


def _pivot_remarks(pivot: Pivot, poses: Poses) -> list[str]:
    if not pivot.ok:
        return []
    spread = f"{math.degrees(pivot.spread_rad):.2g} degrees"
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
        remarks.append(
            "the coil may be at the tip: neither the sign of its axis along the needle nor the order of the "
            "quaternions is determined"
        )
    return remarks


def _motion_remarks(motion: RigidMotion, outlier: Outlier | None, tracker: Array, points: Points) -> list[str]:
    remarks = []
    if outlier:
        remarks.append(
            f"{points.names[outlier.number]} is {outlier.distance_mm:.3g} mm from where the other points put it "
            f"(p {outlier.p_value:.2g}): measure it again"
        )
    if motion.points == 3:
        remarks.append("three points: a wrong point cannot be found; measure at least four")
    extents = np.linalg.svd(tracker - tracker.mean(axis=0), compute_uv=False)
    if extents[-1] < _FLAT * extents[0]:
        remarks.append("the points lie in one plane: a wrong sign of the axis across it cannot be found")
    other = next((pairing for pairing in pairings(tracker, points.plan_mm) if not pairing.mirrored), None)
    if other and other.fre_mm < _AMBIGUOUS * motion.fre_mm:
        remarks.append(
            f"{other.described(points.names)}: this fits to {other.fre_mm:.3g} mm, about as well as the given pairs "
            f"({motion.fre_mm:.3g} mm); an exchange would not be noticed: measure a point that breaks the symmetry"
        )
    return remarks
