"""Figure of an insertion: planned and executed path, deviation, and axial force.

Figure of a 3D insertion: three orthogonal slices, a 3D view, deviation and axial force.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import draw_bodies, draw_near, draw_slice, slice_note, slice_widths, target_slices
from needleplan.control import InsertionReport
from needleplan.planning import Action, PolicyTable, SpaceTable, vtp_bytes
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, legend_below, title

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

__all__ = ["insertion_figure", "insertion_vtp", "space_insertion_figure"]


# Zoom of the 3D view: its panel is small beside its labels.
_VIEW_ZOOM = 0.72


def space_insertion_figure(
    table: SpaceTable, report: InsertionReport, true_tip_mm: tuple[float, float, float] | None = None
) -> Figure:
    """Return a matplotlib figure of an insertion: planned and executed path in slices through the target and in 3D.

    `table` is the policy table at the start of the insertion. `true_tip_mm` is the true final position of the tip in
    the frame of the lattice (mm); if None, it is not drawn.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "none", "pdf.fonttype": 42}):
        figure = Figure(figsize=(12.5, 6.8), layout="constrained")
        rows = figure.add_gridspec(2, 1, height_ratios=(1.15, 1))
        widths = slice_widths(table.scenario.grid)
        top = rows[0].subgridspec(1, 4, width_ratios=[*widths, max(widths)])
        slices = [figure.add_subplot(top[column]) for column in range(3)]
        view: Any = figure.add_subplot(top[3], projection="3d")
        below = rows[1].subgridspec(1, 2)
        apart, force = (figure.add_subplot(below[column]) for column in (0, 1))
    grid = table.scenario.grid
    for panel, (across, number) in zip(slices, target_slices(grid), strict=True):
        draw_slice(panel, grid, across, number)
        _paths(partial(draw_near, panel, grid, across, number), report, true_tip_mm)
    figure.legend(*slices[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    _view(view, table, report)
    radius = table.scenario.target_radius_mm
    apart.plot(report.path_mm, report.deviations_mm, color=BLUE, linewidth=1.0, label="from the planned path")
    apart.axhline(
        radius,
        color=VERMILLION,
        linewidth=1.0,
        linestyle="--",
        label=f"target: radius of equal volume, {radius:.3g} mm",
    )
    apart.set_ylim(0.0, 1.3 * apart.get_ylim()[1])  # room for the legend above the lines
    apart.legend(frameon=False, loc="upper left", ncols=2, fontsize="small", borderaxespad=0.2)
    apart.set(xlabel="length of the path (mm)", ylabel="distance (mm)")
    title(apart, f"Deviation of the estimated tip, at most {report.deviation_mm:.2f} mm")
    force.plot(*report.forces.T, color=BLACK, linewidth=0.7)
    force.set(xlabel="length of the path (mm)", ylabel="axial force (N)")
    title(force, f"Axial force, at most {report.largest_force_n:.2f} N")
    for axes in (apart, force):
        axes.spines[["top", "right"]].set_visible(False)
    where = f"{report.error_in_space_mm:.2f} mm from the centre"
    figure.suptitle(f"{table.scenario.title or 'Insertion'}: {report.outcome}, {where}\n{slice_note(grid)}", fontsize=9)
    return figure


def insertion_vtp(table: SpaceTable, report: InsertionReport) -> bytes:
    """Return a VTP file in RAS mm: a line of the planned path (`executed` 0) and one of the estimated tip (1).

    The centroid of the target is a point with the radius of the ball of equal volume.
    """
    world = table.scenario.grid.frame.world
    lines = [(number, points) for number, points in enumerate((report.planned_mm, report.executed_mm)) if len(points)]
    target = np.array([table.scenario.target_mm])
    return vtp_bytes(
        [world(points) for _, points in lines], world(target), {"executed": [number for number, _ in lines]},
        {"target_radius_of_equal_volume_mm": [table.scenario.target_radius_mm]},
    )  # fmt: skip


def _paths(draw: Callable[..., None], report: InsertionReport, true_tip_mm: tuple[float, float, float] | None) -> None:
    """Draw planned and executed path on a slice by `draw_near`."""
    if len(report.planned_mm):
        draw(report.planned_mm, color=GREY, linestyle="--", linewidth=1.3, label="planned path")
    draw(report.executed_mm, color=BLUE, linewidth=1.6, label="executed (estimated tip)")
    turns = np.array([step.pose[:3] for step in report.steps if step.action is Action.ROTATE]).reshape(-1, 3)
    draw(turns, marker="o", markersize=4, markerfacecolor="white", markeredgecolor=GREEN,
         label=f"turns ({report.turns})")  # fmt: skip
    if true_tip_mm is not None:
        draw(np.array([true_tip_mm]), marker="x", color=VERMILLION, markersize=7, label="true tip at the end")


def _view(view: Any, table: SpaceTable, report: InsertionReport) -> None:
    """Draw the surfaces of target and obstacles as points, and both paths, in 3D."""
    draw_bodies(view, table.scenario.grid, zoom=_VIEW_ZOOM)
    if len(report.planned_mm):
        view.plot(*report.planned_mm.T, color=GREY, linestyle="--", linewidth=1.2)
    view.plot(*report.executed_mm.T, color=BLUE, linewidth=1.8)


# Ratio of width to height of the workspace above which the scene is drawn across the whole figure.
_FLAT = 2.2


def insertion_figure(
    table: PolicyTable, report: InsertionReport, true_tip_mm: tuple[float, float, float] | None = None
) -> Figure:
    """Return a matplotlib figure of an insertion: planned and executed path, and deviation and force over path length.

    `table` is the policy table at the start of the insertion. `true_tip_mm` is the true final position of the tip in
    mm, (x, y, z); if None, it is not drawn. Dotted lines mark the steps at which a new policy table was used.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "none", "pdf.fonttype": 42}):
        workspace = table.scenario.workspace
        if workspace.width_mm > _FLAT * workspace.height_mm:
            figure = Figure(figsize=(9.5, 5.4), layout="constrained")
            grid = figure.add_gridspec(2, 2)
            places = (grid[0, :], grid[1, 0], grid[1, 1])
        else:
            figure = Figure(figsize=(10.5, 4.8), layout="constrained")
            grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1))
            places = (grid[:, 0], grid[0, 1], grid[1, 1])
        scene, apart, force = (figure.add_subplot(place) for place in places)
    table.scenario.plot(scene)
    if len(report.planned_mm):
        scene.plot(*report.planned_mm.T, color=GREY, linestyle="--", linewidth=1.3, zorder=4, label="planned path")
    scene.plot(*report.executed_mm[:, :2].T, color=BLUE, linewidth=1.6, zorder=5, label="executed (estimated tip)")
    turns = np.array([step.pose[:2] for step in report.steps if step.action is Action.ROTATE]).reshape(-1, 2)
    scene.plot(*turns.T, linestyle="none", marker="o", markersize=5, markerfacecolor="white", markeredgecolor=GREEN,
               markeredgewidth=1.4, zorder=7, label=f"turns ({report.turns})")  # fmt: skip
    if true_tip_mm is not None:
        scene.plot(*true_tip_mm[:2], linestyle="none", marker="x", color=VERMILLION, markersize=7, zorder=8,
                   label="true tip at the end")  # fmt: skip
    where = f"{report.error_in_space_mm:.2f} mm from the centre"
    title(scene, f"{table.scenario.title or 'Insertion'}: {report.outcome}, {where}")
    legend_below(scene)
    along = report.path_mm
    if len(report.deviations_mm):
        apart.plot(along, report.deviations_mm, color=BLUE, linewidth=1.0, label="from the planned path")
    apart.plot(along, np.abs(report.executed_mm[:, 2]), color=ORANGE, linewidth=1.0, label="out of the plane")
    radius = table.scenario.target.radius_mm
    apart.axhline(radius, color=VERMILLION, linewidth=1.0, linestyle="--", label=f"target radius, {radius:.3g} mm")
    apart.set_ylabel("distance (mm)")
    title(apart, "Deviation of the estimated tip")
    apart.set_ylim(0.0, 1.4 * apart.get_ylim()[1])  # room for the legend above the lines
    apart.legend(frameon=False, loc="upper left", ncols=2, fontsize="small", borderaxespad=0.2)
    force.plot(*report.forces.T, color=BLACK, linewidth=0.7)
    force.set_ylabel("axial force (N)")
    title(force, f"Axial force, at most {report.largest_force_n:.2f} N")
    for axes in (apart, force):
        axes.set_xlabel("length of the path (mm)")
        axes.set_xlim(min(float(along.min(initial=0.0)), 0.0), max(float(along.max(initial=1.0)), 1.0))
        axes.spines[["top", "right"]].set_visible(False)
    for event in report.events:
        if event.digest and event.step < len(report.steps) and event.step:
            apart.axvline(report.steps[event.step].path_mm, color=GREY, linewidth=0.7, linestyle=":")
    return figure
