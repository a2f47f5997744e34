"""Executions of a policy in 3D as arrays, and the steps of a needle as guidance predicts them.

The executions are compiled (`rust/needle/src/space`). A step with roll angle a turns the tangent d towards
n = cos(a) e1 + sin(a) e2, where e1 and e2 are y and z after the rotation of the axis to d on the shortest way. Over the
length s, with the curvature c,

    p' = p + d sin(cs)/c + n (1 - cos(cs))/c,    d' = d cos(cs) + n sin(cs),    n' = n cos(cs) - d sin(cs).

The step ends at its plane. A predicted step is made of pieces of at most a quarter of the spacing, each with the
curvature at its start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy import OBSTACLE, OUTSIDE, TARGET, crossed_voxels
from needleplan.artifacts import ShortRepr
from needleplan.planning._coded import Outcome
from needleplan.planning._drawing import draw_path
from needleplan.planning._space_pose import SpacePose
from needleplan.plotting import axes_or_new, legend_below, picture_html

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from needleplan import _ppvi
    from needleplan.anatomy import AnatomyGrid, SpaceScenario
    from needleplan.planning._space_part import PartialSpace

__all__ = [
    "SpacePath",
    "SpacePaths",
    "bend_direction",
    "codes_along",
    "normals",
    "space_paths",
    "step_points",
    "valid_poses",
]

# Largest length of a piece, in spacings.
_PIECE = 0.25
# Smallest advance of a piece along the axis, as a share of its length: the cosine of the widest cone, 75 degrees, less
# the turn of a step.
_LEAST_ADVANCE = 0.1
# Iterations of Newton's method for the length to a plane; it converges quadratically.
_NEWTON = 5


@dataclass(frozen=True, eq=False, repr=False)
class SpacePath:
    """One execution of a policy in 3D.

    - `poses`: positions in the frame (mm) and tangents, shape (k, 6).
    - `turns`: poses directly before the rotations of the needle, shape (turns, 6).
    - `outcome`, `length_mm`, `straight_mm`, `cost`: as of a planar `Path`.
    - `clearance_mm`: smallest distance to an obstacle.
    - `scenario`: the scenario in which the policy was executed.
    """

    poses: NDArray[np.float64]
    turns: NDArray[np.float64]
    outcome: Outcome
    length_mm: float
    cost: float
    clearance_mm: float
    scenario: SpaceScenario
    straight_mm: float = 0.0

    @property
    def start(self) -> SpacePose:
        """The first pose."""
        return SpacePose(*self.poses[0].tolist())

    @property
    def end(self) -> SpacePose:
        """The last pose."""
        return SpacePose(*self.poses[-1].tolist())

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """Positions in the frame (mm), shape (k, 3)."""
        return self.poses[:, :3]

    def plot(self, ax: Axes | None = None, *, scene: bool = True, label: str = "without noise") -> Axes:
        """Draw the execution, seen along z, with a circle at every rotation.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes. Default: the axes of a new figure.
        scene : bool, default True
            Whether to draw the slice through the target first.
        label : str, default "without noise"
            Label in the legend.

        Returns
        -------
        matplotlib.axes.Axes
        """
        axes = axes_or_new(ax, self.scenario.workspace)
        if scene:
            self.scenario.plot(axes)
        draw_path(axes, self.poses, self.turns, self.outcome, label)
        if ax is None:
            legend_below(axes)
        return axes

    def _repr_html_(self) -> str:
        return picture_html(self.scenario.workspace, self.plot, repr(self))

    def __repr__(self) -> str:
        straight = f", {self.straight_mm:.1f} mm straight" if self.straight_mm else ""
        return f"<SpacePath: {self.outcome} after {self.length_mm:.1f} mm, {len(self.turns)} turns{straight}>"


@dataclass(frozen=True, eq=False)
class SpacePaths(ShortRepr):
    """Executions from n poses. All arrays but `poses`, `bounds` and `turn_rows` have the shape (n,).

    - `reached`: whether the path ends in the target.
    - `outcomes`: codes of `Outcome`.
    - `ends`: code of the voxel that ended the path, as in `AnatomyGrid.codes`; `FREE` if the tangent has left the cone.
    - `length_mm`, `straight_mm`: length of the path, and length of its straight steps.
    - `turns`: number of changes of the roll angle.
    - `clearance_mm`: smallest distance to an obstacle.
    - `cost`: sum of all costs.
    - `poses`: positions in the frame (mm) and tangents, all paths one after the other, shape (m, 6); path k has the
      rows from `bounds[k]` to `bounds[k + 1]`.
    - `turn_rows`: rows of `poses` directly before a rotation of the needle.
    """

    reached: NDArray[np.bool_]
    outcomes: NDArray[np.uint8]
    ends: NDArray[np.int64]
    length_mm: NDArray[np.float64]
    straight_mm: NDArray[np.float64]
    turns: NDArray[np.int64]
    clearance_mm: NDArray[np.float64]
    cost: NDArray[np.float64]
    poses: NDArray[np.float64]
    turn_rows: NDArray[np.int64]
    bounds: NDArray[np.int64]

    def points(self, number: int) -> NDArray[np.float64]:
        """Return the positions of one path in the frame (mm), shape (m, 3)."""
        return self.poses[self.bounds[number] : self.bounds[number + 1], :3]

    def path(self, number: int, scenario: SpaceScenario) -> SpacePath:
        """Return one path.

        Parameters
        ----------
        number : int
            Number of the path.
        scenario : SpaceScenario
            Scenario in which the policy was executed.

        Returns
        -------
        SpacePath
        """
        first, last = self.bounds[number : number + 2]
        is_own = (self.turn_rows >= first) & (self.turn_rows < last)
        return SpacePath(
            poses=self.poses[first:last],
            turns=self.poses[self.turn_rows[is_own]],
            outcome=Outcome(int(self.outcomes[number])),
            length_mm=float(self.length_mm[number]),
            cost=float(self.cost[number]),
            clearance_mm=float(self.clearance_mm[number]),
            scenario=scenario,
            straight_mm=float(self.straight_mm[number]),
        )


def valid_poses(grid: AnatomyGrid, cone_rad: float, poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which poses, (n, 6), lie in the grid and in the cone."""
    voxel = np.floor(poses[:, :3] / grid.voxel_mm + 0.5)
    within = ((voxel >= 0) & (voxel < grid.voxels.shape)).all(-1)
    return np.asarray(within & (np.arctan2(np.hypot(poses[:, 4], poses[:, 5]), poses[:, 3]) <= cone_rad))


