"""Paths of needles through the voxels of a file: what they touch, and how near they come."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.voxel_chords import OUTSIDE, Path, chords, visits
from tests.blind.voxel_distance import Array, Indices, nearest_boxes

OBSTACLE, TARGET = 2, 4  # bits of a voxel's code


@dataclass(frozen=True)
class Ball:
    """A ball in patient coordinates."""

    center_mm: tuple[float, float, float]
    radius_mm: float


@dataclass(frozen=True)
class Volume:
    """Labels (ni, nj, nk), the affine from voxel indices to RAS mm, and the numbers of the obstacles.

    Raises ValueError if the axes are not perpendicular.
    """

    labels: NDArray[np.integer]
    affine: Array
    obstacles: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        directions = self.affine[:3, :3] / self.spacing
        if np.abs(directions.T @ directions - np.eye(3)).max() > 1e-4:
            raise ValueError("the axes of the voxels are not perpendicular")

    @property
    def spacing(self) -> Array:
        """Sizes of a voxel in mm, (3,)."""
        return np.linalg.norm(self.affine[:3, :3], axis=0)

    @property
    def solid(self) -> NDArray[np.bool_]:
        """The obstacle voxels."""
        return np.isin(self.labels, self.obstacles)

    def local(self, points: Array) -> Array:
        """Index times voxel size of RAS points, (n, 3): rigidly moved, with boxes along the axes."""
        return np.linalg.solve(self.affine[:3, :3], (points - self.affine[:3, 3]).T).T * self.spacing


@dataclass(frozen=True)
class Traces:
    """What n paths met. Lengths are along a path from its first point; inf (voxel -1, point nan): nothing was met."""

    length_mm: Array
    curvature_1_mm: Array  # largest of the path's arcs
    kink_rad: Array  # largest angle between the end tangent of an arc and the tangent of the pose there
    touches: NDArray[np.bool_]
    first_mm: Array
    first_point: Array  # (n, 3), RAS mm
    first_voxel: Indices  # (n, 3)
    first_label: Indices
    inside_mm: Array  # length within obstacle voxels
    leaves_mm: Array  # where the path first leaves the volume
    ends_in_target: NDArray[np.bool_]
    target_mm: Array  # where the path first meets the target
    nearest_mm: Array  # distance to the nearest obstacle voxel's box, inf beyond the reach
    nearest_at_mm: Array
    body_overlaps: NDArray[np.bool_]  # nearest_mm < diameter / 2


def _first(path: Indices, at_mm: Array, paths: int) -> tuple[Array, Indices]:
    """Smallest length of each path among visits, and the visit; inf and -1 without one."""
    order = np.lexsort((at_mm, path))
    numbers, place = np.unique(path[order], return_index=True)
    first_mm, visit = np.full(paths, np.inf), np.full(paths, -1)
    first_mm[numbers], visit[numbers] = at_mm[order[place]], order[place]
    return first_mm, visit


def _ball_entries(start: Array, end: Array, ball: Ball) -> Array:
    """Share of each segment at which it meets the ball, inf where it does not."""
    course, offset = end - start, start - np.asarray(ball.center_mm)
    square, half = (course**2).sum(1), (course * offset).sum(1)
    rest = (offset**2).sum(1) - ball.radius_mm**2
    root = half**2 - square * rest
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (-half - np.sqrt(root)) / square
    meets = (root >= 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.where(rest <= 0.0, 0.0, np.where(meets, share, np.inf))


def trace(
    volume: Volume,
    paths: Sequence[Path],
    target: Ball | int | None = None,
    diameter_mm: float = 0.0,
    reach_mm: float = 2.0,
) -> Traces:
    """Traces paths through a volume.

    Parameters
    ----------
    volume : Volume
        The voxels and the obstacles among their labels.
    paths : sequence of Path
        At least one.
    target : Ball, int or None
        A ball, or the number of a label.
    diameter_mm : float
        The body of the needle is all that is within half of it of the path.
    reach_mm : float
        Distances to obstacles are searched up to here, and at least up to half of the diameter; 0: not searched.

    Returns
    -------
    Traces
        For each path, what it met.
    """
    count = len(paths)
    pieces, curvature, kink = chords(paths)
    start, end = volume.local(pieces.start), volume.local(pieces.end)
    solid = volume.solid
    codes = solid.astype(np.uint8) * OBSTACLE
    if isinstance(target, int):
        codes |= (volume.labels == target).astype(np.uint8) * TARGET
    segment, entered, left, voxel = visits(start / volume.spacing + 0.5, end / volume.spacing + 0.5, codes)
    inside = ((voxel >= 0) & (voxel < codes.shape)).all(1)
    code = np.where(inside, codes[tuple(np.where(inside[:, None], voxel, 0).T)], OUTSIDE)
    place = pieces.before_mm[segment] + entered * pieces.length_mm[segment]

    def first(bit: int) -> tuple[Array, Indices]:
        chosen = np.flatnonzero(code & bit)
        at_mm, visit = _first(pieces.path[segment[chosen]], place[chosen], count)
        return at_mm, np.where(visit >= 0, chosen[visit] if chosen.size else -1, -1)

    first_mm, visit = first(OBSTACLE)
    touches = visit >= 0
    point, first_voxel, label = np.full((count, 3), np.nan), np.full((count, 3), -1), np.full(count, -1)
    hit = visit[touches]
    ends = pieces.start[segment[hit]], pieces.end[segment[hit]]
    point[touches] = ends[0] + entered[hit, None] * (ends[1] - ends[0])
    first_voxel[touches] = voxel[hit]
    label[touches] = volume.labels[tuple(voxel[hit].T)]
    blocked = np.flatnonzero(code & OBSTACLE)
    inside_mm = np.bincount(
        pieces.path[segment[blocked]], ((left - entered) * pieces.length_mm[segment])[blocked], minlength=count
    )

    final = np.searchsorted(pieces.path, np.arange(count), side="right") - 1
    ends_in_target, target_mm = np.zeros(count, bool), np.full(count, np.inf)
    if isinstance(target, Ball):
        ends_in_target = np.linalg.norm(pieces.end[final] - np.asarray(target.center_mm), axis=1) <= target.radius_mm
        share = _ball_entries(pieces.start, pieces.end, target)
        met = np.flatnonzero(np.isfinite(share))
        target_mm, _ = _first(pieces.path[met], (pieces.before_mm + share * pieces.length_mm)[met], count)
    elif target is not None:
        target_mm, _ = first(TARGET)
        tip = np.floor(end[final] / volume.spacing + 0.5).astype(int)
        known = ((tip >= 0) & (tip < codes.shape)).all(1)
        ends_in_target[known] = volume.labels[tuple(tip[known].T)] == target

    nearest, at_mm = np.where(touches, 0.0, np.inf), np.where(touches, first_mm, np.inf)
    reach_mm = max(reach_mm, 0.5 * diameter_mm)
    if reach_mm > 0.0:
        searched = np.flatnonzero(~touches[pieces.path])
        distance, chord, share = nearest_boxes(
            start[searched], end[searched], pieces.path[searched], count, solid, volume.spacing, reach_mm
        )
        near = chord >= 0
        chosen = searched[chord[near]]
        nearest[near] = distance[near]
        at_mm[near] = pieces.before_mm[chosen] + share[near] * pieces.length_mm[chosen]
    return Traces(
        length_mm=pieces.before_mm[final] + pieces.length_mm[final],
        curvature_1_mm=curvature,
        kink_rad=kink,
        touches=touches,
        first_mm=first_mm,
        first_point=point,
        first_voxel=first_voxel,
        first_label=label,
        inside_mm=inside_mm,
        leaves_mm=first(OUTSIDE)[0],
        ends_in_target=ends_in_target,
        target_mm=target_mm,
        nearest_mm=nearest,
        nearest_at_mm=at_mm,
        body_overlaps=nearest < 0.5 * diameter_mm,
    )
