"""The figure of an entry map: the map, three orthogonal slices with the best path, and a 3D view."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needleplan.anatomy import (
    draw_bodies,
    draw_letters,
    draw_near,
    draw_slice,
    slice_note,
    slice_widths,
    target_slices,
)
from needleplan.planning._unreached import unreached
from needleplan.plotting import title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from needleplan.planning._space import EntryMap

__all__ = ["draw_entries"]

# Number of executions with noise in the 3D view.
_EXECUTIONS = 40


def draw_entries(entries: EntryMap, best: int | None = None) -> Figure:
    """Draw the success over the entry region, slices through the target with the best path, and a 3D view.

    The view has 40 executions with noise from the best entry. If no entry reaches the target, the figure says so, and
    has no path and no executions.

    Parameters
    ----------
    entries : EntryMap
        Map of the entries.
    best : int, optional
        Number of the best entry. Default: `EntryMap.first`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    best = entries.first() if best is None else best
    hopeless = _hopeless(entries, best)
    with mpl.rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "none", "pdf.fonttype": 42}):
        figure = Figure(figsize=(10.5, 8.0), layout="constrained")
        rows = figure.add_gridspec(2, 1)
        top = rows[0].subgridspec(1, 2)
        entry = figure.add_subplot(top[0])
        view: Any = figure.add_subplot(top[1], projection="3d")
        below = rows[1].subgridspec(1, 3, width_ratios=slice_widths(entries.grid))
        slices = [figure.add_subplot(below[column]) for column in range(3)]
    path = None if hopeless else entries.paths.points(best)
    _map(entry, entries, None if hopeless else best)
    for panel, (across, number) in zip(slices, target_slices(entries.grid), strict=True):
        draw_slice(panel, entries.grid, across, number)
        if path is not None:
            draw_near(panel, entries.grid, across, number, path, color="#0072B2", linewidth=1.8)
            draw_near(
                panel, entries.grid, across, number, path[:1], marker="o", markerfacecolor="none", color="#D55E00"
            )
    draw_bodies(view, entries.grid)
    if path is None:
        title(view, "Target and obstacles")
        figure.suptitle(hopeless, fontsize=10)
    else:
        _executions(view, entries, best)
        view.plot(*path.T, color="#000000", lw=1.5)
    figure.supxlabel(slice_note(entries.grid, path is not None), fontsize=8)
    return figure


def _hopeless(entries: EntryMap, best: int) -> str:
    """Return the title of a figure of entries that do not reach the target; empty if one does."""
    if entries.impossible:
        return "Impossible: no path of this needle leads from the entry region to the target"
    reason = unreached(entries, [best])
    if not reason:
        return ""
    most = f"more than {100 * reason.highest:.1f} % of executions"
    return f"No entry reaches the target in {most}; that no path exists is not proved"


def _executions(view: Any, entries: EntryMap, best: int) -> None:
    """Draw executions with noise from an entry."""
    executions = entries.table.executions(entries.poses[best], _EXECUTIONS)
    for run in range(_EXECUTIONS):
        view.plot(
            *executions.points(run).T, color="#0072B2" if executions.reached[run] else "#D55E00", lw=0.5, alpha=0.5
        )
    title(view, f"{int(executions.reached.sum())} of {_EXECUTIONS} executions with noise reach the target")


def _map(panel: Axes, entries: EntryMap, best: int | None) -> None:
    """Draw the success of the entry points, seen along the axis, and a circle about the best one."""
    y, z = entries.poses[:, 1], entries.poses[:, 2]
    dots: Any = panel.scatter(y, z, c=100 * entries.success, cmap="viridis", vmin=0, vmax=100, s=14, marker="s")
    panel.figure.colorbar(dots, ax=panel, label="success by the table (%)")
    panel.margins(0.1)  # room for the letters
    panel.set(xlabel="lattice y (mm)", ylabel="lattice z (mm)", aspect="equal")
    if best is not None:
        panel.plot(y[best], z[best], "o", mfc="none", color="#D55E00", ms=9, label="best entry")
        panel.legend(loc="lower right", fontsize=7)
    draw_letters(panel, entries.grid.frame, 1, 2, 0.5)
    title(panel, "Entry region, seen along x of the lattice")
