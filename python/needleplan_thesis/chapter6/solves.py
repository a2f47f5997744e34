"""Solving the problem of section 6.4 by every method: plain value iteration, the six of Table 6.2, and the sweeps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Method, Priority, Scenario
from needleplan_thesis.chapter6.published import TABLE_6_2

__all__ = ["Solves", "processed_states", "solve_all"]

Case = tuple[tuple[int, int], Priority]


@dataclass(frozen=True)
class Solves:
    """The tables of one scenario: by plain value iteration, by partitions and priority, by directional sweeps."""

    plain: PolicyTable
    partitioned: dict[Case, PolicyTable]
    sweep: PolicyTable


def solve_all(thesis: Scenario, note: Callable[[str], None]) -> Solves:
    """Solve `thesis` eight times, each on one thread, so that times compare."""

    def solved(method: Method, partitions: tuple[int, int] = (1, 1), priority: Priority = Priority.H1) -> PolicyTable:
        note(f"Tables 6.2 and 6.3: {method}" + (f", {partitions}, {priority}" if method is Method.PPVI else ""))
        solver = replace(thesis.solver, method=method, partitions=partitions, priority=priority, threads=1)
        return plan(replace(thesis, solver=solver))

    return Solves(
        plain=solved(Method.VALUE_ITERATION),
        partitioned={
            (row.partitions, row.priority): solved(Method.PPVI, row.partitions, row.priority) for row in TABLE_6_2
        },
        sweep=solved(Method.SWEEP),
    )


def processed_states(table: PolicyTable) -> int:
    """Return the number of states in the partitions that were processed at all (Table 6.3)."""
    nx, ny, headings, bevels = table.scenario.shape
    columns, rows = table.scenario.partitions
    widths = np.bincount(np.arange(nx) * columns // nx, minlength=columns)
    heights = np.bincount(np.arange(ny) * rows // ny, minlength=rows)
    points = np.outer(widths, heights).ravel()
    return int(points[list(table.stats.order)].sum()) * headings * bevels
