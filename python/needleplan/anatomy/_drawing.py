"""Slices and bodies of an anatomy on its lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from needleplan.anatomy._voxels import TARGET
from needleplan.plotting import title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needleplan.anatomy._frame import SpaceFrame
    from needleplan.anatomy._grid import AnatomyGrid

__all__ = [
    "Rectangle",
    "draw_bodies",
    "draw_letters",
    "draw_near",
    "draw_slice",
    "slice_note",
    "slice_widths",
    "target_slices",
]

# Axes across which the slices of a figure lie, in their order.
_SLICES = (2, 1, 0)
# Colours of the codes of the lattice: free, target, obstacle, outside.
_COLORS = ("#f2f2f2", "#E69F00", "#5a5a5a", "#ffffff")
_NAMES = "xyz"
_DIRECTIONS = {each[0]: each for each in ("A anterior", "I inferior", "L left", "P posterior", "R right", "S superior")}
# Largest number of surface points of a body in the view in 3D.
_MOST_POINTS = 4000
# Distance from a slice, in spacings, up to which a path is drawn at full strength, and opacity beyond; as in the page.
_NEAR_SPACINGS, _FAINT = 2, 0.3


class Rectangle(NamedTuple):
    """Size of a 3D lattice along x and y (mm). It has the fields of a planar workspace, so both can be drawn alike."""

    width_mm: float
    height_mm: float


def slice_widths(grid: AnatomyGrid) -> list[float]:
    """Return the widths of the slices of `target_slices` at equal heights, for panels without gaps between."""
    planes = [[axis for axis in range(3) if axis != across] for across in _SLICES]
    return [grid.frame.shape[first] / grid.frame.shape[second] for first, second in planes]


def slice_note(grid: AnatomyGrid, has_path: bool = True) -> str:
    """Return the caption of slices through the target: frame, anatomical directions, and the rule of `draw_near`.

    Parameters
    ----------
    grid : AnatomyGrid
        Grid of the anatomy.
    has_path : bool, default True
        Whether the slices show paths.

    Returns
    -------
    str
    """
    near = f"; paths are faint beyond {_NEAR_SPACINGS * grid.frame.spacing_mm:g} mm from a slice" if has_path else ""
    letters = sorted({letter for axis in range(3) for letter in grid.frame.letters(axis) if letter})
    where = f" ({', '.join(_DIRECTIONS[letter] for letter in letters)})" if letters else ""
    return f"Slices through the target, in the frame of the lattice{where}{near}"


def target_slices(grid: AnatomyGrid) -> list[tuple[int, int]]:
    """Return axis and number of three slices through the target, across z, y and x.

    Along each axis, it is the slice with the most grid points of the target. Of equal slices, it is the one nearest to
    the centroid of the target.
    """
    cells = np.argwhere(grid.codes == TARGET)
    found = []
    for across in _SLICES:
        counts = np.bincount(cells[:, across])
        fullest = np.flatnonzero(counts == counts.max())
        found.append((across, int(fullest[abs(fullest - cells[:, across].mean()).argmin()])))
    return found


def draw_bodies(view: Any, grid: AnatomyGrid, zoom: float = 0.85) -> None:
    """Draw the surfaces of obstacles and target as points on 3D axes.

    Parameters
    ----------
    view : object
        Axes with the projection `3d`.
    grid : AnatomyGrid
        Grid of the anatomy.
    zoom : float, default 0.85
        Size of the box relative to the axes; below 1, it leaves room for the labels.
    """
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
    """Draw a slice of the grid.

    Letters at the edges are the anatomical directions that are within 45 degrees of an axis of the plane.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
        Axes to draw on.
    grid : AnatomyGrid
        Grid of the anatomy.
    across : int
        Axis that the slice is perpendicular to (0 x, 1 y, 2 z).
    number : int
        Index of the slice along this axis.

    Returns
    -------
    tuple of int
        The horizontal and the vertical axis of the panel.
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
    draw_letters(panel, grid.frame, first, second)
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


def _plane(across: int) -> tuple[int, int]:
    """Return the axes of the plane across an axis: to the right, and up."""
    first, second = (axis for axis in range(3) if axis != across)
    return first, second


def _label(axis: int) -> str:
    return f"lattice {_NAMES[axis]} (mm)"


def draw_letters(panel: Axes, frame: SpaceFrame, first: int, second: int, height: float = 0.12) -> None:
    """Write the anatomical directions at the edges of a panel.

    Parameters
    ----------
    panel : matplotlib.axes.Axes
        Axes that show a slice.
    frame : SpaceFrame
        Frame of the lattice.
    first : int
        Axis of the lattice that is horizontal in the panel (0 x, 1 y, 2 z).
    second : int
        Axis of the lattice that is vertical in the panel.
    height : float, default 0.12
        Height of the letters to the left and right, as a share of the panel. The default is below the target.
    """
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
