"""The target as the user gave it, against the labels of the file and points along segments."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.anatomy import Anatomy, AnatomyFile, LabelVolume, SpaceScenario, TargetBody
from tests.anatomy.volumes import NAMES, TEXT, box

BALL = TEXT.replace('target = "target"', "target = { center_mm = [19.0, 21.0, 51.5], radius_mm = 3.7 }")


def oblique(text: str) -> Anatomy:
    """Return the box with a rotated, anisotropic affine; its ball is where its target is."""
    labels, (sine, cosine) = box(), (np.sin(0.4), np.cos(0.4))
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * [2.0, 2.2, 1.9], [5.0, -3.0, 8.0]
    x, y, z = (affine @ [9.5, 9.5, 25.5, 1.0])[:3].tolist()
    file = AnatomyFile.from_toml(text.replace("[19.0, 21.0, 51.5]", f"[{x}, {y}, {z}]"))
    return Anatomy(file, LabelVolume(labels, affine), NAMES)


def is_target(anatomy: Anatomy, scenario: SpaceScenario, points: np.ndarray) -> np.ndarray:
    """Return which points of the frame lie in the target, by the file."""
    world, region = scenario.grid.frame.world(points), anatomy.file.anatomy.target
    if not isinstance(region, str):
        return np.linalg.norm(world - region.center_mm, axis=-1) <= region.radius_mm
    inverse = np.linalg.inv(anatomy.volume.affine)
    index = np.rint(world @ inverse[:3, :3].T + inverse[:3, 3]).astype(int)
    shape = np.array(anatomy.volume.labels.shape)
    within = ((index >= 0) & (index < shape)).all(-1)
    return within & (anatomy.volume.labels[tuple(np.moveaxis(np.clip(index, 0, shape - 1), -1, 0))] == NAMES["target"])


@pytest.mark.parametrize("text", [TEXT, BALL])
def test_the_target_is_that_of_the_file(text: str) -> None:
    anatomy = oblique(text)
    scenario = SpaceScenario.of(anatomy)
    body, random = scenario.grid.target, np.random.default_rng(5)
    assert body is not None
    start = np.array(scenario.target_mm) + random.uniform(-10, 10, (4000, 3))
    end = start + random.uniform(-4, 4, (4000, 3))
    assert np.array_equal(body.contains(start), is_target(anatomy, scenario, start))
    assert np.array_equal(scenario.codes(start) == 1, is_target(anatomy, scenario, start))
    moved = body.moved(np.array([4.0, -6.0, 2.0]))
    assert np.array_equal(moved.contains(start - [4.0, -6.0, 2.0]), body.contains(start))
    enters, leaves = body.crossed(start, end)
    samples = np.linspace(0, 1, 401)
    along = is_target(anatomy, scenario, start[:, None] + samples[:, None] * (end - start)[:, None])
    known = along.any(-1)
    # Corners between two samples may be crossed unseen, but nothing is entered later than it is seen.
    assert np.isfinite(enters[known]).all()
    assert (np.isfinite(enters) & ~known).sum() < 0.02 * known.sum()
    first = samples[along[known].argmax(-1)]
    assert ((first - enters[known] < 1 / 200) & (first - enters[known] >= -1e-9)).mean() > 0.98
    assert (enters[known] <= first + 1e-9).all()
    within = (enters + leaves)[known] / 2
    middle = start[known] + within[:, None] * (end - start)[known]
    assert is_target(anatomy, scenario, middle).all()
    assert (enters == 0).sum() > 50 < (known & (enters > 0)).sum()


def test_a_ball_and_its_voxels_are_the_same_body() -> None:
    centre = (3.0, -2.0, 1.0)
    places = np.stack(np.meshgrid(*[np.arange(-30, 31)] * 3, indexing="ij"), -1) * 0.1
    inside = ((places**2).sum(-1) <= 2.5**2).astype(np.uint8)
    rows = np.column_stack([np.eye(3) / 0.1, 30.5 - np.array(centre) / 0.1])
    ball, voxels = TargetBody((*centre, 2.5), np.zeros((3, 4)), inside[:0]), TargetBody(None, rows, inside)
    random = np.random.default_rng(6)
    start, end = np.array(centre) + random.uniform(-5, 5, (2, 2000, 3))
    enters = [each.crossed(start, end)[0] for each in (ball, voxels)]
    both = np.isfinite(enters[0]) & np.isfinite(enters[1])
    assert both.sum() > 150
    # A voxel reaches less than its diagonal beyond the ball, where the segment may graze it.
    far = np.linalg.norm(end - start, axis=-1)[both] * abs(enters[0][both] - enters[1][both])
    assert np.median(far) < 0.1
    assert (np.isfinite(enters[0]) != np.isfinite(enters[1])).mean() < 0.03
