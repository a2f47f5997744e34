"""The figure of an entry map: the map, three orthogonal slices with the best path, and a view in space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.plotting import title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from needleplan.anatomy import AnatomyGrid
    from needleplan.planning._space import EntryMap

__all__ = ["SLICES", "draw_bodies", "draw_entries", "draw_slice", "slice_widths"]

SLICES = (2, 1, 0)
"""Axes across which the slices of a figure lie, in their order."""

# Colours of the codes of the lattice: free, target, obstacle, outside.
_COLORS = ("#f2f2f2", "#E69F00", "#5a5a5a", "#ffffff")
_NAMES = "xyz"
# Number of executions with noise, and largest number of surface points of a body, in the view in space.
_EXECUTIONS, _MOST_POINTS = 40, 4000


def draw_entries(entries: EntryMap, best: int | None = None) -> Figure:
    """Return a figure: success over the entry region, slices through the end of the best path, and a view in space.

    The view has 40 executions with noise from the best entry: that with the number `best`, or `EntryMap.first`.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "none", "pdf.fonttype": 42}):
        figure = Figure(figsize=(10.5, 8.0), layout="constrained")
        rows = figure.add_gridspec(2, 1)
        top = rows[0].subgridspec(1, 2)
        entry = figure.add_subplot(top[0])
        view: Any = figure.add_subplot(top[1], projection="3d")
        below = rows[1].subgridspec(1, 3, width_ratios=slice_widths(entries.grid))
        slices = [figure.add_subplot(below[column]) for column in range(3)]
    best = entries.first() if best is None else best
    path = entries.paths.points(best)
    _map(entry, entries, best)
    through = np.round(path[-1] / entries.grid.frame.spacing_mm).astype(int)
    for panel, across in zip(slices, SLICES, strict=True):
        _slice(panel, entries, path, across, int(np.clip(through[across], 0, entries.grid.frame.shape[across] - 1)))
    draw_bodies(view, entries.grid)
    executions = entries.table.executions(entries.poses[best], _EXECUTIONS)
    for run in range(_EXECUTIONS):
        view.plot(
            *executions.points(run).T, color="#0072B2" if executions.reached[run] else "#D55E00", lw=0.5, alpha=0.5
        )
    view.plot(*path.T, color="#000000", lw=1.5)
    title(view, f"{int(executions.reached.sum())} of {_EXECUTIONS} executions with noise reach the target")
    return figure


def slice_widths(grid: AnatomyGrid) -> list[float]:
    """Return the widths of the slices across `SLICES` at equal heights, for panels beside each other without gaps."""
    planes = [[axis for axis in range(3) if axis != across] for across in SLICES]
    return [grid.frame.shape[first] / grid.frame.shape[second] for first, second in planes]


def draw_bodies(view: Any, grid: AnatomyGrid, zoom: float = 0.85) -> None:
    """Draw the surfaces of obstacles and target as points on axes in space; `zoom` leaves room for the labels."""
    from scipy import ndimage

    for code, alpha in ((2, 0.12), (1, 0.8)):
        body = grid.codes == code
        # Beyond the lattice everything counts as body, so that its cut faces are no surface.
        cells = np.argwhere(body & ~ndimage.binary_erosion(body, border_value=1))
        places = cells[:: max(1, -(-len(cells) // _MOST_POINTS))] * grid.frame.spacing_mm
        view.scatter(*places.T, s=4, color=_COLORS[code], alpha=alpha, linewidths=0, depthshade=False)
    x, y, z = (grid.frame.spacing_mm * (size - 1) for size in grid.frame.shape)
    view.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)", xlim=(0, x), ylim=(0, y), zlim=(0, z))
    view.set_box_aspect((x, y, z), zoom=zoom)
    view.locator_params(nbins=4)  # more labels lie over the name of the axis
    view.tick_params(labelsize=7, pad=0)


def _map(panel: Axes, entries: EntryMap, best: int) -> None:
    """Draw the success of the entry points, seen along the axis."""
    y, z = entries.poses[:, 1], entries.poses[:, 2]
    dots: Any = panel.scatter(y, z, c=100 * entries.success, cmap="viridis", vmin=0, vmax=100, s=14, marker="s")
    panel.figure.colorbar(dots, ax=panel, label="predicted success (%)")
    panel.plot(y[best], z[best], "o", mfc="none", color="#D55E00", ms=9, label="best entry")
    panel.set(xlabel="y (mm)", ylabel="z (mm)", aspect="equal")
    panel.legend(loc="lower right", fontsize=7)
    title(panel, "Entry region, seen along the axis")


def draw_slice(panel: Axes, grid: AnatomyGrid, across: int, number: int) -> tuple[int, int]:
    """Draw the slice `number` of the grid across an axis (0 x, 1 y, 2 z), and return the axes of its plane."""
    from matplotlib.colors import ListedColormap

    spacing = grid.frame.spacing_mm
    first, second = (axis for axis in range(3) if axis != across)
    codes = np.take(grid.codes, number, across)
    extent = (-0.5 * spacing, (codes.shape[0] - 0.5) * spacing, -0.5 * spacing, (codes.shape[1] - 0.5) * spacing)
    panel.imshow(
        codes.T, origin="lower", extent=extent, cmap=ListedColormap(_COLORS), vmin=0, vmax=3, interpolation="nearest"
    )
    panel.set(xlabel=f"{_NAMES[first]} (mm)", ylabel=f"{_NAMES[second]} (mm)")
    title(panel, f"Slice {_NAMES[across]} = {number * spacing:.0f} mm, path projected")
    return first, second


def _slice(panel: Axes, entries: EntryMap, path: Any, across: int, number: int) -> None:
    """Draw the slice `number` across an axis, and the path projected on it."""
    first, second = draw_slice(panel, entries.grid, across, number)
    panel.plot(path[:, first], path[:, second], color="#0072B2", lw=1.8)
    panel.plot(path[0, first], path[0, second], "o", mfc="none", color="#D55E00")
