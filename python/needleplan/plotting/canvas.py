"""Figures with panels, axes in mm, and saving. The colours of Okabe and Ito suit colour-blind readers."""

from __future__ import annotations

import base64
import io
import math
import os
import re
import textwrap
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from needleplan.artifacts import write_whole
from needleplan.errors import InputError, Mistake, OutputError
from needleplan.extras import is_installed, require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

__all__ = [
    "BLACK",
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "SKY",
    "VERMILLION",
    "Extent",
    "axes_in_mm",
    "axes_or_new",
    "colour_bar",
    "legend_below",
    "picture_html",
    "require_drawable",
    "save",
    "sheet",
    "stack",
    "title",
]

BLACK, GREY = "#1a1a1a", "#8c8c8c"
BLUE, SKY, GREEN, ORANGE, VERMILLION = "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00"


class Extent(Protocol):
    """Protocol: size of a workspace in mm."""

    @property
    def width_mm(self) -> float:
        """Size along x (mm)."""

    @property
    def height_mm(self) -> float:
        """Size along y (mm)."""


_FORMATS = ("png", "pdf", "svg")
_STYLE: Any = {
    "font.size": 9,
    "axes.linewidth": 0.8,
    "svg.fonttype": "none",
    "svg.hashsalt": "needleplan",
    "pdf.fonttype": 42,
}
# Ratio of width to height of a workspace above which panels are stacked.
_FLAT = 2.2

# Largest width (inches) of a figure; text is too small beside a wider one.
_WIDEST = 12.0

# Ratio of width to height of a workspace above which the workspace is stretched in y.
_FLATTEST = 6.0

# Letters of a title per inch of the width of its panel, labels of the y axis included, and the least number in a line.
_TITLE_LETTERS_PER_INCH, _LEAST_LETTERS = 12.0, 20

# Letters of a legend per inch, width (inches) of the symbol of an entry with its gaps, height (inches) of a row.
_LEGEND_LETTERS_PER_INCH, _LEGEND_INCHES, _LEGEND_ROW_INCHES = 17.5, 0.55, 0.17

# Draws after which the layout changes no more.
_LAYOUTS = 3

# Width (inches) of a colour bar.
_BAR_INCHES = 0.13

# Resolution (dots per inch) of a figure in a notebook.
_NOTEBOOK_DPI = 80


