"""One insertion of `identify curvature`: its points, the curvature of the whole path, and of its segments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.identification._fitted_arcs import Curvature, CurvatureChange, TrackerNoise
from needleplan.identification._insertion_path import EntryPath, PathShape, entry_path
from needleplan.signals import Array, Motion, Record

__all__ = ["CurvatureTrial", "insertion_of"]

# Number of points per segment below which a trial is not divided into segments.
_POINTS_A_SEGMENT = 10

# Number of samples on the way in below which a record is no insertion.
_LEAST_POINTS = 3

# Retraction (mm) from the greatest depth beyond which samples are left out.
_BACK = 1.0


@dataclass(frozen=True)
class CurvatureTrial(ShortRepr):
    """One insertion: points in mm, shape (n, 2), and the path of one curvature that is fitted to them.

    `segments` holds the curvature of each segment, and `changes` the changes between them; both are empty if the path
    was not divided. `noise` and `correlation_mm` are the assumptions about the noise of the tracker, as for `fit_arcs`.
    """

    name: str
    points_mm: Array
    noise: TrackerNoise
    correlation_mm: float | None
    path: EntryPath
    segments: tuple[Curvature, ...]
    changes: tuple[CurvatureChange, ...]
    motion: Motion
    """Motion of the needle, one sample per point."""

    depth_mm: Array | None
    """Depth of each point, shape (n,); None if the record has no depths."""

    other_mm: Array | None
    """Points in the other plane, shape (m, 2); None if they were not tracked."""

    other_depth_mm: Array | None
    """Depth of the points in the other plane, shape (m,)."""

    remarks: tuple[str, ...]

    @property
    def whole(self) -> Curvature:
        """Curvature of the whole path."""
        return self.path.fitted.segments[0]

    def path_of(self, shape: PathShape, noise: TrackerNoise | None = None) -> EntryPath:
        """Return the path with a shape. `noise` replaces the noise that the trial assumes."""
        assumed = noise or self.noise
        if (shape, assumed) == (self.path.shape, self.noise):
            return self.path
        return entry_path(
            self.points_mm, self.depth_mm, shape, self.name, noise=assumed, correlation_mm=self.correlation_mm
        )

    def other_path(self) -> EntryPath | None:
        """Return the path in the other plane; None if it was not tracked."""
        if self.other_mm is None:
            return None
        return entry_path(
            self.other_mm, self.other_depth_mm, PathShape(), self.name, noise=self.noise,
            correlation_mm=self.correlation_mm,
        )  # fmt: skip


def insertion_of(
    record: Record,
    *,
    segments: int = 2,
    plane: str = "xy",
    skip_mm: float = 0.0,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
) -> CurvatureTrial:
    """Return the curvature of one trial. The parameters are those of `identify`.

    A trial with fewer than 10 points per segment is not divided; a remark says so. Raises DataError, with the name of
    the trial, if a column is missing or the points cannot be used.
    """
    points, motion, remarks = _points(record, plane, skip_mm)
    other, other_depth = _other_plane(record, plane, skip_mm)
    depth = motion.depth_mm if "depth_mm" in record.columns else None
    try:
        path = entry_path(points, depth, PathShape(), record.trial, noise=noise, correlation_mm=correlation_mm)
        parts: tuple[Curvature, ...] = ()
        changes: tuple[CurvatureChange, ...] = ()
        if segments > 1 and len(points) >= segments * _POINTS_A_SEGMENT:
            divided = path.divided(segments, noise=noise, correlation_mm=correlation_mm)
            parts, changes = divided.segments, divided.changes
        elif segments > 1:
            remarks.append(f"{len(points)} points are too few for {segments} segments")
    except DataError as error:
        raise DataError(error.mistakes, record.trial) from None
    prefix = f"{record.trial}: " if record.trial else ""
    return CurvatureTrial(
        record.trial, points, noise, correlation_mm, path, parts, changes, motion, depth, other, other_depth,
        tuple(prefix + remark for remark in remarks),
    )  # fmt: skip


def _points(record: Record, plane: str, skip_mm: float) -> tuple[Array, Motion, list[str]]:
    """Return the points (mm), shape (n, 2), of the insertion, their motion, and remarks about samples left out.

    Raises DataError if no sample is complete, the lateral position is constant, or fewer than 2 samples are left.
    """
    along = record["x_mm"] if "x_mm" in record.columns else record["depth_mm"]
    across = record["y_mm" if plane == "xy" else "z_mm"]
    depth = record.columns.get("depth_mm", along)
    remarks: list[str] = []
    known = np.isfinite(along) & np.isfinite(across) & np.isfinite(depth)
    if not known.any():
        rule = "has no sample in which x_mm (or depth_mm) is a number too"
        raise DataError(Mistake(f"{plane[1]}_mm", "", rule), record.trial)
    if not np.ptp(across[known]):
        rule = "is constant to the last bit: a working tracker does not measure that; check the tracker"
        raise DataError(Mistake(f"{plane[1]}_mm", f"{across[known][0]:g}", rule), record.trial)
    deepest = int(np.argmax(np.where(known, depth, -np.inf)))
    way_in = np.arange(len(record)) <= deepest
    if known.sum() > _LEAST_POINTS and (known & way_in).sum() < _LEAST_POINTS:
        rule = "is largest in the first rows: rows in reverse order, a depth with the wrong sign, or a retraction"
        raise DataError(Mistake("depth_mm", f"{depth[deepest]:.4g} mm", rule), record.trial)
    back = int((known & ~way_in & (depth < depth[deepest] - _BACK)).sum())
    if back:
        remarks.append(f"{back} samples after the greatest depth, drawn back, do not count")
    shallow = known & way_in & (depth < skip_mm)
    if shallow.any():
        remarks.append(f"{int(shallow.sum())} samples above {skip_mm:g} mm do not count")
    kept = known & (way_in | (depth >= depth[deepest] - _BACK)) & ~shallow
    if kept.sum() < 2:
        raise DataError(Mistake("skip_mm", f"{skip_mm:g}", "leaves no path of the insertion: reduce it"), record.trial)
    motion = Motion.sampled(record["time_s"][kept], depth[kept])
    return np.column_stack([along[kept], across[kept]]), motion, remarks


def _other_plane(record: Record, plane: str, skip_mm: float) -> tuple[Array | None, Array | None]:
    """Return points (mm), shape (m, 2), and depths, shape (m,), in the other plane; None if it was not tracked."""
    other = "xz" if plane == "xy" else "xy"
    column = f"{other[1]}_mm"
    if column not in record.columns or "depth_mm" not in record.columns:
        return None, None
    across = record[column][np.isfinite(record[column])]
    if len(across) < 2 * _POINTS_A_SEGMENT or not np.ptp(across):
        return None, None
    points, motion, _ = _points(record, other, skip_mm)
    return points, motion.depth_mm
