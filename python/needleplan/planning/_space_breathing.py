"""The success of entries if the tissue is not where the plan has it, by breathing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import SpaceScenario, grids_of
from needleplan.errors import Mistake, ScenarioError
from needleplan.planning._coded import Outcome
from needleplan.planning._promise import PROMISED_RUNS, share_of
from needleplan.planning._space_part import PartialSpace
from needleplan.planning._space_problem import space_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from needleplan.anatomy import Anatomy
    from needleplan.planning._space_table import SpaceTable
    from needleplan.planning._success import Success

__all__ = ["ResidualSuccess", "success_in_breath"]

# Largest displacements (mm) of the tissue by residual breathing for which `entry` estimates the success.
_RESIDUALS_MM = (0.0, 2.5, 5.0, 7.5, 10.0)
# A motion that moves nothing, and the planned curvature: what executions in another anatomy believe.
_AS_BELIEVED = np.array([1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0])


@dataclass(frozen=True)
class ResidualSuccess:
    """The success of entries with a residual of breathing.

    Attributes
    ----------
    residual_mm : float
        Largest displacement (mm) of the tissue from its place in the plan.
    level : float
        Level of inspiration, from 0 to 1.
    entries : tuple of Success
        Success of each entry.
    """

    residual_mm: float
    level: float
    entries: tuple[Success, ...]

    def record(self, number: int) -> dict[str, Any]:
        """Return the JSON record of an entry.

        Parameters
        ----------
        number : int
            Place of the entry in `entries`.

        Returns
        -------
        dict

        Examples
        --------
        >>> from needleplan.planning import ResidualSuccess, Success
        >>> ResidualSuccess(5.0, 0.25, (Success(0.9),)).record(0)["residual_mm"]
        5.0
        """
        return {"residual_mm": self.residual_mm, "level": self.level, **self.entries[number].record()}


def success_in_breath(
    table: SpaceTable,
    anatomy: Anatomy,
    poses: ArrayLike,
    residuals_mm: Sequence[float] = _RESIDUALS_MM,
    *,
    executions: int = PROMISED_RUNS,
    seed: int = 0,
) -> list[ResidualSuccess]:
    """Estimate the success of entries in the anatomy at other levels of inspiration, by executions of one table.

    The controller decides by the plan, and the anatomy is displaced (docs/explanation/promise.md). All levels have the
    same random numbers.

    Parameters
    ----------
    table : SpaceTable
        Table of the anatomy.
    anatomy : Anatomy
        Anatomy with the section `[breathing]`.
    poses : array_like
        Entries: positions (mm) and unit tangents in the frame of the lattice, shape (n, 6).
    residuals_mm : sequence of float, optional
        Largest displacements (mm) of tissue; those above the motion of the anatomy are left out. Default: 0 to 10 mm.
    executions : int, default 2000
        Number of executions for each success.
    seed : int, default 0
        Seed of the tip noise.

    Returns
    -------
    list of ResidualSuccess

    Raises
    ------
    ScenarioError
        If the anatomy has no section `[breathing]`, or the table is a part of one.
    """
    breathing, solved, frame = anatomy.file.breathing, table.solved, table.scenario.grid.frame
    if breathing is None or isinstance(solved, PartialSpace):
        raise ScenarioError(Mistake("breathing", "", "is missing: how the tissue moves"), anatomy.source)
    exhaled = replace(anatomy.exhaled or anatomy, file=table.scenario.file)  # one of several targets
    rows, successes = np.asarray(poses, np.float64).reshape(-1, 6), []
    truths = np.repeat(_AS_BELIEVED[None], executions, 0)
    for residual_mm in residuals_mm:
        if (level := breathing.level_for(residual_mm)) is None:
            continue
        (grid,) = grids_of(exhaled.inspired(level, frame.corners_mm), frame)
        space = space_of(SpaceScenario(table.scenario.file, grid))
        reached = [
            solved.true_outcomes(
                np.repeat(row[None], executions, 0), truths, center_mm=table.scenario.target_mm, seed=seed,
                anatomy=space,
            ) == Outcome.TARGET.code
            for row in rows
        ]  # fmt: skip
        successes.append(ResidualSuccess(residual_mm, level, tuple(share_of(arrivals) for arrivals in reached)))
    return successes
