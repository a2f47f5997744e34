"""Distances of a path to each obstacle of the file, against the distance to every voxel."""

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import obstacle_distances
from tests.anatomy.volumes import NAMES, TEXT, anatomy, box, write
from tests.cli.commands import needleplan

OBSTACLES = TEXT.replace('["vessel"]', '["vessel", "air"]').replace('outside = ["air"]\n', "")


def test_the_distance_is_that_to_the_nearest_voxel() -> None:
    scene = anatomy(box(), OBSTACLES)
    points = np.random.default_rng(0).uniform([8.0, 8.0, 10.0], [32.0, 32.0, 40.0], (40, 3))
    for start, end in points.reshape(-1, 2, 3):
        path = start + np.linspace(0, 1, 30)[:, None] * (end - start)
        found = obstacle_distances(scene, path)
        assert list(found.values()) == sorted(found.values())
        for name in ("vessel", "air"):
            centers = 2.0 * np.argwhere(box() == NAMES[name])
            apart = np.maximum(abs(path[:, None] - centers) - 1.0, 0)
            assert found[name] == pytest.approx(np.linalg.norm(apart, axis=-1).min(), abs=1e-9)


def test_obstacles_that_are_far_or_absent_are_left_out() -> None:
    labels = box()
    labels[labels == NAMES["vessel"]] = NAMES["body"]
    scene = anatomy(labels, OBSTACLES.replace('"air"]', '"air", "body"]'))
    assert set(obstacle_distances(scene, np.array([[20.0, 20.0, 30.0]]))) == {"body", "air"}
    labels[:] = NAMES["body"]
    labels[6:14, 6:14, 2:4], labels[7:13, 7:13, 24:28] = NAMES["entry"], NAMES["target"]
    labels[0, 0, 0] = NAMES["vessel"]
    assert obstacle_distances(anatomy(labels), np.array([[30.0, 30.0, 50.0]])) == {}


def test_the_record_of_an_entry_has_them(tmp_path: Path) -> None:
    best = json.loads(needleplan("entry", write(tmp_path, box()), "--json", "--top", 1).stdout)["entries"][0]
    assert best["obstacles_mm"]["vessel"] == pytest.approx(best["clearance_mm"], abs=2.0)


@pytest.mark.slow
def test_the_list_has_them_if_it_is_verbose(tmp_path: Path) -> None:
    scene = write(tmp_path, box())
    best = json.loads(needleplan("entry", scene, "--json", "--top", 1).stdout)["entries"][0]
    shown = f"nearest to path 1: vessel {best['obstacles_mm']['vessel']:.1f} mm"
    assert shown in needleplan("entry", scene, "--verbose", "--top", 1).stdout
