"""Polygons that are simple beyond doubt, against shapely."""

import subprocess
import sys

import numpy as np
import pytest
from shapely import Polygon

from needleplan.scenario import _shape


def random_corners(random: np.random.Generator) -> list[tuple[float, float]]:
    """Return corners in random order or around a centre, on a coarse lattice (many close cases) or anywhere."""
    count = int(random.integers(3, 9))
    around = random.random() < 0.5
    angles = np.sort(random.uniform(0, 2 * np.pi, count)) if around else random.uniform(0, 2 * np.pi, count)
    corners = 50 + random.uniform(5, 40, count)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    return [(float(x), float(y)) for x, y in (corners.round(-1) if random.random() < 0.5 else corners)]


def test_a_polygon_that_is_clearly_simple_is_valid_for_shapely_and_most_simple_ones_are_clear() -> None:
    random = np.random.default_rng(0)
    clear = simple = 0
    for _ in range(5000):
        corners = random_corners(random)
        valid = len(set(corners)) == len(corners) and Polygon(corners).is_valid
        if _shape._is_clearly_simple(corners):
            clear += 1
            assert valid, corners
        simple += valid
    assert clear > 0.8 * simple > 1000


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (10, 10), (10, 0), (0, 10)],
        [(0, 0), (10, 0), (5, 0), (5, 5)],
        [(0, 0), (10, 0), (20, 0)],
        [(0, 0), (10, 0), (10, 10), (5, 0), (0, 10)],
        [(0, 0), (5, 1e-13), (10, 0), (5, 5)],
    ],
    ids=["bow-tie", "folded back", "on one line", "touches an edge", "nearly straight"],
)
def test_a_polygon_that_touches_itself_or_nearly_so_is_not_clear(corners: list[tuple[float, float]]) -> None:
    assert not _shape._is_clearly_simple(corners)


def test_a_plan_does_not_import_what_it_does_not_need() -> None:
    code = (
        "import sys, needleplan as npl; npl.Scenario.read('four_obstacles_thesis'); npl.plan;"
        "print(sorted({'shapely', 'matplotlib', 'scipy', 'h5py'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout == "[]\n"
