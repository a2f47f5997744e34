"""Compiled executions in 3D against their slow twin in NumPy, and against the rollouts whose runs they are."""

import numpy as np
import pytest

from needleplan.anatomy import SpaceScenario
from needleplan.errors import PoseError
from needleplan.planning import SpaceTable, plan_space
from tests.anatomy.volumes import TEXT, anatomy, box
from tests.planning.numpy_paths import twin_path

NOISY = TEXT.replace("radius_mm = 60.0", "radius_mm = 60.0\ntip_noise_deg = 6.0")
CURVED = NOISY.replace("[needle]", '[[anatomy.curvature]]\nlabel = "entry"\nradius_mm = 45.0\n[needle]')
BALL = NOISY.replace('target = "target"', "target = { center_mm = [19.0, 21.0, 51.5], radius_mm = 3.7 }")


@pytest.fixture(scope="module", params=[NOISY, CURVED, BALL], ids=["label", "two radii", "ball"])
def table(request: pytest.FixtureRequest) -> SpaceTable:
    return plan_space(SpaceScenario.of(anatomy(box(), request.param)), threads=1)


def test_paths_without_noise_are_those_of_the_twin(table: SpaceTable) -> None:
    random = np.random.default_rng(3)
    chosen = np.concatenate([table.entry_poses] * 2)
    same = 0
    for pose in chosen:
        shift = random.uniform([0, -0.9, -0.9], 0.9)
        tilted = pose + np.concatenate([shift, random.uniform(-0.05, 0.05, 3)])
        tilted[3:] /= np.linalg.norm(tilted[3:])
        path, twin = table.path(tilted), twin_path(table, tilted)
        points = path.points_mm
        assert np.allclose(points[0], tilted[:3])
        # In a ball, a path ends in the middle of its last chord, which is up to a third of a mm long.
        near_mm = 0.3 if table.scenario.grid.target.ball else 0.05
        same += (
            (path.outcome == "target") == (twin.end == 1)
            and abs(path.length_mm - twin.length_mm) < near_mm
            and np.linalg.norm(points[-1] - twin.point_mm) < near_mm
            and abs(len(path.turns) - twin.rotations) <= 2
        )
        assert path.length_mm == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), rel=1e-3)
    # Where two actions cost nearly the same, rounding decides between them, and the paths part.
    assert same >= len(chosen) - 2


@pytest.mark.slow
def test_executions_are_the_first_runs_of_a_rollout(table: SpaceTable) -> None:
    start = table.best_entry()
    found = table.executions(start, 50, seed=4)
    runs = table.solved.rollout(np.array([start.pose]), runs=300, seed=4)
    assert np.array_equal(found.outcomes, runs["outcome"][:50])
    assert np.array_equal(found.turns, runs["turns"][:50])
    # A rollout ends with the piece in which it meets something, a path where it meets it.
    assert (found.length_mm <= runs["length_mm"][:50] + 1e-9).all()
    assert (found.length_mm >= runs["length_mm"][:50] - 1.5).all()
    for run in range(50):
        code = table.scenario.codes(found.points(run)[:-1])
        assert (code == 0).all()
        last = table.scenario.codes(found.points(run)[-1])
        assert (last == 1) == found.reached[run]
    assert 0 < found.reached.sum() < 50


def test_a_pose_beyond_the_voxels_is_refused(table: SpaceTable) -> None:
    pose = np.array(table.best_entry().pose)
    size = table.scenario.grid.voxel_mm
    assert table.path((-0.49 * size, *pose[1:])).points_mm[0, 0] == -0.49 * size
    with pytest.raises(PoseError, match="must lie in the lattice"):
        table.path((-0.51 * size, *pose[1:]))


def test_executions_do_not_depend_on_the_number_of_threads(table: SpaceTable) -> None:
    poses = table.entry_poses[:7]
    one, many = (table.solved.paths(poses, seed=2, threads=threads) for threads in (1, 3))
    assert all(np.array_equal(one[name], many[name]) for name in one)


@pytest.mark.study
def test_executions_succeed_as_often_as_those_of_the_twin(table: SpaceTable) -> None:
    start, random = np.array(table.best_entry().pose), np.random.default_rng(8)
    twins = [twin_path(table, start, random) for _ in range(120)]
    runs = table.executions(start, 4000, seed=1)
    share = np.mean([twin.end == 1 for twin in twins])
    # Three standard deviations of the difference.
    assert share == pytest.approx(runs.reached.mean(), abs=3 * np.sqrt(0.25 / 120 + 0.25 / 4000))
    assert np.mean([twin.length_mm for twin in twins]) == pytest.approx(runs.length_mm.mean(), rel=0.03)