def space_paths(
    solved: _ppvi.SolvedSpace | PartialSpace, grid: AnatomyGrid, poses: NDArray[np.float64], seed: int | None = None
) -> SpacePaths:
    """Return the executions from n poses, shape (n, 6): position in the frame (mm) and unit tangent.

    Without `seed`, the executions have no noise. With `seed`, they have the noise of the first n runs of a rollout.
    """
    executed = solved.paths(poses, seed=seed)
    ends, bounds = executed["end"].astype(np.int64), executed["bounds"]
    clearance = grid.clearance_at(executed["poses"][:, :3])
    return SpacePaths(
        reached=ends == TARGET,
        outcomes=executed["outcome"],
        ends=ends,
        length_mm=executed["length_mm"],
        straight_mm=executed["straight_mm"],
        turns=executed["turns"].astype(np.int64),
        clearance_mm=np.minimum.reduceat(clearance, bounds[:-1]) if len(ends) else np.zeros(0),
        cost=executed["cost"],
        poses=executed["poses"],
        turn_rows=executed["turn_rows"],
        bounds=bounds,
    )


def bend_direction(tangent: Sequence[float], roll_rad: float) -> tuple[float, float, float]:
    """Return the direction to which the needle bends at a roll angle of the policy.

    Parameters
    ----------
    tangent : sequence of float
        Unit tangent of the path, of length 3.
    roll_rad : float
        Roll angle (rad).

    Returns
    -------
    tuple of float
        Unit vector across the tangent.
    """
    x, y, z = normals(np.array([tangent], np.float64), np.array([roll_rad]))[0].tolist()
    return x, y, z


def step_points(
    scenario: SpaceScenario, pose: Sequence[float], directions: ArrayLike, scales: ArrayLike, advance: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points along k steps from a pose to a plane.

    Parameters
    ----------
    scenario : SpaceScenario
        Scenario in 3D.
    pose : sequence of float
        Position (mm) and unit tangent, of length 6.
    directions : array_like
        Unit vectors to which the needle bends, shape (k, 3).
    scales : array_like
        Factors of the planned curvature, shape (k,); 0 for a straight step.
    advance : int
        Number of slices from the slice nearest to the pose to the plane.

    Returns
    -------
    tuple of numpy.ndarray
        Lengths (mm), shape (k, n), and points (mm), shape (k, n, 3). After the end of a step, its last point is
        repeated.
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


def _codes_of(grid: AnatomyGrid, voxels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the codes of voxels, shape (..., 3); outside beyond the grid."""
    shape = np.array(grid.voxels.shape)
    within = ((voxels >= 0) & (voxels < shape)).all(-1)
    at = tuple(np.moveaxis(np.clip(voxels, 0, shape - 1), -1, 0))
    return np.where(within, grid.voxels[at].astype(np.int64), OUTSIDE)


def codes_along(scenario: SpaceScenario, points_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the voxel codes of `AnatomyGrid` at points along paths.

    The segment from the previous point must be free, too: if it crosses a voxel that is not passable, the point has the
    code of this voxel (obstacle or outside).

    Parameters
    ----------
    scenario : SpaceScenario
        Scenario in 3D.
    points_mm : numpy.ndarray
        Points along k paths (mm), shape (k, n, 3).

    Returns
    -------
    numpy.ndarray
        Codes of `AnatomyGrid`, shape (k, n).
    """
    grid = scenario.grid
    points = points_mm / grid.voxel_mm
    codes = scenario.codes(points_mm).astype(np.int64)
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


def _pieces(
    poses: NDArray[np.float64],
    normal: NDArray[np.float64],
    curvature: NDArray[np.float64],
    plane_mm: NDArray[np.float64],
    longest_mm: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the lengths (mm) of the next pieces, shape (k,), and whether each piece ends at its plane, shape (k,)."""
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
