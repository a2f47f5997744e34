"""Layers and tissues in a scenario, and identified numbers that go into one."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from matplotlib.figure import Figure

from needleplan.errors import ModelError, ScenarioError
from needleplan.identification import path_curvature
from needleplan.models import Bicycle, Estimate, ModelFile, Parent, TipPath, arc_step
from needleplan.scenario import Layer, Needle, Obstacle, Scenario, Target, Tissue, Workspace, identified
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES

SQUARE = [(10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)]


def plain(needle: Needle | None = None, *tissues: Tissue) -> Scenario:
    return Scenario(Workspace(120, 80), Target((100, 50), 2), needle or Needle(40), tissues=tissues)


def test_nothing_is_written_where_nothing_is_new() -> None:
    text = plain().to_toml()
    assert "layer" not in text
    assert "tissue" not in text
    assert plain().digest == plain(Needle(40.0, ())).digest
    assert plain().uniform


def test_layers_and_tissues_are_written_and_change_the_digest() -> None:
    layered = plain(Needle(40, (Layer(30, 45),)), Tissue(SQUARE, 80, "tumour"))
    text = layered.to_toml()
    assert (
        "[needle]\ncurvature_radius_mm = 40.0\n\n[[needle.layer]]\nfrom_mm = 30.0\ncurvature_radius_mm = 45.0\n" in text
    )
    assert "[[tissue]]\npolygon_mm = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]]\n" in text
    assert Scenario.from_toml(text) == layered
    assert len({plain().digest, layered.digest, replace(layered, tissues=()).digest}) == 3
    assert not layered.uniform


def test_the_radius_of_a_place() -> None:
    inner = Tissue([(15, 15), (30, 15), (30, 30), (15, 30)], 90)
    scenario = plain(Needle(40, (Layer(12, 50), Layer(25, 60))), Tissue(SQUARE, 80), inner)
    places = {
        (0, 0): 40, (11.999, 0): 40, (12, 0): 50, (24.9, 0): 50, (25, 0): 60, (120, 80): 60,
        (10, 10): 80, (20, 10): 80, (15, 12): 80, (9.99, 12): 40, (15, 15): 90, (20, 20): 90, (30, 30): 90,
    }  # fmt: skip
    x, y = np.array(list(places)).T
    assert scenario.radius_mm(x, y).tolist() == list(places.values())
    assert scenario.radius_mm(np.zeros((2, 1)), np.zeros(3)).shape == (2, 3)
    assert float(scenario.radius_mm(12.0, 0.0)) == 50
    # A grid line that rounding puts just before the layer still is in it.
    assert float(plain(Needle(40, (Layer(2.1, 50),))).radius_mm(3 * 0.7, 0)) == 50


HOLE = [(13.0, 13.0), (17.0, 13.0), (17.0, 17.0), (13.0, 17.0)]
SHAPES: list[dict[str, Any]] = [
    {"polygon_mm": SQUARE},
    {"polygon_mm": SQUARE, "holes_mm": [HOLE]},
    {"center_mm": (15.0, 15.0), "radius_mm": 4.0},
    {"ends_mm": [(8.0, 8.0), (20.0, 14.0)], "radius_mm": 2.5},
]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_tissue_has_every_shape_of_an_obstacle(shape: dict[str, Any]) -> None:
    """Radii of dense points, the region of shapely, the file and the picture."""
    tissue = Tissue(**shape, curvature_radius_mm=80, name="tumour")
    scenario = plain(None, tissue)
    x, y = np.meshgrid(np.linspace(5, 25, 201), np.linspace(5, 25, 201))
    radii = scenario.radius_mm(x, y)
    same = Obstacle(**shape)
    assert tissue.region().equals(same.region())
    far = shapely.distance(same.region().boundary, shapely.points(x, y)) > 1e-3
    np.testing.assert_array_equal(radii[far] == 80, shapely.contains_xy(same.region(), x, y)[far])
    np.testing.assert_array_equal(radii == 80, same.covers(x, y))
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert len(scenario.plot(Figure().subplots()).patches) == len(plain().plot(Figure().subplots()).patches) + 2


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({}, r"tissue\.polygon_mm: is missing; a tissue has polygon_mm, or center_mm and radius_mm, or"),
        ({"center_mm": [1, 2]}, r"tissue\.radius_mm: is missing beside center_mm"),
        ({"polygon_mm": SQUARE, "radius_mm": 2}, r"radius_mm = 2: must not be given for a polygon$"),
        (
            {"polygon_mm": SQUARE, "ends_mm": [[1, 2], [3, 4]]},
            r"ends_mm: must not be given beside polygon_mm; a tissue",
        ),
        ({"center_mm": [1, 2], "radius_mm": 2, "holes_mm": [HOLE]}, r"holes_mm: must not be given without polygon_mm"),
        ({"polygon_mm": HOLE, "holes_mm": [SQUARE]}, r"holes_mm: hole 1 must lie inside of polygon_mm"),
        ({"polygon_mm": [[0, 0], [4, 4], [4, 0], [0, 4]]}, r"where it crosses itself: the edge from point 1"),
    ],
)
def test_mistakes_in_shapes_are_named(shape: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        Tissue(**shape, curvature_radius_mm=80)


def test_a_tissue_needs_a_radius_and_knows_no_margin() -> None:
    with pytest.raises(ScenarioError, match=r"tissue\.curvature_radius_mm: is missing"):
        Tissue(SQUARE)
    text = plain(None, Tissue(SQUARE, 80)).to_toml()
    radius = "curvature_radius_mm = 80.0\n"
    for line, rule in (
        (f"{radius}margin_mm = 1.0\n", "margin_mm: unknown key"),
        ("", "curvature_radius_mm: is missing"),
    ):
        with pytest.raises(ScenarioError, match=rf"tissue 1\.{rule}"):
            Scenario.from_toml(text.replace(radius, line))


def test_too_many_radii_are_refused() -> None:
    layers = tuple(Layer(number / 2, 40 + number) for number in range(200))
    assert plain(Needle(40, layers)).needle.layers == layers
    with pytest.raises(ScenarioError, match="at most 200 different values in needle, layers and tissues, not 201"):
        plain(Needle(39, layers))


def test_a_number_replaces_the_needle_and_its_layers() -> None:
    scenario = plain(Needle(40, (Layer(30, 45),)), Tissue(SQUARE, 80, "tumour"), Tissue(SQUARE, 70))
    changed = scenario.with_curvature(-1 / 64)
    assert changed.needle == Needle(64)
    assert changed.tissues == scenario.tissues
    named = scenario.with_curvature(1 / 50, tissue="tumour")
    assert [each.curvature_radius_mm for each in named.tissues] == [50, 70]
    assert named.needle == scenario.needle


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"curvature_per_mm": 0.0}, "curvature_per_mm = 0: must be a finite number other than 0"),
        ({"curvature_per_mm": math.nan}, "must be a finite number other than 0"),
        ({"curvature_per_mm": 1e-9}, r"needle\.curvature_radius_mm"),
        ({"curvature_per_mm": []}, "at least one piece of a path"),
        ({"curvature_per_mm": 0.01, "tissue": "tumor"}, 'tissue = "tumor": there is no .* did you mean "tumour"'),
        ({"curvature_per_mm": [], "tissue": "tumour"}, 'must be one number for the tissue "tumour"'),
    ],
)
def test_what_gives_no_radius_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        plain(None, Tissue(SQUARE, 80, "tumour")).with_curvature(**arguments)  # type: ignore[arg-type]


def test_segments_of_a_path_become_layers() -> None:
    random = np.random.default_rng(0)
    first = np.linspace(0, 40, 160)
    pose = arc_step(0.0, 0.0, 0.0, -1 / 60, 40.0)
    paths = [arc_step(0.0, 0.0, 0.0, -1 / 60, first), arc_step(*pose, -1 / 90, np.linspace(0.2, 40, 160))]
    points = np.concatenate([np.column_stack(each[:2]) for each in paths]) + random.normal(0, 0.02, (320, 2))
    segments, _ = path_curvature(points, [40.0])
    needle = plain(Needle(1, (Layer(1, 1),))).with_curvature(segments, entry_mm=5.0).needle
    assert needle.curvature_radius_mm == pytest.approx(60, rel=0.05)
    assert [layer.from_mm for layer in needle.layers] == pytest.approx([45.0])
    assert needle.layers[0].curvature_radius_mm == pytest.approx(90, rel=0.1)


def test_noise_goes_into_the_motion() -> None:
    assert plain().with_tip_noise([0.5, 0.25]).motion.tip_noise == (0.5, 0.25)
    with pytest.raises(ScenarioError, match="must be 1"):
        plain().with_tip_noise([0.5, 0.5])


def model(low: float, high: float, *, identified: bool = True) -> ModelFile:
    estimate = Estimate(-0.02, 0.001, low, high, "1/mm", identified)
    return ModelFile(Bicycle(-0.02), {"curvature_per_mm": estimate}, (Parent("one", ""), Parent("two", "")))


def test_a_model_file_of_a_bicycle() -> None:
    found = identified(model(-0.025, -0.016))
    assert found.curvature_per_mm == 0.02
    assert (found.low_per_mm, found.high_per_mm) == pytest.approx((0.016, 0.025))
    assert (found.radius_mm, *found.interval_mm) == pytest.approx((50, 40, 62.5))
    assert str(found) == "radius 50 mm (95 % interval 40 to 62.5), bicycle identified from 2 trials"
    assert str(identified(ModelFile(Bicycle(0.01)))) == "radius 100 mm (no interval), bicycle identified"


def test_a_model_file_of_a_tip_path() -> None:
    path = TipPath(cutting_force=0.2, bending=3e4, stiffness=0.05, bevel=0.5)
    estimate = Estimate(0.2, 0.01, 0.18, 0.24, "N", True)
    found = identified(ModelFile(path, {"cutting_force": estimate}))
    assert found.curvature_per_mm == pytest.approx(abs(path.curvature_1_mm))
    assert found.low_per_mm == pytest.approx(abs(replace(path, cutting_force=0.18).curvature_1_mm))
    assert found.high_per_mm == pytest.approx(abs(replace(path, cutting_force=0.24).curvature_1_mm))


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (model(-0.05, 0.01), r"m.toml: parameters.curvature_per_mm = -0.05 to 0.01: is not identified"),
        (model(-0.03, -0.01, identified=False), "a straight path is possible"),
        (ModelFile(Bicycle(0.0)), "a straight path is possible"),
        (ModelFile(TipPath(0.2, 3e4, 0.05, 0.5, anchoring=0.5)), r"anchoring.value = 0.5: must be 1"),
        (ModelFile(PUBLISHED_FORCES[0].model), "kind = .*: must be bicycle, bicycle_by_depth, tip_path or spatial"),
    ],
)
def test_models_without_a_radius_are_refused(file: ModelFile, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        identified(file, "m.toml")


def test_steps_of_a_length_of_their_own() -> None:
    thesis = plain()
    assert thesis.motion.step_length_mm(80.0) == pytest.approx(2 * thesis.step_mm)
    general = replace(thesis, motion=replace(thesis.motion, step_mm=3.0, tip_noise_step_deg=2.0))
    assert general.step_mm == general.motion.step_length_mm(80.0) == 3.0
    assert general.motion.noise_step_rad == pytest.approx(math.radians(2))
    assert Scenario.from_toml(general.to_toml()) == general
    assert "step_mm" not in thesis.to_toml()


def test_a_straight_layer_needs_a_step_length() -> None:
    straight = Needle(40, (Layer(30, math.inf),))
    motion = replace(plain().motion, step_mm=3.0)
    scenario = replace(replace(plain(), motion=motion), needle=straight)
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    with pytest.raises(ScenarioError, match=r"curvature_radius_mm = inf: needs motion\.step_mm"):
        plain(straight)
    with pytest.raises(ScenarioError, match=r"motion\.step_mm = 63\.0: must be at most 62\.8319"):
        replace(plain(), motion=replace(motion, step_mm=63.0))
    with pytest.raises(ScenarioError, match="curvature_radius_mm"):
        Layer(30, -math.inf)
