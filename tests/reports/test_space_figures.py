"""Figures in 3D: slices through the target, of equal scale beside each other; paths faint where they are far."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needleplan.anatomy import TARGET, SpaceFrame, draw_near, grid_of, slice_note, target_slices
from needleplan.planning import EntryMap, Success, draw_entries, entry_map, rank_entries
from needleplan.reports.insertion import space_insertion_figure
from tests.anatomy.volumes import anatomy, box
from tests.control.space_scenes import box_table, inserted

pytestmark = pytest.mark.usefixtures("few_executions")

# Largest distance (inches) between a panel with its labels and the next one.
GAP = 0.5


def figure_of(kind: str) -> Figure:
    if kind == "entries":
        return draw_entries(entry_map(box_table()))
    return space_insertion_figure(box_table(), inserted(box_table())[0])


@pytest.mark.slow
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


def slices_of(figure: Figure) -> list[Axes]:
    return [each for each in figure.axes if each.get_title(loc="left").startswith("Slice")]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["entries", "insertion"])
def test_each_slice_has_the_target_and_strong_paths_only_near_it(kind: str) -> None:
    grid = box_table().scenario.grid
    figure = figure_of(kind)
    for panel, (across, number) in zip(slices_of(figure), target_slices(grid), strict=True):
        layer = np.take(grid.codes, number, across) == TARGET
        assert layer.sum() == max(
            (np.take(grid.codes, each, across) == TARGET).sum() for each in range(grid.frame.shape[across])
        )
        image = panel.images[0].get_array()
        assert image is not None
        assert (image == TARGET).any()
        faint, strong = ([line for line in panel.lines if (line.get_alpha() or 1) == each] for each in (0.3, 1))
        assert len(faint) == len(strong) > 1
        assert panel.get_xlabel().startswith("lattice ")
    texts = [*(each.get_text() for each in figure.texts), figure.get_suptitle(), figure.get_supxlabel()]
    assert any(slice_note(grid) in each for each in texts)


def test_a_line_is_strong_within_two_spacings_of_the_slice() -> None:
    grid, panel = box_table().scenario.grid, Figure().add_subplot()
    spacing = grid.frame.spacing_mm
    z = spacing * np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 4.0, 3.0])
    points = np.stack([np.arange(9.0), np.zeros(9), z], 1)
    draw_near(panel, grid, 2, 3, points, color="red")
    draw_near(panel, grid, 2, 3, points, marker="o")
    faint, strong, all_marks, near_marks = (np.asarray(line.get_xdata()) for line in panel.lines)
    assert faint.tolist() == all_marks.tolist() == list(range(9))
    # the segments from 1 to 5 have their middle within two spacings of the slice; so has that from 7 to 8
    assert np.unique(strong[np.isfinite(strong)]).tolist() == [1, 2, 3, 4, 5, 7, 8]
    assert np.isnan(strong[strong.tolist().index(7) - 1])
    assert near_marks.tolist() == [1, 2, 3, 4, 5, 7, 8]


@pytest.mark.parametrize("wall", [True, False])
def test_entries_that_do_not_reach_the_target_have_no_path(wall: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    entries = rank_entries(anatomy(box(wall=wall)), threads=1)
    assert entries.impossible == wall
    hopeless = Success(0.0, (0.0, 0.005), "executions", 2000)
    monkeypatch.setattr(EntryMap, "estimate", lambda *_: hopeless)
    figure = draw_entries(entries)
    assert figure.get_suptitle().startswith("Impossible: no path" if wall else "No entry reaches the target")
    for panel, (across, number) in zip(slices_of(figure), target_slices(entries.grid), strict=True):
        assert (np.take(entries.grid.codes, number, across) == TARGET).any()
        assert not panel.lines
    assert "faint" not in figure.get_supxlabel()
    assert not any(each.get_legend() for each in figure.axes)


def test_letters_name_the_anatomical_direction_within_45_degrees() -> None:
    frame = grid_of(anatomy(box())).frame  # x is S
    assert frame.letters(0) == ("I", "S")
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    turned = SpaceFrame(np.zeros(3), np.array([[-c, s, 0], [-s, -c, 0], [0, 0, 1.0]]), 1.0, (2, 2, 2))
    assert [turned.letters(axis) for axis in range(3)] == [("R", "L"), ("A", "P"), ("I", "S")]
    half, third = np.sqrt(0.5), np.sqrt(1 / 3)
    between = SpaceFrame(np.zeros(3), np.array([[half, half, 0], [third] * 3, [0.6, 0, -0.8]]), 1.0, (2, 2, 2))
    assert [between.letters(axis) for axis in range(3)] == [("", ""), ("", ""), ("S", "I")]


def outer(axes: Axes) -> Any:
    """Return the box of a panel with its labels."""
    return axes.get_tightbbox()
