"""Figures: layout, colours and saving. Importing this package does not import matplotlib."""

from needleplan.plotting.canvas import (
    axes_or_new,
    legend_below,
    picture_html,
    require_drawable,
    save,
    sheet,
    stack,
    title,
)
from needleplan.plotting.caption import caption

__all__ = [
    "axes_or_new",
    "caption",
    "legend_below",
    "picture_html",
    "require_drawable",
    "save",
    "sheet",
    "stack",
    "title",
]
