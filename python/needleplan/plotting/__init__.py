"""Figures: sheets, colours and saving; importing this package does not import matplotlib."""

from needleplan.plotting.canvas import require_drawable, save, sheet, stack
from needleplan.plotting.caption import caption

__all__ = ["caption", "require_drawable", "save", "sheet", "stack"]
