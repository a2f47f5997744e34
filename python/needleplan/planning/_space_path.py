"""Executions of a policy in 3D, for many entries at once, without noise or with that of the plan.

A step with roll angle a turns the tangent d towards n = cos(a) e1 + sin(a) e2, where e1 and e2 are y and z after the
rotation of the axis to d on the shortest way. Over the length s, with the curvature c,

    p' = p + d sin(cs)/c + n (1 - cos(cs))/c,    d' = d cos(cs) + n sin(cs),    n' = n cos(cs) - d sin(cs).

The step ends at its plane. It is made of pieces of at most a quarter of the spacing, each with the curvature at its
start, and ends early at the face of the first voxel that is not free: all voxels that the chord of a piece crosses are
tested. In a voxel of the target, it ends at the middle of the chord. The chord is within 1 / 128 of the spacing squared
over the radius of the arc. Noise disturbs the tangent before and after each piece, with half of its variance each, and
carries n along.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy import FREE, OBSTACLE, OUTSIDE, TARGET
from needleplan.artifacts import short_repr
from needleplan.planning._crossed import crossed_voxels

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from needleplan import _ppvi
    from needleplan.anatomy import AnatomyGrid, SpaceLattice, SpaceScenario
    from needleplan.planning._space_part import PartialSpace

__all__ = ["SpacePaths", "bend_direction", "codes_along", "normals", "space_paths", "step_points", "valid_poses"]

# Largest length of a piece, in spacings.
_PIECE = 0.25
# Smallest advance of a piece along the axis, as a share of its length: the cosine of the widest cone, 75 degrees, less
# the turn of a step.
_LEAST_ADVANCE = 0.1
# Iterations of Newton's method for the length to a plane; it converges quadratically.
_NEWTON = 5


@dataclass(frozen=True, eq=False)
class SpacePaths:
    """Executions without noise from n entries.

    `reached`: whether the path ends in the target. `ends`: code of the voxel that ended it, as in `AnatomyGrid.codes`;
    `FREE` if the tangent has left the cone. `length_mm`, `rotations`: number of changes of the roll angle.
    `clearance_mm`: smallest distance to an obstacle. All have the shape (n,). `points_mm`: positions in the frame after
    each piece, shape (m, n, 3), NaN after the end.
    """

    reached: NDArray[np.bool_]
    ends: NDArray[np.int64]
    length_mm: NDArray[np.float64]
    rotations: NDArray[np.int64]
    clearance_mm: NDArray[np.float64]
    points_mm: NDArray[np.float64]

    __repr__ = short_repr

    def points(self, number: int) -> NDArray[np.float64]:
        """Return the positions of one path in the frame (mm), shape (m, 3)."""
        found = self.points_mm[:, number]
        return found[np.isfinite(found[:, 0])]


def valid_poses(grid: AnatomyGrid, cone_rad: float, poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which poses, (n, 6), lie in the grid and in the cone."""
    cell = np.floor(poses[:, :3] / grid.frame.spacing_mm + 0.5)
    within = ((cell >= 0) & (cell < grid.frame.shape)).all(-1)
    return np.asarray(within & (np.arctan2(np.hypot(poses[:, 4], poses[:, 5]), poses[:, 3]) <= cone_rad))


