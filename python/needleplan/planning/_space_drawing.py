"""The figure of an entry map: the map, three orthogonal slices with the best path, and a 3D view."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import TARGET
from needleplan.planning._unreached import unreached
from needleplan.plotting import title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from needleplan.anatomy import AnatomyGrid, SpaceFrame
    from needleplan.planning._space import EntryMap

__all__ = ["draw_bodies", "draw_entries", "draw_near", "draw_slice", "slice_note", "slice_widths", "target_slices"]

# Axes across which the slices of a figure lie, in their order.
_SLICES = (2, 1, 0)
# Colours of the codes of the lattice: free, target, obstacle, outside.
_COLORS = ("#f2f2f2", "#E69F00", "#5a5a5a", "#ffffff")
_NAMES = "xyz"
_DIRECTIONS = {each[0]: each for each in ("A anterior", "I inferior", "L left", "P posterior", "R right", "S superior")}
# Number of executions with noise, and largest number of surface points of a body, in the 3D view.
_EXECUTIONS, _MOST_POINTS = 40, 4000
# Distance from a slice, in spacings, up to which a path is drawn at full strength, and opacity beyond; as in the page.
_NEAR_SPACINGS, _FAINT = 2, 0.3


def draw_entries(entries: EntryMap, best: int | None = None) -> Figure:
    """Return a figure: success over the entry region, slices through the target with the best path, a 3D view.

    The view has 40 executions with noise from the best entry: that with the number `best`, or `EntryMap.first`. If no
    entry reaches the target, the figure says so, and has no path and no executions.
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


def slice_widths(grid: AnatomyGrid) -> list[float]:
    """Return the widths of the slices of `target_slices` at equal heights, for panels without gaps between."""
    planes = [[axis for axis in range(3) if axis != across] for across in _SLICES]
    return [grid.frame.shape[first] / grid.frame.shape[second] for first, second in planes]


def slice_note(grid: AnatomyGrid, has_path: bool = True) -> str:
    """Return the caption of slices through the target: frame, anatomical directions, and the rule of `draw_near`."""
    near = f"; paths are faint beyond {_NEAR_SPACINGS * grid.frame.spacing_mm:g} mm from a slice" if has_path else ""
    letters = sorted({each for axis in range(3) for each in grid.frame.letters(axis) if each})
    where = f" ({', '.join(_DIRECTIONS[each] for each in letters)})" if letters else ""
    return f"Slices through the target, in the frame of the lattice{where}{near}"


def target_slices(grid: AnatomyGrid) -> list[tuple[int, int]]:
    """Return axis and number of three slices through the target, across z, y and x.

    Each is the slice with the most grid points of the target; of equal ones, that nearest to the centroid.
    """
    cells = np.argwhere(grid.codes == TARGET)
    found = []
    for across in _SLICES:
        counts = np.bincount(cells[:, across])
        fullest = np.flatnonzero(counts == counts.max())
        found.append((across, int(fullest[abs(fullest - cells[:, across].mean()).argmin()])))
    return found


