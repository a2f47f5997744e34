"""Tables 6.2 and 6.3 and the plain value iteration, published beside ours."""

from __future__ import annotations

from needleplan.planning import PolicyTable, Stats
from needleplan.reports.comparison import Agreement, Comparison, measured
from needleplan_thesis.chapter6.published import (
    OTHER_MACHINE,
    OTHER_SCENE,
    TABLE_6_2,
    TABLE_6_3,
    VALUE_ITERATION,
)
from needleplan_thesis.chapter6.solves import Solves, processed_states

__all__ = ["name_of", "solving_seconds", "tables"]


def tables(solves: Solves) -> list[Comparison]:
    """Return the rows of Table 6.2, those of Table 6.3 and the plain value iteration."""
    return [*_table_6_2(solves), *_table_6_3(solves), *_plain(solves)]


def name_of(partitions: tuple[int, int], priority: str = "") -> str:
    """Return `(12, 8) H2`, as the tables of the thesis have it."""
    return f"({partitions[0]}, {partitions[1]}) {priority}".strip()


def solving_seconds(stats: Stats) -> float:
    """Return the time that the thesis counts: solving and priorities, without geometry and without the evaluation."""
    return stats.seconds_solving + stats.seconds_priorities


def _table_6_2(solves: Solves) -> list[Comparison]:
    rows = []
    for row in TABLE_6_2:
        stats = solves.partitioned[row.partitions, row.priority].stats
        name = f"ch6/table 6.2/{name_of(row.partitions, row.priority)}"
        rows += [
            measured(f"{name}/ts, solving", row.solving_s, stats.seconds_solving, "s", OTHER_MACHINE),
            measured(f"{name}/tc, priorities", row.priorities_s, stats.seconds_priorities, "s", OTHER_MACHINE),
            measured(f"{name}/total", row.total_s, solving_seconds(stats), "s", OTHER_MACHINE),
            _ours(f"{name}/visits of partitions", stats.partitions_processed, "visits"),
            _ours(f"{name}/backups", stats.backups, "backups"),
        ]
    return rows


def _table_6_3(solves: Solves) -> list[Comparison]:
    rows = []
    for partitions, (processed, states) in TABLE_6_3.items():
        table = next(table for (each, _), table in solves.partitioned.items() if each == partitions)
        name = f"ch6/table 6.3/{name_of(partitions)}"
        count = partitions[0] * partitions[1]
        exact = Agreement.REPRODUCED if table.stats.partitions == count else Agreement.NOT_REPRODUCED
        edge = f"{OTHER_SCENE}; ours counts the grid points of all edges"
        rows += [
            Comparison(f"{name}/partitions", count, table.stats.partitions, "partitions", exact),
            measured(f"{name}/processed partitions", processed, len(table.stats.order), "partitions", OTHER_SCENE),
            measured(f"{name}/processed states", states, processed_states(table), "states", edge),
        ]
    return rows


def _plain(solves: Solves) -> list[Comparison]:
    published, stats = VALUE_ITERATION, solves.plain.stats
    name = "ch6/section 6.4/value iteration"
    why = f"Jacobi sweeps from V = 0 to ||B|| < (1 - discount) lambda; {OTHER_SCENE}"
    rate = stats.backups / solving_seconds(stats)
    return [
        measured(f"{name}/sweeps", published.sweeps, stats.sweeps, "sweeps", why),
        measured(f"{name}/updates", published.updates, stats.backups, "backups", why),
        measured(f"{name}/time", published.seconds, solving_seconds(stats), "s", OTHER_MACHINE),
        measured(f"{name}/rate", published.updates_per_second, rate, "backups/s", OTHER_MACHINE),
        *_sweep(solves.sweep),
    ]


def _sweep(table: PolicyTable) -> list[Comparison]:
    name = "ch6/section 6.4/directional sweeps"
    return [
        _ours(f"{name}/sweeps", table.stats.sweeps, "sweeps"),
        _ours(f"{name}/updates", table.stats.backups, "backups"),
        _ours(f"{name}/time", solving_seconds(table.stats), "s"),
    ]


def _ours(identity: str, ours: float, unit: str) -> Comparison:
    return Comparison(identity, None, ours, unit, Agreement.OURS, "")
