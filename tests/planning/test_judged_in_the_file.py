"""Plans judged in the voxels of the file, by a tracer and by volumes that share no code with the planner."""

from __future__ import annotations

from pathlib import Path

import pytest

from needleplan.anatomy import Anatomy
from needleplan.errors import ScenarioError
from needleplan.planning import rank_entries
from tests.blind.obstacle_volumes import Kind, random_case
from tests.blind.volume_files import Format, read_volume, write_case
from tests.blind.voxel_tracer import Path as TracedPath
from tests.blind.voxel_tracer import trace

_RUNS = 100
_SPACING_MM = 1.5
# Number of the label of the target in the volumes.
_TARGET = 3


def _judge(seed: int, kind: Kind, folder: Path) -> None:
    case = random_case(seed, kind)
    # No margin and a needle without thickness: nothing but the voxels of the file keeps the plan from an obstacle.
    file = write_case(
        case, folder, list(Format)[seed % 3], diameter_mm=0.0, more="[lattice]\nspacing_mm = 1.5\nstep_mm = 4.5"
    )
    try:
        entries = rank_entries(Anatomy.read(file))
    except ScenarioError as error:
        # A lumen without a grid point: the message says which spacing helps.
        assert kind is Kind.TUBE
        assert case.nominal_mm < 2 * _SPACING_MM
        assert "take a spacing below 1.5 mm" in str(error)
        return
    volume = read_volume(next(folder.glob("case.*")), case.volume.obstacles)
    number, frame = entries.first(), entries.grid.frame
    told = entries.estimate(number).value
    found = entries.table.executions(entries.poses[number], _RUNS, seed=seed)
    paths = [TracedPath(frame.world(found.points(run))) for run in range(_RUNS)]
    traces = trace(volume, paths, _TARGET if case.by_label else case.target)
    assert not (traces.touches & found.reached).any(), "an execution that counts as a success crosses an obstacle"
    assert traces.ends_in_target[found.reached].all(), "an execution that counts as a success ends beside the target"
    if case.closed:
        assert told == 0.0
        assert not found.reached.any()
    else:
        assert not entries.impossible, "a proof that a passage refutes"
        # In narrower ones the values between grid points may not show the way.
        if case.width_mm > 2 * entries.grid.voxel_mm + _SPACING_MM / 2:
            assert told > 0.0


@pytest.mark.parametrize("kind", list(Kind))
def test_a_closed_way_is_never_passed_and_an_open_one_is_found(kind: Kind, tmp_path: Path) -> None:
    _judge(4001, kind, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(Kind))
def test_many_random_volumes(kind: Kind, tmp_path: Path) -> None:
    for seed in range(5000, 5010):
        folder = tmp_path / str(seed)
        folder.mkdir()
        _judge(seed, kind, folder)
