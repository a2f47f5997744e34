"""The solvers of needleplan, as contestants."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from contest import Answer, Prepare, Solve
from problem import Problem

import needleplan as npl
from needleplan.mdp import TabularMdp
from needleplan.mdp import solve as solve_tabular
from needleplan.planning import PolicyTable, lattice_of


def _facts(read: Callable[[str], Any]) -> dict[str, float]:
    names = ("sweeps", "partitions_processed", "residual", "error_bound", "seconds_solving", "seconds_priorities")
    facts = {name: float(read(name)) for name in names}
    if str(read("status")) != "converged":
        raise RuntimeError(f"ended with the status {read('status')}")
    return facts


def lattice(
    threads: int, method: str = "sweep", partitions: tuple[int, int] = (12, 8), priority: str = "H2"
) -> Prepare:
    """Return the `prepare` of a lattice solver; its build time is the time to compute the geometry."""

    def prepare(problem: Problem) -> Solve:
        scenario = npl.Scenario.read(problem.folder / "scenario.toml")
        built = lattice_of(scenario)
        tolerance = scenario.solver.tolerance

        def solve() -> Answer:
            solved = built.solve(
                method=method, partitions=partitions, priority=priority, tolerance=tolerance, threads=threads
            )
            return Answer(lambda: solved["values"], _facts(solved.get))

        return solve

    return prepare


def whole_way(problem: Problem) -> Solve:
    """Prepare a solver that goes from the scenario file to the table in memory: geometry, solve, policy, success."""

    def solve() -> Answer:
        table: PolicyTable = npl.plan(npl.Scenario.read(problem.folder / "scenario.toml"))
        return Answer(lambda: table.values, _facts(partial(getattr, table.stats)))

    return solve


def tabular(threads: int | None, method: str = "sweep") -> Prepare:
    """Return the `prepare` of the tabular solver; its build time is the time to copy and validate the arrays."""

    def prepare(problem: Problem) -> Solve:
        mdp = _tabular(problem)

        def solve() -> Answer:
            solved = solve_tabular(mdp, method=method, tolerance=problem.tolerance, threads=threads)
            return Answer(lambda: solved.values, _facts(partial(getattr, solved.stats)))

        return solve

    return prepare


def tabular_from_arrays(problem: Problem) -> Solve:
    """Prepare the tabular solver so that each timed solve also copies and validates the arrays."""

    def solve() -> Answer:
        solved = solve_tabular(_tabular(problem), tolerance=problem.tolerance)
        return Answer(lambda: solved.values, _facts(partial(getattr, solved.stats)))

    return solve


def _tabular(problem: Problem) -> TabularMdp:
    return TabularMdp.from_rows(
        action_offsets=np.arange(0, 2 * problem.states + 1, 2),
        row_offsets=problem.row_offsets,
        successors=problem.successors,
        probabilities=problem.probabilities,
        stage_costs=problem.costs,
        discount=problem.discount,
    )
