"""A partition and the states that depend on it (Fig. 6.3 of the thesis)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needleplan.planning import PolicyTable

__all__ = ["dependent_points", "draw_dependents"]

_CYAN, _RED = "#00bcd4", "#d00000"


def dependent_points(table: PolicyTable, partition: int) -> NDArray[np.bool_]:
    """Return for every grid point [nx, ny] whether one of its states can step into `partition`.

    These are the positions of SDP(p), the state dependents of a partition in Table 6.1 of the thesis, read from the
    explicit form of the problem.
    """
    nx, ny, headings, bevels = table.scenario.shape
    columns, rows = table.scenario.partitions
    labels = np.add.outer(np.arange(nx) * columns // nx * rows, np.arange(ny) * rows // ny).ravel()
    sparse = table.lattice.tabular()
    member = np.append(np.repeat(labels == partition, headings * bevels), False)
    hits = member[sparse["successors"]] & (sparse["probabilities"] > 0)
    # Entries counted up to each row, and rows up to each state: a difference is what a state has of its own.
    entries = np.concatenate([[0], np.cumsum(hits)])[sparse["row_offsets"]][sparse["action_offsets"]]
    steps_in = np.diff(entries)[: nx * ny * headings * bevels] > 0
    reaching: NDArray[np.bool_] = np.logical_or.reduce(steps_in.reshape(nx, ny, headings * bevels), axis=2)
    return reaching


def draw_dependents(axes: Axes, table: PolicyTable, partition: int) -> None:
    """Outline `partition` in red and colour the grid points that depend on it, on top of the order of processing."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    scenario = table.scenario
    dx, dy = scenario.grid.spacing_mm
    points = dependent_points(table, partition)
    axes.imshow(
        np.ma.masked_equal(points.T, False),
        origin="lower",
        extent=(-dx / 2, scenario.x_mm[-1] + dx / 2, -dy / 2, scenario.y_mm[-1] + dy / 2),
        aspect=axes.get_aspect(),
        cmap=ListedColormap([_CYAN]),
        alpha=0.55,
        interpolation="nearest",
        zorder=2,
    )
    columns, rows = scenario.partitions
    column, row = divmod(partition, rows)
    width, height = scenario.workspace.width_mm / columns, scenario.workspace.height_mm / rows
    corner = (column * width, row * height)
    axes.add_patch(Rectangle(corner, width, height, facecolor="none", edgecolor=_RED, linewidth=2.0, zorder=5))
    axes.set_xlim(0, scenario.workspace.width_mm)
    axes.set_ylim(0, scenario.workspace.height_mm)
