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


def test_a_missing_ompl_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    bench = importlib.import_module("compare_planners")
    monkeypatch.setattr(bench, "find_spec", lambda _: None)
    monkeypatch.setattr("sys.argv", ["compare_planners.py"])
    assert bench.main() == 2
    assert "python -m pip install ompl" in capsys.readouterr().err


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


def test_steps_of_a_policy_become_arcs(scenes: ModuleType, arcs: ModuleType, execute: ModuleType) -> None:
    scene = scenes.Scene("free", (((1, 1), (2, 1), (2, 2)),), (97.0, 75.0), (0.0, 75.0, 0.0))

    def decide(poses: Any, _: Any) -> Any:
        return np.where((poses[:, 0] < 23) | (poses[:, 0] > 71), 1.0, -1.0)

    path = execute.policy_arcs(arcs.Space(scene), decide, 1, 5.0)
    assert path[:2] == [(1, 25.0), (-1, 50.0)]
    assert len(path) == 3
    assert execute.measured(arcs.Space(scene), path).turns == 2


@pytest.fixture(scope="module")
def cells() -> ModuleType:
    return importlib.import_module("rrt_cells")


@pytest.fixture(scope="module")
def reach() -> ModuleType:
    return importlib.import_module("rrt_reach")


@pytest.fixture(scope="module")
def walled(scenes: ModuleType) -> Any:
    """A scene whose target is behind a wall, so that the needle stays at x below 48 mm."""
    wall = ((50.0, -5.0), (60.0, -5.0), (60.0, 155.0), (50.0, 155.0))
    block = ((20.0, 55.0), (34.0, 55.0), (34.0, 69.0), (20.0, 69.0))
    return scenes.Scene("wall", (wall, block), (100.0, 75.0), (0.0, 75.0, 0.1))


def test_no_path_leads_through_a_wall(walled: Any, reach: ModuleType) -> None:
    proof = reach.proof(walled)
    assert proof["infeasible"]
    assert len(proof["levels"]) == 1
    assert proof["levels"][0]["left"] == 0


@pytest.mark.slow
def test_a_target_in_reach_is_never_called_infeasible(
    walled: Any, scenes: ModuleType, arcs: ModuleType, execute: ModuleType, reach: ModuleType
) -> None:
    near = scenes.Scene("near", walled.obstacles, (38.0, 98.0), walled.start)
    assert execute.measured(arcs.Space(near), [(1, 60.0)]).event == arcs.Event.TARGET
    proof = reach.proof(near, grids=2)
    assert not proof["infeasible"]
    assert len(proof["levels"]) == 2


def test_random_paths_stay_in_the_reachable_cells(
    walled: Any, arcs: ModuleType, cells: ModuleType, reach: ModuleType
) -> None:
    grid, space, random = cells.grid(0), arcs.Space(walled), np.random.default_rng(3)
    alive = [grid.free(walled)] * grid.headings
    forward = reach.spread(grid, grid.containing(walled.start), alive)
    backward = reach.spread(grid, forward, alive, backward=True)
    poses, on, seen = np.tile(np.array(walled.start), (300, 1)), np.ones(300, dtype=bool), 0
    for _ in range(14):
        rest = np.full(300, grid.step_mm)
        while (rest > 0).any():  # the bevel changes at random places
            part = np.minimum(rest, random.exponential(3.0, 300))
            bevel = random.choice([-1.0, 1.0], 300)
            on &= space.events(poses, bevel, part)[0] == arcs.Event.NONE
            poses = np.where(on[:, None], arcs.advance(poses, bevel, part), walled.start)
            rest -= part
        for pose in poses[on]:
            here = grid.containing(tuple(pose))
            assert any(a & b for a, b in zip(here, forward, strict=True))
            assert any(a & b for a, b in zip(here, backward, strict=True))
        seen += on.sum()
    assert seen > 1000


def test_cells_before_the_target_hold_every_last_step(walled: Any, arcs: ModuleType, cells: ModuleType) -> None:
    grid, random = cells.grid(0), np.random.default_rng(4)
    last = grid.before_target(walled)
    angle = random.uniform(-np.pi, np.pi, 300)
    rim = np.array(walled.target) + 3.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    backward = np.column_stack([rim, random.uniform(-np.pi, np.pi, 300)])
    poses = arcs.advance(backward, random.choice([-1.0, 1.0], 300), random.uniform(0, grid.step_mm, 300))
    poses[:, 2] += np.pi  # a path that is inserted the other way round
    for pose in poses:
        assert any(a & b for a, b in zip(grid.containing(tuple(pose)), last, strict=True))
    assert sum(each.bit_count() for each in last) < 0.03 * grid.headings * grid.side**2


def test_cells_are_packed_and_refined(walled: Any, cells: ModuleType) -> None:
    coarse, fine = cells.grid(0), cells.grid(1)
    free = coarse.unpacked(coarse.free(walled))
    assert free[10, 75]
    assert not free[27, 62]
    assert not free[55].any()
    assert coarse.packed(free) == coarse.free(walled)
    start = coarse.containing(walled.start)
    refined = coarse.refined(start)
    assert len(refined) == fine.headings
    assert sum(each.bit_count() for each in refined) == 8 * sum(each.bit_count() for each in start)
    assert any(a & b for a, b in zip(refined, fine.containing(walled.start), strict=True))
