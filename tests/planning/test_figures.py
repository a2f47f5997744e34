"""Figures hold what they should; how they look is looked at."""

from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes

import needleplan as npl
from needleplan import plotting
from needleplan.errors import InputError, OutputError, PoseError
from needleplan.planning import Outcome
from needleplan.scenario import Method, Scenario


def labels(figure: object) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]  # type: ignore[attr-defined]


@pytest.fixture
def axes(table: npl.PolicyTable) -> Axes:
    return plotting.sheet(table.scenario.workspace, 1)[1][0]


def test_a_plan_shows_the_scene_the_path_and_the_map(table: npl.PolicyTable) -> None:
    figure, (left, right) = plotting.sheet(table.scenario.workspace, 2)
    rollouts, path = table.rollout(table.best_entry(), runs=10), table.path(table.best_entry())
    rollouts.plot(left)
    plotting.legend_below(path.plot(left, scene=False))
    table.plot(right)
    scene, success = figure.axes
    (bar,) = success.child_axes
    assert bar.get_ylabel() == "probability"
    assert len(scene.patches) == len(success.patches) == 2
    assert scene.get_xlim() == success.get_xlim() == (0, 60)
    assert scene.get_aspect() == 1
    reached = sum(each.outcome is Outcome.TARGET for each in rollouts.samples)
    assert f"turns ({len(path.turns)})" in labels(figure)
    assert "target, radius 2 mm" in labels(figure)
    assert f"with tip noise, reached the target ({reached})" in labels(figure)
    assert success.images[0].get_array().shape == (41, 61)
    assert success.images[0].get_clim() == (0, 1)


def test_the_map_of_one_heading(table: npl.PolicyTable, axes: Axes) -> None:
    assert table.plot(axes, heading_rad=0.0) is axes
    shown = axes.images[0].get_array()
    assert shown[20, 0] == table.success[0, 20, 0].max()
    assert shown.mask[5, 25]
    assert "at 0 deg" in axes.get_title(loc="left")
    assert len(axes.child_axes) == 1
    with pytest.raises(PoseError, match=r"heading_rad = 90: .*degrees\?"):
        table.plot(axes, heading_rad=90)


def test_the_order_numbers_every_partition_once(small: Scenario, axes: Axes) -> None:
    solver = replace(small.solver, method=Method.PPVI)
    table = npl.plan(replace(small, solver=solver))
    texts = [text.get_text() for text in table.plot_order(axes).texts]
    assert len(table.stats.order) <= 24
    assert sorted(map(int, texts)) == sorted([*range(1, 25), *range(1, len(table.stats.order) + 1)])


def test_the_order_of_a_table_without_partitions_is_refused(table: npl.PolicyTable, axes: Axes) -> None:
    with pytest.raises(InputError, match=r"solver\.method"):
        table.plot_order(axes)


def test_a_flat_workspace_is_stretched_and_says_so() -> None:
    phantom = Scenario.read("phantom")
    figure, axes = plotting.sheet(phantom.workspace, 2)
    phantom.plot(axes[0])
    assert "y stretched 3.6 times" in axes[0].get_xlabel()
    assert axes[0].get_position().y0 > axes[1].get_position().y0
    assert len(figure.axes) == 2


def test_layers_and_tissues_are_tinted_and_labelled() -> None:
    scenario = Scenario.read("layered")
    _, axes = plotting.sheet(scenario.workspace, 2)
    scenario.plot(axes[0])
    scenario.plot(axes[1], on_map=True)
    texts = [text.get_text() for text in axes[0].texts]
    assert texts == ["R 75 mm", "R 55 mm", "R 45 mm", "tumour, R 35 mm"]
    spans, regions = axes[0].patches[3:6], axes[0].patches[6:7]
    assert [(patch.get_x(), patch.get_width()) for patch in spans] == [(0, 24), (24, 38), (62, 48)]  # type: ignore[attr-defined]
    shades = [sum(patch.get_facecolor()[:3]) for patch in (*spans, *regions)]  # type: ignore[misc]
    assert shades == sorted(shades, reverse=True)  # the smaller the radius, the darker
    assert not axes[1].texts
    assert len(axes[1].lines) == 3
    assert axes[0].get_xlim() == axes[1].get_xlim() == (0, 110)


def test_without_axes_there_is_a_figure_of_pyplot(table: npl.PolicyTable) -> None:
    pyplot.close("all")
    entry = table.best_entry()
    for shown in (table, table.scenario, table.path(entry), table.rollout(entry, runs=3)):
        axes = shown.plot()
        assert axes is pyplot.gca() or axes in pyplot.gcf().axes
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (mm)", "y (mm)")
        assert axes.get_title(loc="left") == ("Success probability at the best heading" if shown is table else "Small")
        pyplot.close()
    assert pyplot.get_fignums() == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.svg", b"<?xml")])
def test_files(table: npl.PolicyTable, tmp_path: Path, name: str, start: bytes) -> None:
    figure, (axes,) = plotting.sheet(table.scenario.workspace, 1)
    table.path((0, 25, 0)).plot(axes)
    plotting.save(figure, tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(start)
    assert len(list(tmp_path.iterdir())) == 1


def test_files_that_cannot_be(table: npl.PolicyTable, tmp_path: Path) -> None:
    figure, _ = plotting.sheet(table.scenario.workspace, 1)
    with pytest.raises(OutputError, match=r"must end in \.png, \.pdf, \.svg"):
        plotting.save(figure, tmp_path / "a.gif")
    with pytest.raises(OutputError, match="cannot be written"):
        plotting.save(figure, tmp_path / "no" / "a.png")


LONG = "A scenario whose title is longer than the panel is wide, since somebody wrote all that matters into it"


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "panels"), [("four_obstacles", 1), ("phantom", 2), ("prostate", 2), ("brain", 3)])
def test_no_title_and_no_legend_is_cropped_or_lies_over_another(scene: str, panels: int, tmp_path: Path) -> None:
    scenario = replace(Scenario.read(scene), title=LONG)
    figure, every = plotting.sheet(scenario.workspace, panels)
    for number, axes in enumerate(every):
        scenario.plot(axes)
        for runs in range(4):
            axes.plot([], [], label=f"with tip noise, reached the target ({runs})" if not number else None)
    plotting.legend_below(every[0])
    plotting.save(figure, tmp_path / "figure.png")
    figure.draw_without_rendering()  # saving has changed the resolution
    boxes = [axes._left_title.get_window_extent() for axes in every] + [figure.legends[0].get_window_extent()]
    for box in boxes:
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1
        assert 0 <= box.y0 < box.y1 <= figure.bbox.y1 + 1  # a pixel: the layout converges
    areas = [axes.get_window_extent() for axes in every] + [axes.xaxis.label.get_window_extent() for axes in every]
    for first, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in [*boxes[first + 1 :], *areas])


def test_the_colour_bar_is_as_high_as_its_map(table: npl.PolicyTable) -> None:
    figure, (axes,) = plotting.sheet(table.scenario.workspace, 1)
    table.plot(axes)
    figure.draw_without_rendering()
    (bar,) = axes.child_axes
    assert bar.get_position().height == pytest.approx(axes.get_position().height)
    assert bar.get_tightbbox().x1 <= figure.bbox.x1
