"""Figures of studies: what they say in words, and where their cells and labels lie."""

import json
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import needleplan as npl
from needleplan.sweep import (
    Engine,
    Sweep,
    SweptParameter,
    draw_entry_map,
    draw_pareto,
    draw_quantity_map,
    draw_sensitivities,
    draw_wrong_parameters,
    entry_map,
    make_table_set,
    pareto_front,
    quantity_map,
    sensitivities,
    wrong_parameters,
)
from needleplan.sweep._study_axes import axis_title, cell_axis
from tests.cli.commands import needleplan
from tests.sweep.sweeps import write_sweep


@pytest.fixture(scope="module")
def table_set(tmp_path_factory: pytest.TempPathFactory) -> npl.TableSet:
    """Return a table set over height of the target, cost of a rotation and radius; 4 of 8 points are impossible."""
    folder = tmp_path_factory.mktemp("figures")
    sweep = Sweep.read(write_sweep(folder))
    height = SweptParameter("target.center_mm.y", values=[20.0, 45.0])  # 45 mm lies outside the workspace
    radius = SweptParameter("needle.curvature_radius_mm", name="radius", values=[30.0, 50.0])
    rotation = SweptParameter("objective.rotation", values=[1.0, 8.0])
    make_table_set(replace(sweep, parameters=(height, rotation, radius)), folder / "store", Engine(workers=0))
    return npl.TableSet.open(folder / "store")


def words(figure: Figure) -> str:
    return " ".join(figure.get_suptitle().split())


def labels(figure: Figure) -> tuple[str, str]:
    axes: Axes = figure.axes[0]
    return axes.get_xlabel(), axes.get_ylabel()


def test_a_map_has_title_units_selection_and_number_of_tables(table_set: npl.TableSet) -> None:
    part = table_set.select(radius=30.0)
    figure = draw_quantity_map(quantity_map(part, "rotation", "y"), "rotation", "y", table_set=part)
    assert labels(figure) == ("cost of rotation (cost units)", "target center y (mm)")
    assert words(figure) == (
        "Radius and rotation: success probability of the best entry; radius (mm) = 30; 2 of 4 selected tables, "
        "2 break a rule of scenarios"
    )
    assert [text.get_text() for text in figure.legends[0].texts] == ["no table, or without this quantity"]
    whole = table_set.select(y=20.0)
    assert not draw_quantity_map(quantity_map(whole, "rotation", "radius"), "rotation", "radius").legends


def test_the_other_studies_have_them_too(table_set: npl.TableSet) -> None:
    part = table_set.select(rotation=8.0, y=20.0)
    figure = draw_entry_map(entry_map(part, "radius"), "radius", "left", table_set=part)
    assert labels(figure) == ("entry on the left edge, y (mm)", "radius (mm)")
    assert "Radius and rotation: success over the entry; target center y (mm) = 20;" in words(figure)
    part = table_set.select(y=20.0)
    figure = draw_sensitivities(sensitivities(part), table_set=part)
    names = {each.get_text().replace("\n", " ") for each in figure.axes[0].get_yticklabels()}
    assert names == {"radius (mm)", "cost of rotation (cost units)"}
    assert "4 of 4 selected tables" in words(figure)
    figure = draw_pareto(part, pareto_front(part), table_set=part)
    assert words(figure).startswith("Radius and rotation: trade-off (arrows: better);")
    assert len(figure.axes) == 3


def test_a_wrong_plan_has_a_row_with_intervals_for_each_table(table_set: npl.TableSet) -> None:
    part = table_set.select(y=20.0)
    found = wrong_parameters(part, runs=50, radius=30.0, rotation=1.0)
    assert all(each.success_interval[0] <= each.success <= each.success_interval[1] for each in found)
    assert all(each.replanned_interval[0] < each.replanned_interval[1] for each in found)
    figure = draw_wrong_parameters(found, {"radius": 30.0, "rotation": 1.0}, table_set=part)
    assert "planned for radius (mm) 30, cost of rotation (cost units) 1;" in words(figure)
    axes = figure.axes[0]
    assert {each.get_text() for each in axes.get_yticklabels()} == {"1, 30", "8, 30", "1, 50", "8, 50"}
    assert axes.get_ylabel() == "true cost of rotation (cost units),\nradius (mm)"
    assert len(axes.containers) == 2  # two marks with intervals in each row


