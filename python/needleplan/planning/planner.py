"""From a scenario to a policy table."""

from __future__ import annotations

from time import perf_counter

from needleplan.errors import ScenarioError
from needleplan.planning.lattice import lattice_of
from needleplan.planning.memory import require_memory
from needleplan.planning.stats import Progress, Stats
from needleplan.planning.success import success_of
from needleplan.planning.table import PolicyTable
from needleplan.scenario import Scenario

__all__ = ["plan"]


def plan(scenario: Scenario, progress: Progress | None = None) -> PolicyTable:
    """Solve a scenario.

    `progress` is called now and then with the number of sweeps, the residual and the residual at which the solve ends;
    an exception that it raises stops the solve and comes out here, as does Ctrl-C. A solve that ends before it has
    converged returns its table; `table.stats.status` says so. Raises ScenarioError where the grid is too large.
    """
    require_memory(scenario)
    began = perf_counter()
    solver = scenario.solver
    lattice = lattice_of(scenario)
    try:
        solved = lattice.solve(
            method=solver.method.value,
            partitions=scenario.partitions,
            priority=solver.priority.value,
            tolerance=solver.tolerance,
            max_sweeps=solver.max_sweeps,
            time_limit_s=solver.time_limit_s,
            threads=solver.threads,
            progress=progress,
        )
        success = success_of(scenario, lattice, solved["policy"])
    except (ValueError, MemoryError) as error:
        raise ScenarioError(str(error)) from error
    stats = Stats.of(solved, scenario.states, perf_counter() - began)
    table = PolicyTable(solved["values"], solved["policy"], success, stats, scenario)
    vars(table)["lattice"] = lattice
    return table
