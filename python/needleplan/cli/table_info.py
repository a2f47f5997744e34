"""What `needleplan info` shows of a policy table, beside what all tables have."""

from __future__ import annotations

from dataclasses import asdict
from functools import singledispatch
from typing import Any

from needleplan.cli.answer import by_table
from needleplan.cli.options import grid_line
from needleplan.cli.plan_space import best_record
from needleplan.planning import PolicyTable, SpaceTable, Table

__all__ = ["table_lines", "table_record"]


@singledispatch
def table_record(table: Table) -> dict[str, Any]:
    """Return the numbers of a table for `--json`."""
    raise NotImplementedError(type(table))


@table_record.register(PolicyTable)
def _plane_record(table: PolicyTable) -> dict[str, Any]:
    scenario = table.scenario
    return {
        "shape": scenario.shape,
        "spacing_mm": scenario.grid.spacing_mm,
        "transition": scenario.grid.transition,
        "method": scenario.solver.method,
        **asdict(table.stats),
    }


@table_record.register(SpaceTable)
def _space_record(table: SpaceTable) -> dict[str, Any]:
    best = table.best_entry().pose
    return best_record(table, best, table.estimate(best))


@singledispatch
def table_lines(table: Table) -> tuple[dict[str, str], dict[str, str]]:
    """Return the lines on a table, and those for `--verbose`, by name."""
    raise NotImplementedError(type(table))


@table_lines.register(PolicyTable)
def _plane_lines(table: PolicyTable) -> tuple[dict[str, str], dict[str, str]]:
    scenario, stats = table.scenario, table.stats
    dx, dy = scenario.grid.spacing_mm
    return {
        "grid": f"{grid_line(scenario)}, spacing {dx:g} x {dy:g} mm",
        "solver": f"{scenario.solver.method}: {stats.status.replace('_', ' ')}, residual {stats.residual:.3g}, "
        f"error at most {stats.error_bound:.3g}",
        "success": f"{by_table(float(table.success.mean()))}, on average over all states",
    }, {
        "work": f"{stats.sweeps:.2f} sweeps, {stats.backups:,} backups, {stats.seconds:.3f} s",
        "values": f"{table.values.min():.4g} to {table.values.max():.4g}",
    }


@table_lines.register(SpaceTable)
def _space_lines(table: SpaceTable) -> tuple[dict[str, str], dict[str, str]]:
    scenario, stats, shape = table.scenario, table.stats, " x ".join(map(str, table.shape))
    return {
        "grid": f"{shape} = {stats.states:,} states (x, directions, y, z), spacing "
        f"{scenario.grid.frame.spacing_mm:g} mm, cone {scenario.file.lattice.cone_deg:g} deg",
        "solver": f"{stats.status.replace('_', ' ')}, {stats.seconds:.3f} s",
    }, {}
