"""The probability of reaching the target that a table carries: that of its own grid, or of a finer one.

Bilinear weights spread the tip a little with every step, in proportion to the square of the spacing, and where an
obstacle is near some of what they spread collides: the success of a coarse grid is too dark. The policy that will be
executed need not be looked for on a finer grid to know better what it does; it is enough to evaluate it there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needleplan import _ppvi
from needleplan.planning.lattice import lattice_of
from needleplan.scenario import Scenario

__all__ = ["refined", "success_of"]


def success_of(scenario: Scenario, lattice: _ppvi.Lattice, policy: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the success [nx, ny, headings, 2] of `policy`, of the same shape, at the grid points of `scenario`.

    With `grid.success_refinement` above one, every grid point is divided into that many along x and along y, all of
    them follow the policy of the one that is nearest, as the needle will, and the result is that at the grid points.
    Raises ValueError or MemoryError, as the lattice does.
    """
    times, threads = scenario.grid.success_refinement, scenario.solver.threads
    success: NDArray[np.float32]
    if times == 1:
        success = lattice.success(policy=policy, threads=threads)["success"]
    else:
        fine = refined(scenario)
        nearest = np.ix_(*(
            np.minimum(np.rint(np.arange(points) / times).astype(np.intp), most - 1)
            for points, most in zip(fine.shape[:2], policy.shape[:2], strict=True)
        ))  # fmt: skip
        found = lattice_of(fine).success(policy=np.ascontiguousarray(policy[nearest]), threads=threads)["success"]
        found = found[::times, ::times][: policy.shape[0], : policy.shape[1]]
        # A last point that the finer grid has not lies outside the workspace: no needle succeeds from there.
        success = np.zeros(policy.shape, np.float32)
        success[: found.shape[0], : found.shape[1]] = found
    np.minimum(success, 1, out=success)  # weights in single precision can sum to a little more than one
    return success


def refined(scenario: Scenario) -> Scenario:
    """Return `scenario` on the grid on which its success is computed."""
    grid = scenario.grid
    dx, dy = (spacing / grid.success_refinement for spacing in grid.spacing_mm)
    return replace(scenario, grid=replace(grid, spacing_mm=(dx, dy), success_refinement=1))
