"""The target as the user gave it, against the labels of the file."""

import numpy as np
import pytest

from needleplan.anatomy import Anatomy, AnatomyFile, LabelVolume, SpaceScenario
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
    assert np.array_equal(body.contains(start), is_target(anatomy, scenario, start))
    assert np.array_equal(scenario.codes(start) == 1, is_target(anatomy, scenario, start))
    moved = body.moved(np.array([4.0, -6.0, 2.0]))
    assert np.array_equal(moved.contains(start - [4.0, -6.0, 2.0]), body.contains(start))
