"""Dictionaries that functions of `_ppvi` return, a stub of its own; at run time there is no module of this name."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

class _SolveReport(TypedDict):
    """What `Lattice.solve` and `Tabular.solve` report, apart from the tables."""

    status: str
    residual: float
    error_bound: float
    backups: int
    sweeps: float
    partitions: int
    partitions_processed: int
    order: NDArray[np.uint32]
    seconds_solving: float
    seconds_priorities: float

class LatticeSolution(_SolveReport):
    """Result of `Lattice.solve`, arrays [nx, ny, headings, 2]."""

    values: NDArray[np.float32]
    policy: NDArray[np.uint8]

class TabularSolution(_SolveReport):
    """Result of `Tabular.solve`, arrays [states]."""

    values: NDArray[np.float64]
    policy: NDArray[np.uint32]

class SparseRowsResult(TypedDict):
    """Rows of a `Tabular`, as its constructor takes them."""

    row_offsets: NDArray[np.int64]
    successors: NDArray[np.uint32]
    probabilities: NDArray[np.float64]

class SuccessResult(TypedDict):
    """Probability of reaching the target, per state."""

    success: NDArray[np.float32]
    residual: float
    converged: bool
    error_bound: float

class ExpectationsResult(TypedDict):
    """Expected length and number of rotations until the execution ends, per state."""

    length_mm: NDArray[np.float32]
    turns: NDArray[np.float32]
    converged: bool

class RolloutResult(TypedDict):
    """Executions, each array [starts, runs]."""

    outcome: NDArray[np.uint8]
    length_mm: NDArray[np.float32]
    straight_mm: NDArray[np.float32]
    turns: NDArray[np.uint32]
    cost: NDArray[np.float64]

class ExecutionResult(TypedDict):
    """One execution: poses [k, 4], actions [k - 1]."""

    poses: NDArray[np.float64]
    actions: NDArray[np.uint8]
    outcome: int
    length_mm: float
    straight_mm: float
    turns: int
    cost: float

class SparseMdp(TypedDict):
    """An MDP in compressed sparse rows: rows of a state, entries of a row."""

    action_offsets: NDArray[np.int64]
    row_offsets: NDArray[np.int64]
    successors: NDArray[np.uint32]
    probabilities: NDArray[np.float64]
    stage_costs: NDArray[np.float64]
    discount: float

class DependenciesResult(TypedDict):
    """The maps of Table 6.1 of the thesis in compressed rows."""

    sds_offsets: NDArray[np.int64]
    sds: NDArray[np.uint32]
    pdp_offsets: NDArray[np.int64]
    pdp: NDArray[np.uint32]
    sdp_offsets: NDArray[np.int64]
    sdp: NDArray[np.uint32]

class SpaceReport(TypedDict):
    """Statistics of a pass over a volume; `first_slice` is the first finished slice, 0 if converged."""

    status: str
    first_slice: int
    backups: int
    seconds: float

class SpaceDecisions(TypedDict):
    """Best action and cost at n poses, arrays [n]."""

    action: NDArray[np.uint8]
    value: NDArray[np.float64]

class SpaceAnswers(SpaceDecisions):
    """Best action, cost and success probability at n poses, arrays [n]."""

    success: NDArray[np.float64]

class SpaceRolloutResult(TypedDict):
    """Executions from one pose, arrays [runs]."""

    outcome: NDArray[np.uint8]
    length_mm: NDArray[np.float64]
    straight_mm: NDArray[np.float64]
    turns: NDArray[np.uint32]
    cost: NDArray[np.float64]

class SpacePathsResult(SpaceRolloutResult):
    """Executions from n poses, arrays [n].

    `end` is the code of the voxel that ended the execution; `poses`, [k, 6], and `turn_rows` are of all paths, path i
    has the rows `bounds[i]` to `bounds[i + 1]`.
    """

    end: NDArray[np.uint8]
    poses: NDArray[np.float64]
    turn_rows: NDArray[np.int64]
    bounds: NDArray[np.int64]
