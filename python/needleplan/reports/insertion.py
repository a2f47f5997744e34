"""Figure of an insertion: planned and executed path, deviation, and axial force."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from needleplan.control import InsertionReport
from needleplan.planning import Action, PolicyTable
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, legend_below, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["insertion_figure"]

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
