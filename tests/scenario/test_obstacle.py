"""Obstacles of every shape: rules, geometry, files, drawings, and plans with them."""

from typing import Any

import numpy as np
import pytest
import shapely
from matplotlib.figure import Figure

import needleplan as npl
from needleplan.errors import ScenarioError
from needleplan.scenario import Grid, Needle, Obstacle, Scenario, Target, TipMotion, Workspace

SQUARE = [[10, 10], [20, 10], [20, 20], [10, 20]]
HOLE = [[13, 13], [17, 13], [17, 17], [13, 17]]
SHAPES: list[dict[str, Any]] = [
    {"polygon_mm": SQUARE},
    {"polygon_mm": SQUARE, "margin_mm": 1.5},
    {"polygon_mm": SQUARE, "holes_mm": [HOLE]},
    {"polygon_mm": SQUARE, "holes_mm": [HOLE], "margin_mm": 0.7},
    {"center_mm": [15, 15], "radius_mm": 4},
    {"center_mm": [15, 15], "radius_mm": 4, "margin_mm": 1},
    {"ends_mm": [[8, 8], [20, 14]], "radius_mm": 2},
    {"ends_mm": [[8, 8], [20, 14]], "radius_mm": 2, "margin_mm": 0.5},
    {"ends_mm": [[12, 5], [12, 15]], "radius_mm": 2.0},
]


def scene(*obstacles: Obstacle, samples: int | None = None) -> Scenario:
    return Scenario(
        Workspace(40, 30), Target((35, 15), 1.5), Needle(20), obstacles, TipMotion(30, arc_samples=samples),
        Grid((1.0, 1.0), "interpolated"),
    )  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("samples", [None, 4])
def test_grid_points_in_an_obstacle_are_those_of_shapely(shape: dict[str, Any], samples: int | None) -> None:
    obstacle = Obstacle(**shape)
    outcomes = npl.plan(scene(obstacle, samples=samples)).lattice.outcomes()[:, :, 0, 0]
    x, y = np.meshgrid(np.arange(41.0), np.arange(31.0), indexing="ij")
    inside = [obstacle.touches(*place) for place in zip(x.ravel().tolist(), y.ravel().tolist(), strict=True)]
    np.testing.assert_array_equal(outcomes == 4, np.reshape(inside, x.shape))
    region = obstacle.region()
    distance = shapely.distance(region.boundary, shapely.points(x, y))
    clear = distance > 0.01
    np.testing.assert_array_equal((outcomes == 4)[clear], shapely.contains_xy(region, x, y)[clear])


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_arcs_that_meet_an_obstacle_are_those_of_shapely(shape: dict[str, Any]) -> None:
    """Arcs as 400 straight pieces, compared where they are not within a hundredth of a millimetre of the boundary."""
    obstacle = Obstacle(**shape)
    scenario = scene(obstacle)
    outcomes = npl.plan(scenario).lattice.outcomes()
    region = obstacle.region()
    random = np.random.default_rng(1)
    rows = [random.integers(0, size, 1000) for size in outcomes.shape]
    turned = np.linspace(0, 2 * np.pi / 30, 401)
    compared = 0
    for i, j, k, b in zip(*(each.tolist() for each in rows), strict=True):
        heading, bevel = k * 2 * np.pi / 30, 2 * b - 1
        x = i + 20 * bevel * (np.sin(heading + bevel * turned) - np.sin(heading))
        y = j - 20 * bevel * (np.cos(heading + bevel * turned) - np.cos(heading))
        arc = shapely.LineString(np.stack([x, y], axis=1))
        code = outcomes[i, j, k, b]
        apart = arc.distance(region)
        if code in (0, 2) and (apart > 0.01 or arc.intersection(region).length > 0.01):
            compared += 1
            assert (code == 2) == (apart == 0), (i, j, k, b)
    assert compared > 500


@pytest.mark.parametrize("shape", SHAPES)
def test_a_file_holds_the_shape(shape: dict[str, Any]) -> None:
    scenario = scene(Obstacle(**shape, name="it"))
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    axes = scenario.plot(Figure().subplots())
    assert len(axes.patches) == 2


def test_text_of_a_polygon_is_what_it_was() -> None:
    """The digests of scenarios with polygons only depend on it."""
    text = scene(Obstacle(SQUARE, "it")).to_toml()
    lines = text.splitlines()
    at = lines.index("[[obstacle]]")
    assert lines[at + 1].startswith("polygon_mm = ")
    assert lines[at + 2] == 'name = "it"'
    assert not lines[at + 3]


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({}, r"obstacle\.polygon_mm: is missing; an obstacle has polygon_mm, or center_mm and radius_mm, or"),
        ({"center_mm": [1, 2]}, r"radius_mm: is missing beside center_mm"),
        ({"ends_mm": [[1, 2], [3, 4]]}, r"radius_mm: is missing beside ends_mm"),
        ({"polygon_mm": SQUARE, "radius_mm": 2}, r"radius_mm = 2: must not be given for a polygon; margin_mm widens"),
        (
            {"polygon_mm": SQUARE, "center_mm": [1, 2], "radius_mm": 2},
            r"center_mm: must not be given beside polygon_mm",
        ),
        ({"center_mm": [1, 2], "radius_mm": 2, "holes_mm": [HOLE]}, r"holes_mm: must not be given without polygon_mm"),
        ({"polygon_mm": HOLE, "holes_mm": [SQUARE]}, r"holes_mm: hole 1 must lie inside of polygon_mm"),
        ({"polygon_mm": SQUARE, "holes_mm": [HOLE, HOLE]}, r"holes_mm: hole 2 must not overlap hole 1"),
        ({"polygon_mm": SQUARE, "holes_mm": [[[1, 2]]]}, r"hole 1 must have at least three different points"),
        ({"polygon_mm": SQUARE, "margin_mm": -1}, r"margin_mm = -1: must be a finite number in mm"),
        ({"center_mm": [1, 2], "radius_mm": 0}, r"radius_mm = 0: must be"),
        ({"ends_mm": [[1, 2]], "radius_mm": 1}, r"ends_mm = .*must be two points"),
        (
            {"polygon_mm": [[0, 0], [4, 4], [4, 0], [0, 4]]},
            r"does so at \(2, 2\), where it crosses itself: the edge from point 1 to point 2 and the edge",
        ),
    ],
)
def test_mistakes_are_named(shape: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        Obstacle(**shape)


def test_a_target_in_the_margin_is_a_mistake() -> None:
    with pytest.raises(ScenarioError, match=r"must not lie in or on an obstacle; it does in obstacle 1 or its margin"):
        scene(Obstacle([[30, 10], [34, 10], [34, 20], [30, 20]], margin_mm=1.5))


def test_obstacles_from_shapely() -> None:
    ring = shapely.Polygon(SQUARE, [HOLE])
    pair = shapely.MultiPolygon([ring, shapely.box(25, 5, 28, 8)])
    first, second = Obstacle.from_shapely(pair, "bone", margin_mm=1)
    assert first == Obstacle(list(ring.exterior.coords), "bone", holes_mm=[HOLE], margin_mm=1)
    assert (second.name, second.margin_mm, second.holes_mm) == ("bone", 1, None)
    for wrong in (shapely.Point(1, 2), shapely.LineString([[1, 2], [3, 4]]), 3, None):
        with pytest.raises(ScenarioError, match="must be a polygon or a collection of polygons"):
            Obstacle.from_shapely(wrong)
