"""The figure of an entry map: the map, and three orthogonal slices of the lattice with the best path."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.plotting import sheet, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from needleplan.anatomy import AnatomyGrid
    from needleplan.planning._space import EntryMap

__all__ = ["draw_entries", "draw_slice"]

# Colours of the codes of the lattice: free, target, obstacle, outside.
_COLORS = ("#f2f2f2", "#E69F00", "#5a5a5a", "#ffffff")
_NAMES = "xyz"


class _Panel:
    """Size of a panel, for the layout of the figure."""

    width_mm = height_mm = 1.0


def draw_entries(entries: EntryMap) -> Figure:
    """Return a figure: success over the entry region, and the slices through the end of the best path."""
    figure, axes = sheet(_Panel(), 4)
    best = int(entries.order[0])
    path = entries.paths.points(best)
    _map(axes[0], entries, best)
    through = np.round(path[-1] / entries.grid.frame.spacing_mm).astype(int)
    for panel, across in zip(axes[1:], (2, 1, 0), strict=True):
        _slice(panel, entries, path, across, int(np.clip(through[across], 0, entries.grid.frame.shape[across] - 1)))
    return figure


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
