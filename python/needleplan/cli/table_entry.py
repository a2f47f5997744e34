"""`needleplan entry TABLE.h5`: the best entry of a table in the plane, or the ranked entries of one in 3D."""

from __future__ import annotations

import argparse
from functools import singledispatch

from needleplan.cli.anatomy import require_no_anatomy, run_table_entries
from needleplan.cli.answer import by_table, complain, print_json, print_summary
from needleplan.cli.options import EDGES, entry_record, guide_line, guide_record
from needleplan.cli.plan import UNREACHABLE_SUCCESS
from needleplan.cli.uncertainty import (
    promise_lines,
    promise_record,
    promised,
    read_model,
    read_registered,
    read_uncertainty,
)
from needleplan.planning import PolicyTable, Pose, SpaceTable, Table
from needleplan.scenario import EntryPose, Identified

__all__ = ["run_entry"]


@singledispatch
def run_entry(table: Table, options: argparse.Namespace) -> int:
    """Run `entry` on a table and return the exit code: 1 if the target is unreachable, else 0."""
    raise NotImplementedError(type(table), options)


@run_entry.register(SpaceTable)
def _space_entry(table: SpaceTable, options: argparse.Namespace) -> int:
    return run_table_entries(table, options)


@run_entry.register(PolicyTable)
def _plane_entry(table: PolicyTable, options: argparse.Namespace) -> int:
    require_no_anatomy(options)
    options.edge = options.edge or EDGES[0]
    along = "y_mm" if options.edge in ("left", "right") else "x_mm"
    best = table.best_entry(options.edge, **{along: options.at})
    model = read_model(options.needle)
    guide = _guide(best.pose, model)
    planned_per_mm = 1 / table.scenario.needle.curvature_radius_mm
    uncertainty = read_uncertainty(options, read_registered(options.registration), model, planned_per_mm)
    promise = promised(table, uncertainty, best) if best.success >= UNREACHABLE_SUCCESS else None
    if options.json:
        more = guide_record(guide) if guide else {}
        print_json({"edge": options.edge, **entry_record(best)} | more | promise_record(promise))
    else:
        lines = {"best entry": str(best.pose), "success": f"{by_table(best.success)}, cost {best.value:.4g}"}
        if guide:
            lines["guide"] = guide_line(guide)
        lines |= promise_lines(promise)
        print_summary(options, table.scenario.title or options.table, lines)
    if best.success < UNREACHABLE_SUCCESS:
        return complain(f"the target cannot be reached from the {options.edge} edge")
    return 0


def _guide(tip: Pose, model: Identified | None) -> Pose | None:
    """Return the pose of the guide for an entry of the tip."""
    if model is None:
        return None
    from needleplan.planning import guide_pose

    return guide_pose(tip, model.entry or EntryPose())
