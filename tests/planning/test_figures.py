"""Figures hold what they should; how they look is looked at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import needleplan as npl
from needleplan import plotting
from needleplan.errors import InputError, OutputError
from needleplan.planning import Outcome, drawing
from needleplan.scenario import Method, Scenario


def labels(figure: object) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]  # type: ignore[attr-defined]


def test_a_plan_shows_the_scene_the_path_and_the_map(table: npl.PolicyTable) -> None:
    start = table.best_entry().pose
    path = table.path(start)
    noisy = [table.path(start, noise_seed=seed) for seed in range(10)]
    figure = drawing.plan_figure(table, path, noisy)
    scene, success, _bar = figure.axes
    assert len(scene.patches) == len(success.patches) == 2
    assert scene.get_xlim() == success.get_xlim() == (0, 60)
    assert scene.get_aspect() == 1
    reached = sum(each.outcome is Outcome.TARGET for each in noisy)
    assert f"turns ({len(path.turns)})" in labels(figure)
    assert f"with tip noise, reached the target ({reached})" in labels(figure)
    assert success.images[0].get_array().shape == (41, 61)
    assert success.images[0].get_clim() == (0, 1)


def test_the_map_of_one_heading(table: npl.PolicyTable) -> None:
    figure, (axes,) = plotting.sheet(table.scenario.workspace, 1)
    drawing.draw_success_map(axes, table, heading_rad=0.0)
    shown = axes.images[0].get_array()
    assert shown[20, 0] == table.success[0, 20, 0].max()
    assert shown.mask[5, 25]
    assert "at 0 deg" in axes.get_title(loc="left")
    assert len(figure.axes) == 2


def test_the_order_numbers_every_partition_once(small: Scenario) -> None:
    solver = replace(small.solver, method=Method.PPVI)
    table = npl.plan(replace(small, solver=solver))
    (axes,) = drawing.order_figure(table).axes
    texts = [text.get_text() for text in axes.texts]
    assert len(table.stats.order) <= 24
    assert sorted(map(int, texts)) == sorted([*range(1, 25), *range(1, len(table.stats.order) + 1)])


def test_the_order_of_a_table_without_partitions_is_refused(table: npl.PolicyTable) -> None:
    with pytest.raises(InputError, match=r"solver\.method"):
        drawing.order_figure(table)


def test_a_flat_workspace_is_stretched_and_says_so() -> None:
    figure, axes = plotting.sheet(Scenario.read("phantom").workspace, 2)
    drawing.draw_scene(axes[0], Scenario.read("phantom"))
    assert "y stretched 3.6 times" in axes[0].get_xlabel()
    assert axes[0].get_position().y0 > axes[1].get_position().y0
    assert len(figure.axes) == 2


def test_layers_and_tissues_are_tinted_and_labelled() -> None:
    scenario = Scenario.read("layered")
    _, axes = plotting.sheet(scenario.workspace, 2)
    drawing.draw_scene(axes[0], scenario)
    drawing.draw_scene(axes[1], scenario, on_colour=True)
    texts = [text.get_text() for text in axes[0].texts]
    assert texts == ["R 75 mm", "R 55 mm", "R 45 mm", "tumour, R 35 mm"]
    spans, regions = axes[0].patches[3:6], axes[0].patches[6:7]
    assert [(patch.get_x(), patch.get_width()) for patch in spans] == [(0, 24), (24, 38), (62, 48)]  # type: ignore[attr-defined]
    shades = [sum(patch.get_facecolor()[:3]) for patch in (*spans, *regions)]  # type: ignore[misc]
    assert shades == sorted(shades, reverse=True)  # the smaller the radius, the darker
    assert not axes[1].texts
    assert len(axes[1].lines) == 3
    assert axes[0].get_xlim() == axes[1].get_xlim() == (0, 110)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.svg", b"<?xml")])
def test_files(table: npl.PolicyTable, tmp_path: Path, name: str, start: bytes) -> None:
    plotting.save(drawing.path_figure(table, table.path((0, 25, 0))), tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(start)
    assert len(list(tmp_path.iterdir())) == 1


def test_files_that_cannot_be(table: npl.PolicyTable, tmp_path: Path) -> None:
    figure = drawing.path_figure(table, table.path((0, 25, 0)))
    with pytest.raises(OutputError, match=r"must end in \.png, \.pdf, \.svg"):
        plotting.save(figure, tmp_path / "a.gif")
    with pytest.raises(OutputError, match="cannot be written"):
        plotting.save(figure, tmp_path / "no" / "a.png")
