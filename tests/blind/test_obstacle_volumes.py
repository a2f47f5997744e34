"""The random volumes against flood fills, straight paths, and their own files."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path as File

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.obstacle_volumes import ENTRY, TARGET, Case, Kind, random_case
from tests.blind.volume_files import Format, read_volume, write_case
from tests.blind.voxel_distance import box_distances
from tests.blind.voxel_tracer import Ball, Path, trace

SMALL = 300_000  # voxels of a case that is filled in a test


def grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask and its neighbours across faces, edges and corners."""
    wide = mask.copy()
    for axis in range(3):
        rows, before = np.moveaxis(wide, axis, 0), np.moveaxis(wide.copy(), axis, 0)
        rows[1:] |= before[:-1]
        rows[:-1] |= before[1:]
    return wide


def connected(free: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Free voxels that a path reaches from free voxels of start, if it may also slip through edges and corners."""
    reached, size = start & free, 0
    while reached.sum() > size:
        size = int(reached.sum())
        reached = grown(reached) & free
    return reached


def region(case: Case, ball: Ball) -> NDArray[np.bool_]:
    """Voxels that contain a point of a ball."""
    volume = case.volume
    centres = np.argwhere(np.ones(volume.labels.shape, bool)) * volume.spacing
    middle = volume.local(np.array([ball.center_mm]))
    distance = box_distances(middle, centres - 0.5 * volume.spacing, centres + 0.5 * volume.spacing)
    return distance.reshape(volume.labels.shape) <= ball.radius_mm


def straight(case: Case) -> Path:
    ends = np.array([case.entry.center_mm, case.target.center_mm])
    return Path(ends, np.tile((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]), (2, 1)))


CASES = [(kind, seed) for kind in Kind for seed in range(100, 110)]


@cache
def drawn(kind: Kind, seed: int) -> Case:
    return random_case(seed, kind)


@pytest.mark.parametrize(("kind", "seed"), CASES)
def test_the_truth_is_in_the_voxels(kind: Kind, seed: int) -> None:
    case = drawn(kind, seed)
    volume = case.volume
    distance = np.linalg.norm(np.subtract(case.entry.center_mm, case.target.center_mm))
    assert 24.9 < distance < 50.1
    assert volume.labels.size <= 3_000_000
    assert set(volume.obstacles) <= set(np.unique(volume.labels).tolist())
    traces = trace(volume, [straight(case)], case.target, case.width_mm, 6.0)
    assert traces.ends_in_target[0]
    assert np.isinf(traces.leaves_mm[0])
    assert traces.touches[0] == case.closed
    if not case.closed:
        assert 2.0 * traces.nearest_mm[0] == pytest.approx(case.width_mm, abs=0.002)
        assert case.width_mm >= 0.5
    if case.by_label:
        assert {ENTRY, TARGET} <= set(np.unique(volume.labels).tolist())
    if volume.labels.size <= SMALL:
        free = ~volume.solid
        reached = connected(free, region(case, case.entry))
        assert (reached & region(case, case.target)).any() != case.closed


def test_both_truths_and_both_kinds_of_regions_are_drawn() -> None:
    cases = [drawn(kind, seed) for kind, seed in CASES]
    for kind in (Kind.TUBE, Kind.CAGE):
        assert {case.closed for case in cases if case.kind is kind} == {False, True}
    assert {case.by_label for case in cases} == {False, True}
    assert any(np.linalg.det(case.volume.affine) < 0.0 for case in cases)
    assert min(case.width_mm for case in cases if not case.closed) < 1.5
    assert max(case.width_mm for case in cases) > 4.0


@pytest.mark.parametrize("form", Format)
@pytest.mark.parametrize("seed", [100, 101, 102])
def test_files_hold_the_case(tmp_path: File, form: Format, seed: int) -> None:
    case = drawn(Kind.CAGE, seed)
    document = tomllib.loads(write_case(case, tmp_path, form, 1.5, 0.5, "[lattice]\nspacing_mm = 1.0").read_text())
    volume = read_volume(tmp_path / document["anatomy"]["file"], document["anatomy"]["obstacles"])
    np.testing.assert_array_equal(volume.labels, case.volume.labels)
    np.testing.assert_allclose(volume.affine, case.volume.affine, atol=1e-12)
    assert volume.obstacles == case.volume.obstacles
    assert document["needle"]["diameter_mm"] == 1.5
    assert document["anatomy"]["margin_mm"] == 0.5
    assert document["lattice"] == {"spacing_mm": 1.0}
    assert document["anatomy"]["target"] == (
        TARGET if case.by_label else {"center_mm": list(case.target.center_mm), "radius_mm": case.target.radius_mm}
    )


def test_a_case_is_its_seed() -> None:
    first, second = random_case(7, "tube"), random_case(7, "tube")
    np.testing.assert_array_equal(first.volume.labels, second.volume.labels)
    assert first.target == second.target
