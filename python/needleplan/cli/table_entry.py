"""`needleplan entry TABLE.h5`: the best entry of a table in the plane, or the ranked entries of one in 3D."""

from __future__ import annotations

import argparse
from functools import singledispatch

from needleplan.cli.anatomy import require_no_anatomy, run_table_entries
from needleplan.cli.answer import by_table, complain, print_json, print_summary
from needleplan.cli.options import EDGES, entry_record, guide_line, guide_record
from needleplan.cli.plan import UNREACHABLE_SUCCESS
from needleplan.planning import PolicyTable, Pose, SpaceTable, Table

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
    guide = _guide(table, best.pose, options.needle)
    if options.json:
        print_json({"edge": options.edge, **entry_record(best)} | (guide_record(*guide) if guide else {}))
    else:
        lines = {"best entry": str(best.pose), "success": f"{by_table(best.success)}, cost {best.value:.4g}"}
        if guide:
            lines["guide"] = guide_line(*guide)
        print_summary(options, table.scenario.title or options.table, lines)
    if best.success < UNREACHABLE_SUCCESS:
        return complain(f"the target cannot be reached from the {options.edge} edge")
    return 0


def _guide(table: PolicyTable, tip: Pose, file: str | None) -> tuple[Pose, float] | None:
    """Return the pose of the guide for an entry of the tip, and the success with the scatter of the entry.

    Returns None without a model file. Raises ModelError if the file is wrong or has no curvature.
    """
    if not file:
        return None
    from needleplan.models import ModelFile
    from needleplan.planning import guide_pose, success_over_entries
    from needleplan.scenario import EntryPose, identified

    entry = identified(ModelFile.read(file), file).entry or EntryPose()
    return guide_pose(tip, entry), success_over_entries(table, tip, entry)
