"""The four-obstacle problem of the thesis as arrays, in the formats that solvers of sparse MDPs accept.

Every solver of `compare_peers.py` gets these arrays: two rows for every state (insert; rotate, then insert), row
2 s + a for action a of state s. The last state is the end of an execution. This state, obstacle points and target
points are absorbing: both rows lead back to the state without cost. The stage cost contains all expected costs of a
step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from needleplan.planning import lattice_of
from needleplan.scenario import Scenario

SCENARIO = "four_obstacles_thesis"


@dataclass(frozen=True)
class Problem:
    """A sparse MDP with two actions in every state: minimise the expected discounted cost."""

    row_offsets: NDArray[np.int64]
    successors: NDArray[np.int32]
    probabilities: NDArray[np.float64]
    costs: NDArray[np.float64]
    discount: float
    tolerance: float
    folder: Path = Path()

    @property
    def states(self) -> int:
        """Number of states, including the end state."""
        return len(self.costs) // 2

    @property
    def threshold(self) -> float:
        """Bellman residual below which the solvers of the thesis stop."""
        return (1 - self.discount) * self.tolerance

    @cached_property
    def matrix(self) -> csr_array:
        """Transition probabilities, [2 states, states]."""
        shape = (2 * self.states, self.states)
        return csr_array((self.probabilities, self.successors, self.row_offsets), shape=shape)

    @cached_property
    def matrices(self) -> tuple[csr_array, csr_array]:
        """Transition probabilities of each action, [states, states]."""
        return self.matrix[0::2].tocsr(), self.matrix[1::2].tocsr()

    def backup(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values after one application of the Bellman operator."""
        q: NDArray[np.float64] = self.costs + self.discount * (self.matrix @ values)
        better: NDArray[np.float64] = q.reshape(-1, 2).min(axis=1)
        return better

    def write(self, folder: Path) -> None:
        """Write the arrays to a folder."""
        for name in ("row_offsets", "successors", "probabilities", "costs"):
            np.save(folder / f"{name}.npy", getattr(self, name))
        np.save(folder / "numbers.npy", np.array([self.discount, self.tolerance]))

    @classmethod
    def read(cls, folder: Path) -> Problem:
        """Read the arrays from a folder and keep the folder's path, because it also contains the scenario file."""
        names = ("row_offsets", "successors", "probabilities", "costs")
        arrays = {name: np.load(folder / f"{name}.npy") for name in names}
        discount, tolerance = np.load(folder / "numbers.npy").tolist()
        return cls(**arrays, discount=discount, tolerance=tolerance, folder=folder)


def scenario_at(spacing_mm: float, name: str = SCENARIO) -> Scenario:
    """Return a shipped scenario on a grid of another spacing."""
    scenario = Scenario.read(name)
    return replace(scenario, grid=replace(scenario.grid, spacing_mm=(spacing_mm, spacing_mm)))


def problem_of(scenario: Scenario) -> Problem:
    """Return a scenario with two actions per free state as arrays. Raises ValueError for other numbers of actions."""
    sparse = lattice_of(scenario).tabular()
    rows_of_state = np.diff(sparse["action_offsets"])
    alive = rows_of_state > 0
    if not (rows_of_state[alive] == 2).all():
        raise ValueError("a state has neither two actions nor none")
    kept = np.repeat(alive, 2)
    lengths = np.ones(2 * len(alive), dtype=np.int64)
    lengths[kept] = np.diff(sparse["row_offsets"])
    entries = np.repeat(kept, lengths)
    successors = np.repeat(np.arange(len(alive), dtype=np.int32).repeat(2), lengths)
    successors[entries] = sparse["successors"]
    probabilities = np.ones(len(successors))
    probabilities[entries] = sparse["probabilities"]
    costs = np.zeros(len(kept))
    costs[kept] = sparse["stage_costs"]
    offsets = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(lengths)])
    return Problem(offsets, successors, probabilities, costs, sparse["discount"], scenario.solver.tolerance)


@dataclass(frozen=True)
class Reference:
    """Reference values, the bound of their error, and the time to compute them (s)."""

    values: NDArray[np.float64]
    error_bound: float
    seconds: float


def reference_of(problem: Problem, scenario: Scenario, error: float = 2e-4) -> Reference:
    """Return values of `problem` with an error below `error`: lattice solver, then plain sweeps in double precision.

    The bound follows from the Bellman residual on the arrays, so it does not rely on the lattice solver.
    """
    began = perf_counter()
    solved = lattice_of(scenario).solve(method="sweep", partitions=(1, 1), priority="H2", tolerance=error)
    values = np.append(solved["values"].ravel().astype(np.float64), 0.0)
    while True:
        better = problem.backup(values)
        residual = float(np.abs(better - values).max())
        values = better
        bound = problem.discount * residual / (1 - problem.discount)
        if bound < error:
            return Reference(values, bound, perf_counter() - began)
