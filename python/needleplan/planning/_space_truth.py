"""Errors of the entry in 3D, and executions where the plan is wrong."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy import OUTSIDE
from needleplan.planning._coded import Outcome
from needleplan.planning._space_path import normals, valid_poses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan import _ppvi
    from needleplan.anatomy import SpaceScenario
    from needleplan.planning._promise import Truths
    from needleplan.planning._space_part import PartialSpace

__all__ = ["reached_in_space", "scattered_space_poses"]

# Largest way of a shifted entry point along the needle to the skin, relative to its shift: that of a skin at 63 degrees
# to the plane across the needle. Two spacings more are for the voxels of the skin.
_WAY_PER_SHIFT, _MORE = 2.0, 2.0
# Step along this way, in spacings.
_STEP = 0.5


def scattered_space_poses(
    scenario: SpaceScenario, pose: NDArray[np.float64], shift_mm: NDArray[np.float64], tilt_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return poses of the entry that are shifted and tilted about the two axes across the needle, shape (n, 6).

    A point outside of the body slides along the needle to the skin. Poses that then lie outside of the body, of the
    lattice or of the cone are NaN.

    Parameters
    ----------
    scenario : SpaceScenario
        Scenario in 3D.
    pose : numpy.ndarray
        Position (mm) and unit tangent of the entry, shape (6,).
    shift_mm, tilt_rad : numpy.ndarray
        Shifts and tilts, shape (n, 2) each.

    Returns
    -------
    numpy.ndarray
    """
    tangents = np.repeat(pose[None, 3:], 2, 0)
    across = normals(tangents, np.array([0.0, math.pi / 2]))
    poses = np.repeat(pose[None], len(shift_mm), 0)
    poses[:, :3] += shift_mm @ across
    angle = np.hypot(*tilt_rad.T)
    tilted = angle > 0
    sideways = tilt_rad[tilted] @ across / angle[tilted, None]
    poses[tilted, 3:] = np.cos(angle[tilted])[:, None] * pose[3:] + np.sin(angle[tilted])[:, None] * sideways
    spacing, grid = scenario.grid.frame.spacing_mm, scenario.grid
    most = _WAY_PER_SHIFT * np.hypot(*shift_mm.T) + _MORE * spacing
    ways = np.arange(0.0, most.max() + _STEP * spacing, _STEP * spacing)
    points = poses[:, None, :3] + ways[:, None] * poses[:, None, 3:]
    inside = (scenario.codes(points) != OUTSIDE) & (ways <= most[:, None])
    first = inside.argmax(1)
    poses[:, :3] = points[np.arange(len(poses)), first]
    poses[~(inside.any(1) & valid_poses(grid, scenario.cone_rad, poses))] = math.nan
    return poses


def reached_in_space(
    solved: _ppvi.SolvedSpace | PartialSpace,
    scenario: SpaceScenario,
    starts: NDArray[np.float64],
    truths: Truths,
    seed: int,
) -> NDArray[np.bool_]:
    """Return which executions reach the target, one from each start; those from a start of NaN do not.

    Parameters
    ----------
    solved : needleplan._ppvi.SolvedSpace or PartialSpace
        The tables.
    scenario : SpaceScenario
        Their scenario.
    starts : numpy.ndarray
        Positions (mm) and unit tangents, shape (n, 6).
    truths : Truths
        Rigid motions from believed to true positions, true curvatures, and distance of the coil.
    seed : int
        Seed of the tip noise.

    Returns
    -------
    numpy.ndarray
        Shape (n,).
    """
    known = ~np.isnan(starts[:, 0])
    if not known.any():
        return known
    places = np.where(known[:, None], starts, starts[known.argmax()])
    motions, ratios, coil_mm = truths
    rows = np.column_stack([motions.reshape(-1, 12), ratios, np.full(len(ratios), coil_mm)])
    outcomes = solved.true_outcomes(places, rows, center_mm=scenario.target_mm, seed=seed)
    return np.asarray(known & (outcomes == Outcome.TARGET.code))
