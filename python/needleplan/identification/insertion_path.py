r"""The path of the tip of a recorded insertion in 3D, as a trial for models of the path.

The tracker measures the coil: its position c and the direction t of the needle, the distance o behind the tip at the
path length d. The shaft follows the tip, so with the curvature k and the direction b of the bevel along the path, to
first order in k o, the tip is at

    p = c + o t + \int_0^o u k(d - u) b(d - u) du

k is the planned curvature. b is the direction of the bevel at the roll of the base when the tip was at this length, in
the axes of the entry, which are moved to t by the smallest rotation. The trial is in the axes of the measured entry: x
along the insertion, and the needle bends toward +y at roll 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.devices import Health, PoseSample, StageSample
from needleplan.errors import DataError, Mistake
from needleplan.identification.space_curvature import SpaceInsertion, entry_of
from needleplan.models import TipFrame
from needleplan.signals import Array, FrameName, Record, RecordFrame, Role

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario

__all__ = ["InsertionPath", "insertion_path"]

# Number of pieces of the length from coil to tip in the integral of the curvature.
_PIECES = 16
_NANO = 1e-9


@dataclass(frozen=True, eq=False)
class InsertionPath(CallRepr):
    """The tip of a recorded insertion.

    `record` has one row for each pose of the tracker: depth, velocity, roll, and the position in the axes of the entry.
    `depth_mm`, shape (n,), and `points_mm`, shape (n, 3), are increasing depths and the tip there in the frame of the
    lattice.
    """

    record: Record
    depth_mm: Array
    points_mm: Array


def insertion_path(insertion: SpaceInsertion, scenario: SpaceScenario, role: Role = Role.TRAIN) -> InsertionPath:
    """Return the path of the tip of a recorded insertion.

    Before the entry, the tip counts as at the entry, as in models of the path. Poses that are not good are missing
    numbers.

    Parameters
    ----------
    insertion : SpaceInsertion
        Samples of stage and tracker.
    scenario : SpaceScenario
        The planned curvature at each position.
    role : Role, default train
        Role of the trial.

    Returns
    -------
    InsertionPath

    Raises
    ------
    DataError
        If the insertion has no usable poses of the needle at rest before its entry, or none in the tissue.
    """
    stage = [sample for sample in insertion.samples if isinstance(sample, StageSample)]
    poses = [sample for sample in insertion.samples if isinstance(sample, PoseSample)]
    x, y, heading, z, elevation = entry_of(insertion)
    frame = TipFrame.planar(x, y, heading).raised(elevation).moved((0.0, 0.0, z))
    axes, origin = np.array([frame.tangent, frame.normal, frame.binormal]), np.array(frame.position_mm)
    latency_s, offset_mm = insertion.settings.latency_s, insertion.registration.coil_offset_mm
    stage_s = np.array([sample.stamp.received_ns for sample in stage]) * _NANO
    time_s = np.array([sample.stamp.received_ns for sample in poses]) * _NANO - latency_s
    seen = (time_s >= stage_s[0]) & (time_s <= stage_s[-1])
    coil, along = np.array([_placed(insertion, pose) for pose in poses])[seen].transpose(1, 2, 0)
    time_s = time_s[seen]
    columns = {
        "depth_mm": np.array([sample.depth_mm for sample in stage]) - insertion.entry_depth_mm,
        "velocity_mm_s": np.array([sample.velocity_mm_s for sample in stage]),
        "angle_rad": np.array([sample.roll_rad for sample in stage]) - insertion.roll_left_rad,
    }
    columns = {name: np.interp(time_s, stage_s, values) for name, values in columns.items()}
    depth = columns["depth_mm"]
    straight = axes @ (coil + offset_mm * along - origin[:, None])
    new = np.flatnonzero((depth > np.maximum.accumulate(np.append(0.0, depth))[:-1]) & np.isfinite(straight[0]))
    if not new.size:
        raise DataError(Mistake("insertion", insertion.name, "must have usable poses of the tip in the tissue"))
    planned = scenario.curvature_per_mm(origin + straight[:, new].T @ axes)
    tip = straight + _bent(depth, offset_mm, (depth[new], planned, columns["angle_rad"][new]), axes @ along)
    tip[0] -= np.minimum(depth, 0.0)
    columns |= {"time_s": time_s - time_s[0], **dict(zip(("x_mm", "y_mm", "z_mm"), tip, strict=True))}
    measured_in = RecordFrame(FrameName.PLAN, "entry", insertion.name)
    record = Record(columns, insertion.name, role, frame=measured_in)
    return InsertionPath(record, depth[new], origin + tip[:, new].T @ axes)


def _placed(insertion: SpaceInsertion, pose: PoseSample) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return position (mm) and direction of the coil in the frame of the lattice; NaN for a pose that is not good."""
    if pose.health is not Health.GOOD:
        return (np.nan,) * 3, (np.nan,) * 3
    return insertion.registration.place(pose.position_mm, pose.quaternion)


def _bent(depth_mm: Array, offset_mm: float, by_depth: tuple[Array, Array, Array], tangents: Array) -> Array:
    """Return the integral of the module, shape (3, samples), in the axes of the entry.

    `by_depth` are increasing depths (mm) with the curvature (1/mm) and the roll (rad) there; `tangents`, shape
    (3, samples), are the measured directions.
    """
    depths, planned, rolls = by_depth
    across = np.zeros((2, depth_mm.size))
    for behind_mm in offset_mm * (np.arange(_PIECES) + 0.5) / _PIECES:
        length = depth_mm - behind_mm
        bend = np.where(length > 0, np.interp(length, depths, planned), 0.0) * behind_mm * offset_mm / _PIECES
        roll = np.interp(length, depths, rolls)
        across += bend * np.array([np.cos(roll), np.sin(roll)])
    # The smallest rotation from x to t takes a vector v across x to v - (t v) / (1 + t_x) (x + t).
    turned = (tangents[1:] * across).sum(0) / (1 + tangents[0])
    moved = np.concatenate([np.zeros((1, depth_mm.size)), across])
    return np.asarray(moved - turned * (np.array([[1.0], [0.0], [0.0]]) + tangents))
