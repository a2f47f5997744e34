"""Plans judged in the voxels of the file, by a tracer and by volumes that share no code with the planner."""

from pathlib import Path

import pytest

from tests.blind.obstacle_volumes import Kind
from tests.planning.judge import COARSE, judge_plan


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(Kind))
def test_a_closed_way_is_never_passed_and_an_open_one_is_found(kind: Kind, tmp_path: Path) -> None:
    judge_plan(4001, kind, tmp_path)


@pytest.mark.study
@pytest.mark.parametrize("kind", list(Kind))
def test_many_random_volumes(kind: Kind, tmp_path: Path) -> None:
    for seed in range(5000, 5003):
        folder = tmp_path / str(seed)
        folder.mkdir()
        judge_plan(seed, kind, folder)


@pytest.mark.study
@pytest.mark.parametrize("kind", list(Kind))
def test_many_random_volumes_on_a_coarse_lattice(kind: Kind, tmp_path: Path) -> None:
    """The thousand are those of benches/python/space_volumes.py."""
    for seed in range(6000, 6010):
        folder = tmp_path / str(seed)
        folder.mkdir()
        judge_plan(seed, kind, folder, COARSE, runs=25)
