"""Figures in space: slices of equal scale beside each other without gaps, and no text over another one."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needleplan.planning import draw_entries, entry_map
from needleplan.reports.space_insertion import space_insertion_figure
from tests.control.space_scenes import box_table, inserted

# Largest distance (inches) between a panel with its labels and the next one.
GAP = 0.5


def figure_of(kind: str) -> Figure:
    if kind == "entries":
        return draw_entries(entry_map(box_table()))
    return space_insertion_figure(box_table(), inserted(box_table())[0])


@pytest.mark.parametrize("kind", ["entries", "insertion"])
def test_slices_stand_beside_each_other(kind: str) -> None:
    figure = figure_of(kind)
    figure.draw_without_rendering()
    slices = [each for each in figure.axes if each.get_title(loc="left").startswith("Slice")]
    assert len(slices) == 3
    dpi = figure.dpi
    for one, other in pairwise(slices):
        assert one.get_aspect() == other.get_aspect() == 1
        gap = (outer(other).x0 - outer(one).x1) / dpi
        assert 0 <= gap < GAP
        heights = [each.get_window_extent().height for each in (one, other)]
        assert heights[0] == pytest.approx(heights[1], rel=0.1)
    width, height = figure.get_size_inches() * dpi
    for axes in figure.axes:
        box = outer(axes)
        assert box.x0 > -1, axes.get_title()
        assert box.y0 > -1, axes.get_title()
        assert box.x1 < width + 1, axes.get_title()
        assert box.y1 < height + 1, axes.get_title()


def outer(axes: Axes) -> Any:
    """Return the box of a panel with its labels."""
    return axes.get_tightbbox()