def space_paths(
    solved: _ppvi.SolvedSpace | PartialSpace,
    grid: AnatomyGrid,
    lattice: SpaceLattice,
    poses: NDArray[np.float64],
    disturbed: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]] | None = None,
) -> SpacePaths:
    """Return the executions from poses, (n, 6), of position in the frame (mm) and tangent.

    `disturbed` returns tangents, (k, 3), after the noise of lengths (mm), (k,), from tangents; None: without noise.
    """
    spacing, count = grid.frame.spacing_mm, len(poses)
    cone, radii = math.radians(lattice.cone_deg), np.array(grid.radii_mm)
    now, last = poses.copy(), np.full(count, -1)
    length, rotations = np.zeros(count), np.zeros(count, np.int64)
    clearance, ends = np.full(count, np.inf), np.full(count, FREE)
    trail = [now[:, :3].copy()]
    alive = np.flatnonzero(valid_poses(grid, cone, now))
    clearance[alive] = grid.clearance_at(now[alive, :3])
    while len(alive):
        action = solved.decide(now[alive])["action"].astype(int)
        curved = action < lattice.rolls
        rotations[alive] += curved & (last[alive] >= 0) & (last[alive] != action)
        last[alive[curved]] = action[curved]
        normal = normals(now[alive, 3:], 2 * math.pi * action / lattice.rolls)
        advance = round(lattice.step_of(spacing) / spacing)
        plane = (np.floor(now[alive, 0] / spacing + 1e-6) + advance) * spacing
        moving = np.ones(len(alive), bool)
        while moving.any():
            of = alive[moving]
            cell = tuple(grid.nearest_points(now[of, :3]).T)
            curvature = np.where(curved[moving], 1 / radii[grid.tissues[cell]], 0.0)
            piece, ended = _pieces(now[of], normal[moving], curvature, plane[moving], _PIECE * spacing)
            if disturbed is not None:
                now[of, 3:], normal[moving] = _carried(now[of, 3:], normal[moving], disturbed(now[of, 3:], piece / 2))
                piece, ended = _pieces(now[of], normal[moving], curvature, plane[moving], _PIECE * spacing)
            before = now[of, :3]
            now[of], normal[moving] = _moved(now[of], normal[moving], curvature, piece)
            if disturbed is not None:
                now[of, 3:], normal[moving] = _carried(now[of, 3:], normal[moving], disturbed(now[of, 3:], piece / 2))
            code, share = _met(grid, before, now[of, :3])
            now[of, :3] = before + share[:, None] * (now[of, :3] - before)
            length[of] += share * piece
            clearance[of] = np.minimum(clearance[of], grid.clearance_at(now[of, :3]))
            ends[of] = code
            at = np.full((count, 3), np.nan)
            at[of] = now[of, :3]
            trail.append(at)
            still = np.flatnonzero(moving)
            moving[still[ended | (code != FREE)]] = False
            now[of[code != FREE], 3] = -1.0  # out of every cone: the execution has ended
        alive = alive[valid_poses(grid, cone, now[alive])]
    known = np.where(np.isfinite(clearance), clearance, 0.0)
    return SpacePaths(ends == TARGET, ends, length, rotations, known, np.array(trail))


def bend_direction(tangent: Sequence[float], roll_rad: float) -> tuple[float, float, float]:
    """Return the unit vector across a tangent to which the needle bends at a roll angle of the policy."""
    x, y, z = normals(np.array([tangent], np.float64), np.array([roll_rad]))[0].tolist()
    return x, y, z


