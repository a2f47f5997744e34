"""The voxels that segments cross, against exact arithmetic; and executions that meet a voxel between two points."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.anatomy import OBSTACLE, OUTSIDE, TARGET, Anatomy, SpaceScenario, crossed_voxels
from needleplan.planning import SpaceTable, plan_space
from tests.anatomy.volumes import NAMES, TEXT, anatomy, box

# Length of a part of a segment (in segments) below which rounding decides whether a voxel is crossed or only touched.
TOUCHED = Fraction(1, 10**9)
# In single precision, so that places are not moved to another voxel when a half is added.
places = st.tuples(*[st.floats(-1.5, 1.5, width=32)] * 3)


def exact_part(start: np.ndarray, end: np.ndarray, voxel: tuple[int, ...]) -> tuple[Fraction, Fraction]:
    """Return the part of a segment in a voxel, from share to share; it is empty if the first one is larger."""
    low, high = Fraction(0), Fraction(1)
    for a, b, at in zip(map(Fraction, start.tolist()), map(Fraction, end.tolist()), voxel, strict=True):
        faces = at - Fraction(1, 2), at + Fraction(1, 2)
        if a == b:
            if not faces[0] <= a < faces[1]:
                return Fraction(1), Fraction(0)
            continue
        near, far = sorted((face - a) / (b - a) for face in faces)
        low, high = max(low, near), min(high, far)
    return low, high


@settings(deadline=None)
@given(places, places)
def test_no_voxel_is_missed_and_none_is_invented(one: tuple[float, ...], other: tuple[float, ...]) -> None:
    start, end = np.array(one), np.array(other)
    (voxels,), (shares,) = crossed_voxels(start[None], end[None])
    found = [tuple(each) for each in voxels.tolist()]
    assert found[0] == tuple(np.floor(start + 0.5))
    assert found[-1] == tuple(np.floor(end + 0.5))
    assert (abs(np.diff(voxels, axis=0)).sum(-1) == np.isfinite(shares[1:])).all()  # through faces only
    assert (np.diff(shares[np.isfinite(shares)]) >= 0).all()
    for voxel in product(range(-2, 3), repeat=3):
        low, high = exact_part(start, end, voxel)
        if high - low > TOUCHED:
            assert voxel in found
            assert abs(shares[found.index(voxel)] - float(low)) < 1e-9
        if voxel in found:
            assert high - low > -TOUCHED


@settings(deadline=None)
@given(st.lists(st.tuples(places, places), min_size=2, max_size=6))
def test_many_segments_are_as_one_by_one(ends: list[tuple[tuple[float, ...], tuple[float, ...]]]) -> None:
    start, end = (np.array(each) for each in zip(*ends, strict=True))
    voxels, shares = crossed_voxels(start, end)
    for row in range(len(ends)):
        (alone,), (alone_shares,) = crossed_voxels(start[row : row + 1], end[row : row + 1])
        count = len(alone)
        assert (voxels[row, :count] == alone).all()
        assert (voxels[row, count:] == alone[-1]).all()
        assert (shares[row, :count] == alone_shares).all()
        assert np.isinf(shares[row, count:]).all()


def noisy(labels: np.ndarray) -> Anatomy:
    return anatomy(labels, TEXT.replace("radius_mm = 60.0", "radius_mm = 60.0\ntip_noise_deg = 9.0"))


def table_of(labels: np.ndarray) -> SpaceTable:
    return plan_space(SpaceScenario.of(noisy(labels)), threads=1)


@pytest.mark.slow
def test_executions_end_at_the_first_voxel_that_is_not_free() -> None:
    table, volume = table_of(box()), noisy(box()).volume
    grid = table.scenario.grid
    found = table.executions(table.best_entry(), 60, seed=2)
    ends = set()
    for run in range(60):
        points = found.points(run) / grid.voxel_mm
        voxels, shares = crossed_voxels(points[:-1], points[1:])
        within = ((voxels >= 0) & (voxels < grid.voxels.shape)).all(-1)
        at = tuple(np.moveaxis(np.clip(voxels, 0, np.array(grid.voxels.shape) - 1), -1, 0))
        codes = np.where(within, grid.voxels[at], OUTSIDE)
        assert (codes[:-1] <= TARGET).all()
        if found.reached[run]:
            # The path ends within the target of the file, and no point before does.
            here = np.rint(volume.voxels(grid.frame.world(found.points(run)))).astype(int)
            is_target = volume.labels[tuple(here.T)] == NAMES["target"]
            assert is_target[-1]
            assert not is_target[:-1].any()
            assert (codes[-1] <= TARGET).all()
            ends.add(TARGET)
            continue
        # The end is on a face, so that rounding decides to which of its two voxels it belongs.
        assert (codes[-1][shares[-1] < 1 - 1e-9] <= TARGET).all()
        last = points[-1] + 1e-6 * (points[-1] - points[-2]) / np.linalg.norm(points[-1] - points[-2])
        cell = np.floor(last + 0.5).astype(int)
        code = grid.voxels[tuple(cell)] if ((cell >= 0) & (cell < grid.voxels.shape)).all() else OUTSIDE
        assert code != TARGET
        ends.add(int(code))
    assert TARGET in ends
    assert ends & {OBSTACLE, OUTSIDE}


def test_an_execution_from_the_target_or_an_obstacle_ends_at_once() -> None:
    table = table_of(box())
    grid = table.scenario.grid
    for code, reached in ((TARGET, True), (OBSTACLE, False)):
        cell = np.argwhere(grid.codes == code)[0]
        found = table.executions((*(cell * grid.frame.spacing_mm), 1.0, 0.0, 0.0), 3)
        assert found.reached.tolist() == [reached] * 3
        assert found.length_mm.tolist() == [0.0] * 3
