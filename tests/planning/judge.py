"""The judge of a plan: a tracer and volumes that share no code with the planner."""

from pathlib import Path

import numpy as np

from needleplan.anatomy import Anatomy
from needleplan.errors import ScenarioError
from needleplan.planning import rank_entries
from tests.blind.obstacle_volumes import Kind, random_case
from tests.blind.volume_files import Format, read_volume, write_case
from tests.blind.voxel_tracer import Path as TracedPath
from tests.blind.voxel_tracer import trace

__all__ = ["COARSE", "judge_plan"]

# Number of the label of the target in the volumes.
_TARGET = 3
# A lattice with few states, for many volumes.
COARSE = "[lattice]\nspacing_mm = 2.0\ndirections_deg = 8.0"


def judge_plan(seed: int, kind: Kind, folder: Path, lattice: str = "", runs: int = 100) -> None:
    """Plan a random volume, and assert that what is told holds in the voxels of its file."""
    case = random_case(seed, kind)
    # No margin and a needle without thickness: nothing but the voxels of the file keeps the plan from an obstacle.
    file = write_case(case, folder, list(Format)[seed % 3], diameter_mm=0.0, more=lattice)
    try:
        entries = rank_entries(Anatomy.read(file))
    except ScenarioError as error:
        # A lumen without a free voxel of the lattice.
        assert kind is Kind.TUBE
        assert case.closed or case.width_mm < 1.5
        assert "no voxel of the lattice lies in it" in str(error)
        return
    volume = read_volume(next(folder.glob("case.*")), case.volume.obstacles)
    # The comparison of candidates by executions takes longer than all else.
    number, frame = entries.first() if runs >= 100 else int(entries.order[0]), entries.grid.frame
    estimate = entries.estimate(number, 2000 if runs >= 100 else 100)
    told = estimate.value
    found = entries.table.executions(entries.poses[number], runs, seed=seed)
    paths = [TracedPath(frame.world(found.points(run))) for run in range(runs)]
    traces = trace(volume, paths, _TARGET if case.by_label else case.target)
    assert not (traces.touches & found.reached).any(), "an execution that counts as a success crosses an obstacle"
    assert traces.ends_in_target[found.reached].all(), "an execution that counts as a success ends beside the target"
    if case.closed:
        # The control variate of the estimate has the mean zero, but scatters: the 95 % interval contains zero.
        assert estimate.interval is not None
        assert estimate.interval[0] == 0.0
        assert told < 0.01
        assert not found.reached.any()
        return
    assert not entries.impossible, "a proof that a passage refutes"
    if lattice == "" and case.width_mm > 2 * entries.grid.voxel_mm:
        assert told > 0.0
        # What is told is what is realised in the voxels of the file, but for chance: four standard errors.
        realised = np.isfinite(traces.target_mm).mean()
        assert abs(told - realised) < 0.01 + 4 * np.sqrt(0.25 / runs)
