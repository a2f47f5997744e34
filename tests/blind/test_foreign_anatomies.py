"""The foreign anatomies: sizes, shares of the labels, connections, and their own files."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.blind.foreign_anatomies import NAMES, THINNEST_MM, ForeignAnatomy, Organ, foreign_anatomy, tree
from tests.blind.volume_files import GAUGES_MM, read_anatomy
from tests.blind.voxel_tracer import Ball


@cache
def drawn(organ: Organ, seed: int = 31) -> ForeignAnatomy:
    return foreign_anatomy(organ, seed)


def millilitres(anatomy: ForeignAnatomy, name: str) -> float:
    volume = anatomy.volume
    return float((volume.labels == NAMES[name]).sum() * volume.spacing.prod() / 1000.0)


@pytest.mark.parametrize("organ", Organ)
def test_the_volume_is_plausible(organ: Organ) -> None:
    anatomy = drawn(organ)
    volume = anatomy.volume
    size = volume.spacing * volume.labels.shape
    assert ((size > 120.0) & (size < 142.0)).all()
    assert ((volume.spacing >= 0.79) & (volume.spacing <= 1.21)).all()
    assert np.ptp(volume.spacing) > 0.01
    turned = np.abs(volume.affine[:3, :3] / volume.spacing).max(0)
    assert turned.min() < 0.999, "the axes are not oblique"
    assert 0.02 < volume.solid.mean() < 0.2
    assert millilitres(anatomy, "bone") > 20.0
    assert millilitres(anatomy, "vessel") > 3.0
    assert (millilitres(anatomy, "bronchus") > 3.0) == (organ is Organ.LUNG)
    ball = 4.0 / 3.0 * np.pi * anatomy.target_radius_mm**3 / 1000.0
    assert 0.6 * ball < millilitres(anatomy, "target") < 1.05 * ball
    assert 60.0 <= anatomy.organ_radius_mm <= anatomy.curvature_radius_mm + 30.0 <= 130.0


@pytest.mark.parametrize("organ", Organ)
def test_the_entry_is_at_the_skin_or_in_the_burr_hole(organ: Organ) -> None:
    anatomy = drawn(organ)
    volume = anatomy.volume
    if not isinstance(anatomy.entry, Ball):
        # Entry voxels are within three voxels of the air.
        entry = np.argwhere(volume.labels == NAMES["entry"])
        air = volume.labels == NAMES["air"]
        for place in entry[:: len(entry) // 50]:
            box = tuple(slice(max(k - 4, 0), k + 5) for k in place)
            assert air[box].any()
        return
    place = volume.local(np.array([anatomy.entry.center_mm]))[0] / volume.spacing
    assert volume.labels[tuple(np.round(place).astype(int))] == NAMES["wall"]  # and not bone


def test_branches_divide_and_become_thin() -> None:
    pieces = tree(np.random.default_rng(0), np.zeros(3), np.array([0.0, 0.0, 1.0]), 4.0, lambda p: p[:, 2] < 200.0)
    starts = {tuple(np.round(start, 6)) for start, _, _ in pieces}
    ends = {tuple(np.round(end, 6)) for _, end, _ in pieces}
    assert (starts - ends) == {(0.0, 0.0, 0.0)}, "a piece begins beside the tree"
    assert len(pieces) - len(starts) > 20  # divisions
    radii = np.array([radius for _, _, radius in pieces])
    assert radii.max() == 4.0
    assert 0.8 * THINNEST_MM < radii.min() < 1.3 * THINNEST_MM


@pytest.mark.parametrize("organ", Organ)
@pytest.mark.parametrize("gauge", [None, 20])
def test_the_file_says_what_was_drawn(organ: Organ, gauge: int | None, tmp_path: Path) -> None:
    anatomy = drawn(organ)
    filed = read_anatomy(anatomy.write(tmp_path, gauge))
    np.testing.assert_array_equal(filed.volume.labels, anatomy.volume.labels)
    np.testing.assert_allclose(filed.volume.affine, anatomy.volume.affine, atol=1e-5)
    assert filed.volume.obstacles == anatomy.volume.obstacles
    assert filed.target == NAMES["target"]
    assert filed.diameter_mm == filed.cleared_mm == (0.0 if gauge is None else GAUGES_MM[gauge])


def test_an_anatomy_is_its_seed() -> None:
    first, second = foreign_anatomy("brain", 3), foreign_anatomy("brain", 3)
    np.testing.assert_array_equal(first.volume.labels, second.volume.labels)
    assert first.entry == second.entry
    assert (first.volume.labels.shape, first.curvature_radius_mm) != (
        drawn(Organ.BRAIN).volume.labels.shape, drawn(Organ.BRAIN).curvature_radius_mm,
    )  # fmt: skip
