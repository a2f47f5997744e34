"""Sheets, axes in mm, and saving; colours by Okabe and Ito, safe for colour-blind readers."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from needleplan.artifacts import write_whole
from needleplan.errors import Mistake, OutputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    "require_drawable",
    "save",
    "sheet",
    "stack",
    "tall",
    "title",
]

BLACK, GREY = "#1a1a1a", "#8c8c8c"
BLUE, SKY, GREEN, ORANGE, VERMILLION = "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00"


class Extent(Protocol):
    """The size of a workspace, mm."""

    @property
    def width_mm(self) -> float:
        """Size along x."""

    @property
    def height_mm(self) -> float:
        """Size along y."""


_FORMATS = ("png", "pdf", "svg")
_STYLE: Any = {
    "font.size": 9,
    "axes.linewidth": 0.8,
    "svg.fonttype": "none",
    "svg.hashsalt": "needleplan",
    "pdf.fonttype": 42,
}
_FLATTEST = 6.0


def sheet(workspace: Extent, panels: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with `panels` axes of one workspace: beside each other, or stacked where it is flat."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        if workspace.width_mm > 2.2 * workspace.height_mm:
            height = 7.2 / min(workspace.width_mm / workspace.height_mm, _FLATTEST) + 0.9
            figure = Figure(figsize=(7.6, panels * height), layout="constrained")
            axes = figure.subplots(panels, 1, squeeze=False)
        else:
            height = 4.4 * min(workspace.height_mm / workspace.width_mm, 1.6) + 0.8
            figure = Figure(figsize=(5.0 * panels, height), layout="constrained")
            axes = figure.subplots(1, panels, squeeze=False)
        return figure, list(axes.flat)


def stack(panels: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with `panels` axes below each other."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(7.6, 1.9 * panels + 0.6), layout="constrained")
        return figure, list(figure.subplots(panels, 1, squeeze=False).flat)


def axes_in_mm(axes: Axes, workspace: Extent) -> None:
    """Label the axes in mm, with equal scales; a very flat workspace is stretched in y, and its label says so."""
    stretch = workspace.width_mm / workspace.height_mm / _FLATTEST
    axes.set_aspect(max(stretch, 1))
    axes.set_xlabel(f"x (mm); y stretched {stretch:.2g} times" if stretch > 1 else "x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_xlim(0, workspace.width_mm)
    axes.set_ylim(0, workspace.height_mm)


def tall(workspace: Extent) -> bool:
    """Return whether the workspace is drawn with equal scales."""
    return workspace.width_mm / workspace.height_mm <= _FLATTEST


def title(axes: Axes, text: str) -> None:
    """Write the title of a panel above its left end."""
    axes.set_title(text, loc="left", fontsize=10)


def require_drawable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError unless the end of a name is that of a format in which figures are written."""
    if Path(path).suffix.lower().removeprefix(".") not in _FORMATS:
        rule = f"the name of a figure must end in {', '.join(f'.{each}' for each in _FORMATS)}"
        raise OutputError(Mistake("", "", rule), os.fspath(path))


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the figure as PNG (200 dots per inch), PDF or SVG, by the end of the name. Raises OutputError."""
    import matplotlib as mpl

    require_drawable(path)
    kind = Path(path).suffix.lower().removeprefix(".")
    image = io.BytesIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(image, format=kind, dpi=200)
    write_whole(path, image.getbuffer())
