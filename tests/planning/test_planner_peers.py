"""The parts of the benchmark `compare_planners.py`: its scenes, its exact arcs and its executions."""

from __future__ import annotations

import ast
import hashlib
import importlib
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import shapely

BENCHES = Path(__file__).parents[2] / "benches" / "python"


@pytest.fixture(scope="module", autouse=True)
def _benches_are_found() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHES)
        yield


@pytest.fixture(scope="module")
def scenes() -> ModuleType:
    return importlib.import_module("rrt_scenes")


@pytest.fixture(scope="module")
def arcs() -> ModuleType:
    return importlib.import_module("rrt_arcs")


@pytest.fixture(scope="module")
def execute() -> ModuleType:
    return importlib.import_module("rrt_execute")


def test_scenes_and_simulation_know_nothing_of_needleplan() -> None:
    files = sorted(BENCHES.glob("rrt_*.py"))
    assert len(files) >= 5
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.split(".")[0] == "needleplan"], file


def test_scenes_are_determined_by_their_seed(scenes: ModuleType) -> None:
    text = json.dumps([each.to_json() for each in scenes.scenes()])
    assert len(scenes.scenes()) == 33
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "fc405a9f0a38d49e"


def test_inflated_obstacles_contain_the_margin_and_little_more(scenes: ModuleType) -> None:
    for scene in scenes.scenes(4):
        margin = shapely.buffer(scene.anatomy, scenes.MARGIN_MM, quad_segs=64)
        assert shapely.covers(scene.blocked, margin)
        assert shapely.covers(shapely.buffer(scene.anatomy, scenes.MARGIN_MM + 0.05, quad_segs=64), scene.blocked)
        again = scenes.Scene.from_json(json.loads(json.dumps(scene.to_json())))
        assert again.inflated == scene.inflated
        assert not shapely.intersects(scene.blocked, shapely.Point(scene.start[:2]).buffer(5))
        assert not shapely.intersects(scene.blocked, shapely.Point(scene.target).buffer(scenes.GOAL_TOLERANCE_MM))


@pytest.mark.parametrize("index", [0, 2, 4])
def test_first_events_agree_with_dense_samples(scenes: ModuleType, arcs: ModuleType, index: int) -> None:
    scene = scenes.scenes(3)[index]
    space = arcs.Space(scene)
    random = np.random.default_rng(index)
    poses = np.column_stack([random.uniform(0, 150, (400, 2)), random.uniform(-np.pi, np.pi, 400)])
    poses = poses[~shapely.intersects_xy(scene.blocked, *poses[:, :2].T)]
    bevel = random.choice([-1.0, 1.0], len(poses))
    event, distance = space.events(poses, bevel, 25.0)
    along = np.linspace(0, 25, 2501)
    for pose, sign, found, at in zip(poses, bevel, event, distance, strict=True):
        line = arcs.advance(np.repeat(pose[None], 2501, axis=0), np.full(2501, sign), along)
        x, y, _ = line.T
        target = np.hypot(x - scene.target[0], y - scene.target[1]) <= scenes.GOAL_TOLERANCE_MM
        outside = (x < 0) | (x > 150) | (y < 0) | (y > 150)
        touched = shapely.intersects_xy(scene.blocked, x, y)
        hits = np.flatnonzero(target | outside | touched)
        if not hits.size:  # a sample may miss a short event
            assert found == arcs.Event.NONE or _grazes(line, scene, at)
            continue
        expected = 1 if target[hits[0]] else 2 if touched[hits[0]] else 3
        assert found == expected or _grazes(line, scene, at)
        assert at <= along[hits[0]] + 1e-6
        assert at >= along[max(hits[0] - 1, 0)] - 1e-6 or _grazes(line, scene, at)
    assert {0, 2, 3} <= set(event.tolist())


def _grazes(line: Any, scene: Any, at: float) -> bool:
    """Whether the arc is within 0.01 mm of a boundary at the distance `at`."""
    x, y, _ = line[round(at / 0.01)]
    rim = min(abs(x), abs(y), abs(x - 150), abs(y - 150))
    return min(rim, shapely.Point(x, y).distance(scene.blocked.boundary)) < 0.01


def test_open_loop_without_noise_is_the_measured_path(
    scenes: ModuleType, arcs: ModuleType, execute: ModuleType
) -> None:
    space = arcs.Space(scenes.hand_made()[0])
    for path in ([(1, 30.0), (-1, 60.0), (1, 60.0)], [(-1, 90.0)], [(1, 7.0)]):
        alone = execute.measured(space, path)
        runs = execute.open_loop(space, path, execute.Noise(5.0, 0.1), 3, 0)
        assert runs.event.tolist() == [alone.event] * 3
        np.testing.assert_allclose(runs.length_mm, alone.length_mm)


def test_noise_has_its_probabilities(execute: ModuleType) -> None:
    noise = execute.Noise(5.0, 0.1, (0.466, 0.24, 0.027))
    changes = noise.draw(np.random.default_rng(0), 100_000) / 0.1
    shares = [np.isclose(changes, cell).mean() for cell in (-2, -1, 0, 1, 2)]
    np.testing.assert_allclose(shares, [0.027, 0.24, 0.466, 0.24, 0.027], atol=0.005)


def test_following_without_noise_stays_near_the_path(scenes: ModuleType, arcs: ModuleType, execute: ModuleType) -> None:
    scene = scenes.Scene("free", (((1, 1), (2, 1), (2, 2)),), (97.0, 75.0), (0.0, 75.0, 0.0))
    space = arcs.Space(scene)
    path = [(1, 25.0), (-1, 50.0), (1, 26.0)]
    assert execute.measured(space, path).event == arcs.Event.TARGET
    follow = execute.following(path, scene.start, 5.0)
    runs = execute.policy(space, follow, 1.0, execute.Noise(5.0, 0.1), 2, 0)
    assert runs.success == 1.0
