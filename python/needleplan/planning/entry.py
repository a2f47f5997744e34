"""The best pose at which to enter the workspace."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import Mistake, PoseError
from needleplan.planning.pose import Pose, wrapped
from needleplan.scenario.rules import suggestion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning.table import PolicyTable

__all__ = ["Edge", "Entry", "best_entry", "entries"]

_SUCCESS_STEP = 0.001


class Edge(StrEnum):
    """An edge of the workspace: left is x = 0, bottom is y = 0."""

    LEFT = "left"
    RIGHT = "right"
    BOTTOM = "bottom"
    TOP = "top"

    @property
    def inward_rad(self) -> float:
        """Heading in rad that leads straight into the workspace."""
        return {Edge.LEFT: 0.0, Edge.RIGHT: math.pi, Edge.BOTTOM: math.pi / 2, Edge.TOP: -math.pi / 2}[self]


@dataclass(frozen=True)
class Entry:
    """An entry pose with the probability of reaching the target and the expected cost from there."""

    pose: Pose
    success: float
    value: float


def best_entry(table: PolicyTable, edge: str, x_mm: float | None, y_mm: float | None) -> Entry:
    """Return the entry of the highest success, to a tenth of a percent, and among those of the lowest cost."""
    poses = entries(table, edge, x_mm, y_mm)
    looked_up = table.lookup_many(poses)
    success = np.round(looked_up.success / _SUCCESS_STEP)
    inclination = np.abs(poses[:, 2] - Edge(edge).inward_rad)
    best = np.lexsort((inclination, looked_up.value, -success))[0]
    x, y, heading, bevel = poses[best].tolist()
    return Entry(Pose(x, y, wrapped(heading), int(bevel)), float(looked_up.success[best]), float(looked_up.value[best]))


def entries(table: PolicyTable, edge: str, x_mm: float | None, y_mm: float | None) -> NDArray[np.float64]:
    """Return the poses [n, 4] on an edge that lead into the workspace: every grid point, or the one that is given.

    Headings lie within less than a quarter turn of the one straight inward. Raises PoseError.
    """
    if edge not in list(Edge):
        names = ", ".join(f'"{name}"' for name in Edge)
        raise PoseError(Mistake("edge", f'"{edge}"', f"must be one of {names}{suggestion(edge, list(Edge))}"))
    side = Edge(edge)
    scenario = table.scenario
    across = side in (Edge.LEFT, Edge.RIGHT)
    workspace = scenario.workspace
    for name, place, size, fixed in (
        ("x_mm", x_mm, workspace.width_mm, across),
        ("y_mm", y_mm, workspace.height_mm, not across),
    ):
        if place is not None and fixed:
            raise PoseError(Mistake(name, str(place), f'must not be given for the edge "{edge}"'))
        if place is not None and not 0 <= place <= size:
            raise PoseError(Mistake(name, str(place), f"must lie in the workspace, from 0 to {size:g} mm"))
    x = scenario.x_mm if x_mm is None else np.array([x_mm])
    y = scenario.y_mm if y_mm is None else np.array([y_mm])
    if across:
        x = np.array([0.0 if side is Edge.LEFT else workspace.width_mm])
    else:
        y = np.array([0.0 if side is Edge.BOTTOM else workspace.height_mm])
    turned = np.remainder(scenario.headings_rad - side.inward_rad + math.pi, 2 * math.pi) - math.pi
    headings = side.inward_rad + turned[np.abs(turned) < math.pi / 2 - 1e-9]
    grid = np.meshgrid(x, y, headings, np.array([-1.0, 1.0]), indexing="ij")
    return np.stack([axis.ravel() for axis in grid], axis=1)