def test_of_many_tables_those_with_the_largest_loss_are_drawn(table_set: npl.TableSet) -> None:
    one = wrong_parameters(table_set.select(y=20.0), runs=20, radius=30.0, rotation=1.0)[0]
    many = [replace(one, values={"n": n}, success=n / 40, replanned=1.0) for n in range(40)]
    figure = draw_wrong_parameters(many, "n = 1")
    assert words(figure) == "Planned for n = 1, the 24 largest losses of 40"
    assert [each.get_text() for each in figure.axes[0].get_yticklabels()][::-1] == [str(n) for n in range(24)]


@pytest.mark.parametrize(
    ("key", "name", "wanted"),
    [
        ("target.center_mm.x", "", "target center x (mm)"),
        ("target.center_mm.y", "target_y", "target y (mm)"),
        ("motion.tip_noise_step_deg", "noise", "noise (degrees)"),
        ("objective.clearance_per_mm", "clearance_price_per_mm", "clearance price (cost units/mm)"),
        ("objective.clearance_mm", "", "clearance (mm)"),
        ("objective.discount", "", "discount"),
        ("obstacle.vessel.margin_mm", "", "vessel margin (mm)"),
        ("obstacle.1.margin_mm", "", "obstacle 1 margin (mm)"),
        ("obstacle.1.margin_mm", "margin_mm", "margin (mm)"),
        ("target.radius_mm", "", "target radius (mm)"),
        ("needle.curvature_radius_mm", "", "curvature radius (mm)"),
        ("motion.headings", "", "headings"),
    ],
)
def test_titles_of_parameters(key: str, name: str, wanted: str, table_set: npl.TableSet) -> None:
    parameter = SweptParameter(key, name=name, values=[1.0])
    changed = replace(table_set, sweep=replace(table_set.sweep, parameters=(parameter,)))
    assert axis_title(parameter.title, changed) == wanted


def test_a_title_that_is_given_stays() -> None:
    assert axis_title("radius of the arc (mm)") == "radius of the arc (mm)"


def test_cells_lie_at_the_numbers_and_are_logarithmic_over_a_decade() -> None:
    cells = cell_axis((30.0, 40.0, 90.0))
    assert (cells.edges.tolist(), cells.logarithmic) == ([25.0, 35.0, 65.0, 115.0], False)
    assert cells.shares.tolist() == pytest.approx([1 / 9, 3 / 9, 5 / 9])
    wide = cell_axis((1.0, 4.0, 16.0, 64.0))
    assert wide.logarithmic
    assert wide.edges.tolist() == pytest.approx([0.5, 2, 8, 32, 128])
    assert not cell_axis((0.0, 1.0, 20.0)).logarithmic
    assert cell_axis(("a", "b")).edges.tolist() == [-0.5, 0.5, 1.5]
    assert cell_axis(("/data/one/plan.toml", "/data/two/plan.toml")).texts == ("one/plan.toml", "two/plan.toml")


@pytest.mark.parametrize("count", [3, 40])
def test_labels_do_not_overlap(count: int) -> None:
    import itertools

    from needleplan.sweep import QuantityMap

    levels = tuple(np.geomspace(30.123, 90.456, count).tolist())
    figure = draw_quantity_map(QuantityMap(levels, levels, np.full((count, count), 0.5)), "a_mm", "b_mm")
    figure.draw_without_rendering()
    for ticks in (figure.axes[0].get_xticklabels(), figure.axes[0].get_yticklabels()):
        boxes = [each.get_window_extent() for each in ticks]
        assert len(boxes) >= 3
        assert not any(one.overlaps(other) for one, other in itertools.pairwise(boxes))


@pytest.mark.slow
def test_the_command_titles_its_figures(tmp_path: Path) -> None:
    make_table_set(Sweep.read(write_sweep(tmp_path)), tmp_path / "store", Engine(workers=0))
    with mpl.rc_context({"svg.fonttype": "none"}):
        for kind, *options in (["map"], ["entries", "--select", "rotation=8"], ["pareto"], ["sensitivity"]):
            file = tmp_path / f"{kind}.svg"
            done = needleplan("study", kind, tmp_path / "store", *options, "--figure", file, "--json")
            assert json.loads(done.stdout)["study"] == kind
            assert "Radius and rotation: " in file.read_text(), kind