def sheet(workspace: Extent, panels: int) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels.

    The panels lie one below the other if the workspace is more than 2.2 times as wide as high, else side by side.

    Parameters
    ----------
    workspace : Extent
        Width and height of the workspace.
    panels : int
        Number of panels.

    Returns
    -------
    tuple of Figure and list of Axes
    """
    require("matplotlib")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    width, height, rows = _sheet_size(workspace, panels)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, list(figure.subplots(rows, panels // rows, squeeze=False).flat)


def axes_or_new(axes: Axes | None, workspace: Extent) -> Axes:
    """Return given axes, or the axes of a new pyplot figure whose size suits the workspace.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes, or None.
    workspace : Extent
        Width and height of the workspace.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If `axes` is something else.
    """
    if axes is not None:
        if not callable(getattr(axes, "set_aspect", None)):
            rule = "must be the axes of a matplotlib figure, such as figure.subplots(), or None"
            raise InputError(Mistake("ax", f"<{type(axes).__name__}>", rule))
        return axes
    require("matplotlib")
    import matplotlib as mpl
    from matplotlib import pyplot

    with mpl.rc_context(_STYLE):
        return pyplot.figure(figsize=_sheet_size(workspace, 1)[:2], layout="constrained").subplots()


def _sheet_size(workspace: Extent, panels: int) -> tuple[float, float, int]:
    """Return width (inches), height (inches) and number of rows of a figure of `panels` panels."""
    if workspace.width_mm > _FLAT * workspace.height_mm:
        height = 7.2 / min(workspace.width_mm / workspace.height_mm, _FLATTEST) + 0.9
        return 7.6, panels * height, panels
    width = min(5.0, _WIDEST / panels)
    return width * panels, 0.88 * width * min(workspace.height_mm / workspace.width_mm, 1.6) + 1.1, 1


def stack(panels: int) -> tuple[Figure, list[Axes]]:
    """Return a new pyplot figure and its `panels` axes, one below the other."""
    require("matplotlib")
    import matplotlib as mpl
    from matplotlib import pyplot

    with mpl.rc_context(_STYLE):
        figure = pyplot.figure(figsize=(7.6, 1.9 * panels + 0.6), layout="constrained")
        return figure, list(figure.subplots(panels, 1, squeeze=False).flat)


def axes_in_mm(axes: Axes, workspace: Extent) -> None:
    """Set labels, limits (mm) and equal scales of axes.

    A workspace more than 6 times as wide as high is stretched in y; the label of the x axis states the factor.
    """
    stretch = workspace.width_mm / workspace.height_mm / _FLATTEST
    axes.set_aspect(max(stretch, 1))
    axes.set_xlabel(f"x (mm); y stretched {stretch:.2g} times" if stretch > 1 else "x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_xlim(0, workspace.width_mm)
    axes.set_ylim(0, workspace.height_mm)


def title(axes: Axes, text: str) -> None:
    """Write the title of a panel above the axes, left-aligned, in lines that are not wider than the panel.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes of the panel.
    text : str
        Title, which may contain mathtext.
    """
    markup = len(re.findall(r"[$_{}\\]", text))  # characters that are not drawn
    lines = textwrap.wrap(text, max(int(_width_inches(axes) * _TITLE_LETTERS_PER_INCH), _LEAST_LETTERS) + markup)
    axes.set_title("\n".join(lines), loc="left", fontsize=10)


def _width_inches(axes: Axes) -> float:
    """Return the approximate width of a panel before the layout, with its labels."""
    place = axes.get_subplotspec()
    figure = axes.get_figure(root=True)
    width = float(figure.get_figwidth()) if figure else 0.0
    if place is None:
        return width * float(axes.get_position().width)
    columns: Any = place.get_gridspec().get_width_ratios()
    return width * float(sum(columns[place.colspan.start : place.colspan.stop]) / sum(columns))


def colour_bar(axes: Axes, image: AxesImage, label: str) -> None:
    """Draw the colour bar of an image at the right of its axes, as high as the axes."""
    box = axes.inset_axes((1.02, 0.0, _BAR_INCHES / _width_inches(axes), 1.0))
    bar = axes.figure.colorbar(image, cax=box)
    bar.set_label(label, fontsize=_STYLE["font.size"])
    box.tick_params(labelsize=_STYLE["font.size"])


def legend_below(axes: Axes) -> None:
    """Write the legend of `axes` below all panels of its figure, in as many columns as fit.

    The figure becomes higher by the rows after the first one.
    """
    handles, labels = axes.get_legend_handles_labels()
    column = _LEGEND_INCHES + max(map(len, labels), default=0) / _LEGEND_LETTERS_PER_INCH
    figure = axes.get_figure(root=True)
    if figure and labels:
        columns = max(1, min(len(labels), int(figure.get_figwidth() / column)))
        figure.set_figheight(figure.get_figheight() + _LEGEND_ROW_INCHES * (math.ceil(len(labels) / columns) - 1))
        figure.legend(handles, labels, loc="outside lower left", ncols=columns, frameon=False, fontsize=8)


def picture_html(workspace: Extent, draw: Callable[[Axes], object], text: str) -> str:
    """Return an HTML figure for a notebook: a PNG image and a caption; without matplotlib, the caption alone.

    Parameters
    ----------
    workspace : Extent
        Width and height of the workspace.
    draw : callable
        Function that draws on the axes.
    text : str
        Caption.

    Returns
    -------
    str
    """
    if not is_installed("matplotlib"):
        return f"<p>{escape(text)}</p>"
    figure, (axes,) = sheet(workspace, 1)
    draw(axes)
    if axes.get_legend_handles_labels()[0]:
        legend_below(axes)
    _lay_out(figure)
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=_NOTEBOOK_DPI)
    data = base64.b64encode(image.getbuffer()).decode()
    caption = escape(text)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def require_drawable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if the file name does not end in .png, .pdf or .svg.

    Raises MissingLibraryError if matplotlib is not installed.
    """
    require("matplotlib")
    if Path(path).suffix.lower().removeprefix(".") not in _FORMATS:
        rule = f"the name of a figure must end in {', '.join(f'.{each}' for each in _FORMATS)}"
        raise OutputError(Mistake("", "", rule), os.fspath(path))


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the figure as PNG (200 dots per inch), PDF or SVG.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure to write.
    path : str or path
        Path of the file. Its ending selects the format.

    Raises
    ------
    OutputError
        The ending is another one, or the file cannot be written.
    """
    import matplotlib as mpl

    require_drawable(path)
    kind = Path(path).suffix.lower().removeprefix(".")
    image = io.BytesIO()
    with mpl.rc_context(_STYLE):
        _lay_out(figure)
        figure.savefig(image, format=kind, dpi=200)
    write_whole(path, image.getbuffer())


def _lay_out(figure: Figure) -> None:
    """Place titles, labels and legends.

    The layout of panels with equal scales takes some draws until no text lies over another.
    """
    for _ in range(_LAYOUTS):
        figure.draw_without_rendering()