def draw_bodies(view: Any, grid: AnatomyGrid, zoom: float = 0.85) -> None:
    """Draw the surfaces of obstacles and target as points on axes in 3D; `zoom` leaves room for the labels."""
    from scipy import ndimage

    for code, alpha in ((2, 0.12), (1, 0.8)):
        body = grid.codes == code
        # Beyond the lattice everything counts as body, so that its cut faces are no surface.
        cells = np.argwhere(body & ~ndimage.binary_erosion(body, border_value=1))
        places = cells[:: max(1, -(-len(cells) // _MOST_POINTS))] * grid.frame.spacing_mm
        view.scatter(*places.T, s=4, color=_COLORS[code], alpha=alpha, linewidths=0, depthshade=False)
    x, y, z = (grid.frame.spacing_mm * (size - 1) for size in grid.frame.shape)
    view.set(xlabel=_label(0), ylabel=_label(1), zlabel=_label(2), xlim=(0, x), ylim=(0, y), zlim=(0, z))
    view.set_box_aspect((x, y, z), zoom=zoom)
    view.locator_params(nbins=4)  # more labels lie over the name of the axis
    view.tick_params(labelsize=7, pad=0)


def draw_slice(panel: Axes, grid: AnatomyGrid, across: int, number: int) -> tuple[int, int]:
    """Draw the slice `number` of the grid across an axis (0 x, 1 y, 2 z), and return the axes of its plane.

    Letters at the edges are the anatomical directions that are within 45 degrees of an axis of the plane.
    """
    from matplotlib.colors import ListedColormap

    spacing = grid.frame.spacing_mm
    first, second = _plane(across)
    codes = np.take(grid.codes, number, across)
    extent = (-0.5 * spacing, (codes.shape[0] - 0.5) * spacing, -0.5 * spacing, (codes.shape[1] - 0.5) * spacing)
    panel.imshow(
        codes.T, origin="lower", extent=extent, cmap=ListedColormap(_COLORS), vmin=0, vmax=3, interpolation="nearest"
    )
    panel.set(xlabel=_label(first), ylabel=_label(second))
    _letters(panel, grid.frame, first, second)
    title(panel, f"Slice {_NAMES[across]} = {number * spacing:.0f} mm")
    return first, second


def draw_near(
    panel: Axes, grid: AnatomyGrid, across: int, number: int, points_mm: NDArray[np.float64], **style: Any
) -> None:
    """Draw points of the lattice, or the line through them, on a slice: strong near the slice, faint far from it.

    Near is at most two spacings away, so that a line that passes in front of an obstacle does not seem to pierce it.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
        Axes with the slice.
    grid : AnatomyGrid
        The anatomy on the lattice.
    across, number : int
        Axis and number of the slice, as of `draw_slice`.
    points_mm : numpy.ndarray
        The points, shape (n, 3).
    **style
        Style of `Axes.plot`. With a `marker`, the points are drawn, and without one the line.
    """
    first, second = _plane(across)
    apart = points_mm[:, across] - number * grid.frame.spacing_mm
    reach = _NEAR_SPACINGS * grid.frame.spacing_mm
    if "marker" in style:
        near = points_mm[abs(apart) <= reach]
        style = {"linestyle": "none", **style}
    else:
        parts = [np.full((0, 3), np.nan)]
        for place in np.flatnonzero(abs(apart[1:] + apart[:-1]) / 2 <= reach):
            parts += [points_mm[place : place + 2]]
            if place + 2 >= len(points_mm) or abs(apart[place + 1] + apart[place + 2]) / 2 > reach:
                parts += [np.full((1, 3), np.nan)]
        near = np.concatenate(parts)
    panel.plot(points_mm[:, first], points_mm[:, second], alpha=_FAINT, **{**style, "label": None})
    panel.plot(near[:, first], near[:, second], **style)


def _hopeless(entries: EntryMap, best: int) -> str:
    """Return the title of a figure of entries that do not reach the target; empty if one does."""
    if entries.impossible:
        return "Impossible: no path of this needle leads from the entry region to the target"
    found = unreached(entries, [best])
    if not found:
        return ""
    most = f"more than {100 * found.highest:.1f} % of executions"
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
    panel.set(xlabel=_label(1), ylabel=_label(2), aspect="equal")
    if best is not None:
        panel.plot(y[best], z[best], "o", mfc="none", color="#D55E00", ms=9, label="best entry")
        panel.legend(loc="lower right", fontsize=7)
    _letters(panel, entries.grid.frame, 1, 2, 0.5)
    title(panel, "Entry region, seen along x of the lattice")


def _plane(across: int) -> tuple[int, int]:
    """Return the axes of the plane across an axis: to the right, and up."""
    first, second = (axis for axis in range(3) if axis != across)
    return first, second


def _label(axis: int) -> str:
    return f"lattice {_NAMES[axis]} (mm)"


def _letters(panel: Axes, frame: SpaceFrame, first: int, second: int, height: float = 0.12) -> None:
    """Write the anatomical directions at the edges of a panel; those to the right and left below the target."""
    from matplotlib.patheffects import withStroke

    (left, right), (bottom, top) = frame.letters(first), frame.letters(second)
    for text, place, sideways, upright in (
        (left, (0.015, height), "left", "center"), (right, (0.985, height), "right", "center"),
        (bottom, (0.5, 0.015), "center", "bottom"), (top, (0.5, 0.985), "center", "top"),
    ):  # fmt: skip
        panel.text(
            *place, text, transform=panel.transAxes, ha=sideways, va=upright, fontsize=9, fontweight="bold",
            color="#1a1a1a", path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )  # fmt: skip