def step_points(
    scenario: SpaceScenario, pose: Sequence[float], directions: ArrayLike, scales: ArrayLike, advance: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lengths (mm), shape (k, n), and points (mm), shape (k, n, 3), along k steps, from a pose to a plane.

    `pose` is position and tangent, `directions` the unit vectors, shape (k, 3), to which the needle bends, and `scales`
    the factors of the planned curvature, shape (k,); 0 for a straight step. The plane is `advance` slices beyond the
    slice nearest to the pose. After the end of a step, its last point is repeated.
    """
    spacing, normal = scenario.grid.frame.spacing_mm, np.array(directions, np.float64)
    count, factor = len(normal), np.asarray(scales, np.float64)
    now = np.repeat(np.array([pose], np.float64), count, 0)
    plane = (np.floor(now[:, 0] / spacing + 0.5) + advance) * spacing
    length, moving = np.zeros(count), np.ones(count, bool)
    lengths, points = [length.copy()], [now[:, :3].copy()]
    # A step is at most this long within any cone; a tip that has turned out of it never reaches the plane.
    for _ in range(math.ceil((advance + 0.5) / (_PIECE * _LEAST_ADVANCE))):
        curvature = factor * scenario.curvature_per_mm(now[:, :3])
        piece, ended = _pieces(now, normal, curvature, plane, _PIECE * spacing)
        piece = np.where(moving, piece, 0.0)
        now, normal = _moved(now, normal, curvature, piece)
        length = length + piece
        lengths.append(length)
        points.append(now[:, :3].copy())
        moving &= ~ended
        if not moving.any():
            break
    return np.stack(lengths, 1), np.stack(points, 1)


def _met(
    grid: AnatomyGrid, start: NDArray[np.float64], end: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return what segments between positions (mm) meet: code, and share of the segment before it.

    The code is that of the first voxel that is not free, or free, with the share 1.
    """
    voxels, shares = crossed_voxels(start / grid.voxel_mm, end / grid.voxel_mm)
    codes = _codes_of(grid, voxels)
    is_met = codes != FREE
    first = np.where(is_met.any(-1), is_met.argmax(-1), codes.shape[1] - 1)
    row = np.arange(len(start))
    share = np.where(is_met.any(-1), shares[row, first], 1.0)
    # A path that enters the target ends within it, and not on the face of its first voxel.
    leaves = np.concatenate([shares[:, 1:], np.ones((len(start), 1))], -1)[row, first]
    enters = (codes[row, first] == TARGET) & (first > 0)
    share = np.where(enters, (share + np.minimum(leaves, 1.0)) / 2, share)
    return codes[row, first], np.clip(share, 0.0, 1.0)


def _codes_of(grid: AnatomyGrid, voxels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the codes of voxels, shape (..., 3); outside beyond the grid."""
    shape = np.array(grid.voxels.shape)
    within = ((voxels >= 0) & (voxels < shape)).all(-1)
    at = tuple(np.moveaxis(np.clip(voxels, 0, shape - 1), -1, 0))
    return np.where(within, grid.voxels[at].astype(np.int64), OUTSIDE)


def codes_along(scenario: SpaceScenario, points_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return what is at points along paths, shape (k, n, 3): the codes of `AnatomyGrid`, shape (k, n).

    A point from which the voxels back to the point before are not all passable has the code of an obstacle, or outside.
    """
    grid = scenario.grid
    points = points_mm / grid.voxel_mm
    codes = _codes_of(grid, np.floor(points + 0.5).astype(np.int64))
    voxels, _ = crossed_voxels(points[:, :-1].reshape(-1, 3), points[:, 1:].reshape(-1, 3))
    passed = _codes_of(grid, voxels).reshape(*codes[:, 1:].shape, -1)
    for code in (OUTSIDE, OBSTACLE):
        codes[:, 1:][(passed == code).any(-1)] = code
    return codes


def normals(tangents: NDArray[np.float64], roll: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vectors across tangents at roll angles (rad)."""
    x, y, z = tangents.T
    share = 1 / (1 + x)
    first = np.stack([-y, 1 - y * y * share, -y * z * share], -1)
    second = np.stack([-z, -y * z * share, 1 - z * z * share], -1)
    return np.asarray(np.cos(roll)[:, None] * first + np.sin(roll)[:, None] * second)


def _carried(
    tangents: NDArray[np.float64], normal: NDArray[np.float64], turned: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the turned tangents, and the normals after the shortest rotations to them."""
    total = tangents + turned
    share = (total * normal).sum(-1) / (1 + (tangents * turned).sum(-1))
    carried = normal - share[:, None] * total
    return turned, carried / np.linalg.norm(carried, axis=-1)[:, None]


def _pieces(
    poses: NDArray[np.float64],
    normal: NDArray[np.float64],
    curvature: NDArray[np.float64],
    plane_mm: NDArray[np.float64],
    longest_mm: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the lengths of the next pieces, and which of them end at their plane."""
    s = (plane_mm - poses[:, 0]) / np.maximum(poses[:, 3], 0.05)
    for _ in range(_NEWTON):
        moved, _ = _moved(poses, normal, curvature, np.clip(s, 0, 2 * longest_mm))
        s = np.clip(s, 0, 2 * longest_mm) + (plane_mm - moved[:, 0]) / np.maximum(moved[:, 3], 0.05)
    return np.clip(s, 0.0, longest_mm), s <= longest_mm


def _moved(
    poses: NDArray[np.float64], normal: NDArray[np.float64], curvature: NDArray[np.float64], length: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return poses and normals after arcs of these lengths."""
    turn = curvature * length
    sine, cosine = np.sin(turn)[:, None], np.cos(turn)[:, None]
    ahead = (length * np.sinc(turn / math.pi))[:, None]
    aside = (length * np.sinc(turn / (2 * math.pi)) * np.sin(turn / 2))[:, None]
    tangent = poses[:, 3:]
    position = poses[:, :3] + tangent * ahead + normal * aside
    turned = tangent * cosine + normal * sine
    return np.concatenate([position, turned], -1), normal * cosine - tangent * sine
