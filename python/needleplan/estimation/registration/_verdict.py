"""The verdict on a registration: whether its measurements support it, with the reasons against it.

Every limit compares the measurements with each other or with the noise of the tracker, which was measured at rest or
declared. Without a known noise no residual can be judged, so the registration is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration._alternatives import best_scale, pairings, quaternion_orders
from needleplan.estimation.registration._measurements import Poses
from needleplan.estimation.registration._pivot import Pivot, calibrate_axis
from needleplan.estimation.registration._rigid import RigidMotion
from needleplan.signals import Array

__all__ = [
    "PoseNoise",
    "Refusal",
    "RefusalReason",
    "noise_at_rest",
    "pivot_refusals",
    "points_refusals",
]

# Largest ratio of a residual to the noise of the tracker; residuals also hold distortion and the touch of a point.
_MOST_NOISE = 5.0

# Smallest ratio of a residual to the noise of the tracker; a smaller residual is in another unit.
_LEAST_NOISE = 0.05

# Ratio of residuals above which another pairing, handedness or scale is the better one.
_BETTER = 10.0

# Ratio of residuals below which another reading of the quaternions is the better one.
_BETTER_AXES = 0.7

# Extent (mm) of poses or points below which they are in metres, and above which they are in micrometres.
_LEAST_EXTENT_MM, _MOST_EXTENT_MM = 3.0, 1e4

# Largest offset of a coil (mm) in a registration file.
_MOST_OFFSET_MM = 500.0

# Number of poses at rest below which their scatter is no measure of noise.
_LEAST_REST = 10

# Ratio of the scatter of poses to that from one pose to the next, above which the needle has moved: white noise has 1,
# and that of a tracker that averages over 9 frames 3. Scatter (mm, rad) below which a motion is not looked for.
_MOST_WANDER, _WANDER_MM, _WANDER_RAD = 3.0, 0.5, 0.02

# Relative difference of the scales of the frames below which they count as equal.
_SAME_SCALE = 0.01


class RefusalReason(StrEnum):
    """Reason against a registration."""

    UNDETERMINED = "undetermined"
    """The poses do not determine the offset of the coil."""

    IDENTITY_POSES = "identity poses"
    """Poses are the identity, as some programs write for a tool out of view."""

    REPEATED_POSES = "repeated poses"
    """Poses repeat bit for bit: the tracker or the program stood still."""

    NOISE_UNKNOWN = "noise unknown"
    """The noise of the tracker was neither measured at rest nor declared, so residuals cannot be judged."""

    RESIDUAL = "residual"
    """The residual of poses or points is above a multiple of the noise of the tracker."""

    UNITS = "units"
    """Lengths are implausible, or the frames differ by a scale."""

    QUATERNION_ORDER = "quaternion order"
    """Another reading of the quaternions fits better."""

    PAIRING = "pairing"
    """Another pairing of the points fits ten times better."""

    HANDEDNESS = "handedness"
    """A mirror image of the points fits ten times better."""


@dataclass(frozen=True)
class Refusal:
    """A reason against a registration, and a sentence with the measurement."""

    reason: RefusalReason
    text: str

    def __str__(self) -> str:
        return f"{self.reason}: {self.text}"


@dataclass(frozen=True)
class PoseNoise:
    """Noise of the tracker: root mean square error of a position (mm) in three dimensions, and of a direction (rad).

    `source` says how it is known: measured at rest or declared.
    """

    position_mm: float
    direction_rad: float = 0.0
    source: str = "declared"

    def __post_init__(self) -> None:
        if not 0 < self.position_mm < math.inf:
            raise DataError(Mistake("noise", f"{self.position_mm:g}", "must be a positive number of mm"))

    def at_tip_mm(self, offset_mm: float) -> float:
        """Return the root mean square error (mm) of the tip of a needle whose coil is `offset_mm` behind it."""
        return math.hypot(self.position_mm, offset_mm * self.direction_rad)


def noise_at_rest(poses: Poses, source: str = "") -> PoseNoise:
    """Return the noise that poses of a needle at rest show.

    Parameters
    ----------
    poses : Poses
        At least 10 poses.
    source : str
        Name of the file in messages.

    Returns
    -------
    PoseNoise
        Scatter of the positions and directions about their means.

    Raises
    ------
    DataError
        There are too few poses, they do not scatter, they repeat or are the identity, or the needle moved.

    """
    if len(poses.lines) < _LEAST_REST:
        rule = f"must be at least {_LEAST_REST} to measure the noise"
        raise DataError(Mistake("poses at rest", f"{len(poses.lines)}", rule), source)
    if wrong := _unmeasured(poses):
        raise DataError(Mistake("poses at rest", "", "; ".join(f"{refusal}" for refusal in wrong)), source)
    count = len(poses.lines)
    spread = poses.positions_mm - poses.positions_mm.mean(axis=0)
    mean = poses.axes.mean(axis=0)
    length = float(np.linalg.norm(mean))
    position = math.sqrt(float((spread**2).sum()) / (count - 1))
    if position == 0:
        raise DataError(Mistake("poses at rest", "", "do not scatter: they are no measurements"), source)
    for rows, least, text in (
        (poses.positions_mm, _WANDER_MM, "positions scatter by {:.3g} mm, from one to the next by {:.3g} mm"),
        (poses.axes, _WANDER_RAD, "directions scatter by {:.3g} rad, from one to the next by {:.3g} rad"),
    ):
        whole, step = _scatter(rows)
        if whole > max(least, _MOST_WANDER * step):
            rule = f"the needle moved: {text.format(whole, step)}; record it while it lies still"
            raise DataError(Mistake("poses at rest", "", rule), source)
    # The mean of 1 - cos(angle) is half the mean square angle.
    direction = math.sqrt(2 * max(1 - length, 0.0) * count / (count - 1))
    return PoseNoise(position, direction, f"measured at rest, {count} poses")


def _scatter(rows: Array) -> tuple[float, float]:
    """Return the root mean square scatter of rows about their mean, and that which their successive differences show.

    Both are the same for white noise (von Neumann, Ann. Math. Statist. 12 (1941) 367).
    """
    whole = float(((rows - rows.mean(axis=0)) ** 2).sum()) / (len(rows) - 1)
    steps = float((np.diff(rows, axis=0) ** 2).sum()) / (2 * (len(rows) - 1))
    return math.sqrt(whole), math.sqrt(steps)


def pivot_refusals(poses: Poses, pivot: Pivot, noise: PoseNoise | None) -> list[Refusal]:
    """Return the reasons to refuse the calibration of a coil.

    Parameters
    ----------
    poses : Poses
        Poses about the fixed tip.
    pivot : Pivot
        The calibration of these poses.
    noise : PoseNoise or None
        Noise of the tracker, if known.

    Returns
    -------
    list of Refusal
        Empty if there is no reason.

    """
    refusals = _unmeasured(poses)
    extent = float(np.ptp(poses.positions_mm, axis=0).max()) if len(poses.lines) else math.nan
    farthest = float(np.abs(poses.positions_mm).max()) if len(poses.lines) else math.nan
    if farthest < _LEAST_EXTENT_MM:
        text = f"no pose is farther than {farthest:.3g} mm from the origin: metres?"
        refusals.append(Refusal(RefusalReason.UNITS, text))
    elif farthest > _MOST_EXTENT_MM:
        refusals.append(
            Refusal(RefusalReason.UNITS, f"poses are up to {farthest:.3g} mm from the origin: micrometres?")
        )
    if not pivot.ok:
        spread = f"{math.degrees(pivot.spread_rad):.2g} degrees"
        text = f"{pivot.status}: {pivot.poses} poses, directions spread by {spread}"
        return [*refusals, Refusal(RefusalReason.UNDETERMINED, text)]
    offset = abs(float(pivot.tip_mm[0]))
    if offset > _MOST_OFFSET_MM:
        text = f"the coil would be {offset:.4g} mm from the tip, above {_MOST_OFFSET_MM:g} mm"
        refusals.append(Refusal(RefusalReason.UNITS, text))
    for reading, axes in quaternion_orders(poses.quaternions).items():
        other = calibrate_axis(poses.positions_mm, axes)
        if other.ok and other.rms_mm < _BETTER_AXES * pivot.rms_mm and pivot.rms_mm > _floor_mm(noise):
            text = f"if {reading}, the residual is {other.rms_mm:.3g} mm instead of {pivot.rms_mm:.3g} mm, and "
            text += f"the coil {abs(float(other.tip_mm[0])):.3g} mm behind the tip instead of {offset:.3g} mm"
            refusals.append(Refusal(RefusalReason.QUATERNION_ORDER, text))
            break
    return [*refusals, *_residual("the poses", pivot.rms_mm, noise, offset), *_noise_unknown(noise, extent)]


def points_refusals(
    motion: RigidMotion,
    tracker_mm: Array,
    plan_mm: Array,
    names: tuple[str, ...],
    noise: PoseNoise | None,
    offset_mm: float,
) -> list[Refusal]:
    """Return the reasons to refuse the rigid motion from tracker to plan.

    Parameters
    ----------
    motion : RigidMotion
        The motion, fitted to the points.
    tracker_mm, plan_mm : array, shape (n, 3)
        The points in both frames.
    names : tuple of str
        Names of the points.
    noise : PoseNoise or None
        Noise of the tracker, if known.
    offset_mm : float
        Distance (mm) of the coil from the tip if the points were touched with the needle, else 0.

    Returns
    -------
    list of Refusal
        Empty if there is no reason.

    """
    refusals = []
    for frame, points in (("tracker", tracker_mm), ("plan", plan_mm)):
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        if not _LEAST_EXTENT_MM < extent < _MOST_EXTENT_MM:
            unit = "metres" if extent < 1 else "micrometres"
            text = f"the points span {extent:.3g} mm in the frame of the {frame}: {unit}?"
            refusals.append(Refusal(RefusalReason.UNITS, text))
    if motion.fre_mm > _floor_mm(noise):
        scale, scaled = best_scale(tracker_mm, plan_mm)
        if _BETTER * scaled < motion.fre_mm and abs(scale - 1) > _SAME_SCALE:
            text = f"lengths of the plan are {scale:.2g} times those of the tracker: with this scale the points fit to "
            refusals.append(Refusal(RefusalReason.UNITS, f"{text}{scaled:.3g} mm instead of {motion.fre_mm:.3g} mm"))
        best = pairings(tracker_mm, plan_mm)[0]
        if _BETTER * best.fre_mm < motion.fre_mm:
            text = f"{best.described(names)}: this fits to {best.fre_mm:.3g} mm instead of {motion.fre_mm:.3g} mm"
            refusals.append(Refusal(RefusalReason.HANDEDNESS if best.given else RefusalReason.PAIRING, text))
    return [*refusals, *_residual("the points (FLE)", motion.fle_mm, noise, offset_mm)]


def _unmeasured(poses: Poses) -> list[Refusal]:
    """Return refusals of poses that no tracker measured: the identity, and repetitions."""
    refusals = []
    identity = ~poses.positions_mm.any(axis=1)
    if identity.any():
        text = f"{int(identity.sum())} of {len(poses.lines)} poses are at the origin, the first in line "
        text += f"{poses.lines[int(np.argmax(identity))]}: programs write the identity for a tool out of view; "
        refusals.append(Refusal(RefusalReason.IDENTITY_POSES, f"{text}leave these rows empty"))
    rows = np.column_stack([poses.positions_mm, poses.quaternions])[~identity]
    lines = np.array(poses.lines)[~identity]
    _, first, counts = np.unique(rows, axis=0, return_index=True, return_counts=True)
    repeated = len(rows) - len(counts)
    if repeated:
        line = int(lines[first[counts > 1]].min())
        text = f"{repeated} of {len(poses.lines)} poses repeat another one bit for bit, the first in line {line}"
        refusals.append(Refusal(RefusalReason.REPEATED_POSES, text))
    return refusals


def _floor_mm(noise: PoseNoise | None) -> float:
    """Return the residual (mm) below which no other reading is preferred: that of the noise."""
    return noise.position_mm if noise else 1e-6


def _residual(name: str, residual_mm: float, noise: PoseNoise | None, offset_mm: float) -> list[Refusal]:
    """Return a refusal if a residual is not that of the noise of the tracker."""
    if noise is None:
        return []
    expected = noise.at_tip_mm(offset_mm)
    text = f"that of {name} is {residual_mm:.3g} mm, {residual_mm / expected:.2g} times the noise of the tracker "
    text += f"({expected:.3g} mm, {noise.source})"
    if residual_mm > _MOST_NOISE * expected:
        return [Refusal(RefusalReason.RESIDUAL, f"{text}; at most {_MOST_NOISE:g} times is allowed")]
    if residual_mm < _LEAST_NOISE * expected and "poses" in name:
        return [Refusal(RefusalReason.UNITS, f"the residual is implausibly small: {text}")]
    return []


def _noise_unknown(noise: PoseNoise | None, extent_mm: float) -> list[Refusal]:
    if noise is not None:
        return []
    text = "residuals cannot be judged: record poses with the needle at rest (--rest FILE), or declare the root mean "
    text += f"square error of a position (--noise-mm); the poses span {extent_mm:.3g} mm"
    return [Refusal(RefusalReason.NOISE_UNKNOWN, text)]
