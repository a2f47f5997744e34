"""Drawings on axes that already show a scenario: executions, the success map, and the order of the partitions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy import FREE
from needleplan.errors import InputError, Mistake
from needleplan.planning._coded import Outcome
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, colour_bar, title
from needleplan.scenario import Method

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needleplan.anatomy import AnatomyGrid
    from needleplan.scenario import Scenario

__all__ = ["draw_noisy", "draw_partition_order", "draw_path", "draw_success", "draw_success_slice"]

_END_MARKERS = {Outcome.COLLISION: "X", Outcome.EXIT: "X", Outcome.STEP_LIMIT: "P"}

# Code of the lattice for a grid point inside an obstacle.
_IN_OBSTACLE = 4

# Largest number of partitions along x for which the small partition numbers are drawn; more are not legible.
_MOST_NUMBERED = 16


def draw_path(
    axes: Axes,
    poses: NDArray[np.float64],
    turns: NDArray[np.float64],
    outcome: Outcome,
    label: str,
    straight: Sequence[int] | NDArray[np.int64] = (),
) -> None:
    """Draw one execution: path, thick straight steps, a green circle at each rotation, and a mark where it failed.

    `poses` and `turns` begin with x and y (mm); `straight` are the rows of `poses` before straight steps.
    """
    for run in np.split(straight, np.flatnonzero(np.diff(straight) > 1) + 1) if len(straight) else ():
        begin = run[0] == straight[0]
        ends = poses[run[0] : run[-1] + 2, :2]
        name = f"straight steps ({len(straight)})" if begin else None
        axes.plot(*ends.T, color=ORANGE, linewidth=5, solid_capstyle="butt", zorder=3, label=name)
    axes.plot(*poses[:, :2].T, color=BLUE, linewidth=1.8, zorder=4, label=label)
    axes.plot(poses[0, 0], poses[0, 1], marker=">", markersize=7, color=BLUE, zorder=5, clip_on=False)
    if len(turns):
        axes.plot(
            *turns[:, :2].T,
            linestyle="none",
            marker="o",
            markersize=6,
            markerfacecolor="white",
            markeredgecolor=GREEN,
            markeredgewidth=1.6,
            zorder=7,
            label=f"turns ({len(turns)})",
        )
    if outcome in _END_MARKERS:
        # The end of an exit lies outside the workspace; its mark is drawn on the edge.
        axes.plot(
            min(max(poses[-1, 0], 0), axes.get_xlim()[1]),
            min(max(poses[-1, 1], 0), axes.get_ylim()[1]),
            linestyle="none",
            marker=_END_MARKERS[outcome],
            markersize=8,
            color=VERMILLION,
            zorder=7,
            clip_on=False,
            label=str(outcome),
        )


def draw_noisy(axes: Axes, reached: Sequence[NDArray[np.float64]], failed: Sequence[NDArray[np.float64]]) -> None:
    """Draw executions as thin lines. `reached` and `failed` are the poses of successful and of failed executions."""
    for group, colour, word in ((failed, GREY, "failed"), (reached, SKY, "reached the target")):
        for poses in group:
            axes.plot(*poses[:, :2].T, color=colour, linewidth=0.5, alpha=0.6, zorder=2)
        if group:
            axes.plot([], [], color=colour, linewidth=0.8, label=f"with tip noise, {word} ({len(group)})")


def draw_success(
    axes: Axes,
    scenario: Scenario,
    success: NDArray[np.float32],
    outcomes: NDArray[np.uint8],
    heading_rad: float | None,
) -> None:
    """Draw a map of the success probability for one heading, or for the best heading if None, with the better bevel.

    `success` and the lattice's `outcomes` of the grid points are [nx, ny, headings, 2].
    """
    if heading_rad is None:
        shown = success.max(axis=(2, 3))
        title(axes, "Success probability at the best heading")
    else:
        heading = round(heading_rad / (2 * math.pi) * scenario.motion.headings) % scenario.motion.headings
        shown = success[:, :, heading].max(axis=2)
        title(axes, f"Success probability at {math.degrees(heading_rad):.3g} deg")
    dx, dy = scenario.grid.spacing_mm
    x, y = scenario.x_mm, scenario.y_mm
    image = axes.imshow(
        np.ma.masked_where(outcomes[:, :, 0, 0] == _IN_OBSTACLE, shown).T,
        origin="lower",
        extent=(-dx / 2, x[-1] + dx / 2, -dy / 2, y[-1] + dy / 2),
        aspect=axes.get_aspect(),
        cmap="cividis",
        vmin=0,
        vmax=1,
        interpolation="nearest",
    )
    axes.set_xlim(0, scenario.workspace.width_mm)
    axes.set_ylim(0, scenario.workspace.height_mm)
    colour_bar(axes, image, "probability")
    axes.plot(*scenario.target.center_mm, marker="+", color=VERMILLION, zorder=6)


def draw_success_slice(axes: Axes, grid: AnatomyGrid, number: int, success: NDArray[np.float64]) -> None:
    """Draw success, shape (nx, ny), over the free points of the slice `number` across z, as a colour map."""
    spacing, (nx, ny, _) = grid.frame.spacing_mm, grid.frame.shape
    extent = (-spacing / 2, (nx - 0.5) * spacing, -spacing / 2, (ny - 0.5) * spacing)
    image = axes.imshow(
        np.ma.masked_where(grid.codes[:, :, number] != FREE, success).T,
        origin="lower", extent=extent, aspect=axes.get_aspect(), cmap="cividis", vmin=0, vmax=1,
        interpolation="nearest",
    )  # fmt: skip
    title(axes, f"Success probability in the best direction, slice z = {number * spacing:.0f} mm")
    colour_bar(axes, image, "probability")


def draw_partition_order(axes: Axes, scenario: Scenario, order: Sequence[int]) -> None:
    """Draw the partitions, each with its position in the order of processing (large) and its number (small).

    Partitions that were never processed are grey. Raises InputError for a table that was not solved by partitions.
    """
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle

    if scenario.solver.method is not Method.PPVI:
        rule = 'must be "ppvi" for this figure; the other methods have no partitions'
        raise InputError(Mistake("solver.method", f'"{scenario.solver.method}"', rule))
    columns, rows = scenario.partitions
    width, height = scenario.workspace.width_mm / columns, scenario.workspace.height_mm / rows
    positions = {partition: position for position, partition in enumerate(order, start=1)}
    shade = colormaps["Blues"]
    size = min(9.0, 110 / max(columns, rows))
    for partition in range(columns * rows):
        column, row = divmod(partition, rows)
        position = positions.get(partition)
        fill = "#e6e6e6" if position is None else shade(0.6 * (1 - position / (len(positions) + 1)))
        corner = (column * width, row * height)
        axes.add_patch(Rectangle(corner, width, height, facecolor=fill, edgecolor="white", linewidth=0.6, zorder=1))
        if position is not None:
            middle = (corner[0] + width * 0.46, corner[1] + height * 0.55)
            axes.text(*middle, str(position), ha="center", va="center", fontsize=size, color=BLACK, zorder=4)
        if columns <= _MOST_NUMBERED:
            end = (corner[0] + width * 0.95, corner[1] + height * 0.07)
            axes.text(*end, str(partition + 1), ha="right", va="bottom", fontsize=size * 0.6, color=BLUE, zorder=4)
    for patch in axes.patches[: len(scenario.obstacles)]:
        patch.set(facecolor="none", edgecolor=GREY, linewidth=1.2)
    title(axes, f"Order of processing: {len(positions)} of {columns * rows} partitions")
