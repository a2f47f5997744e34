"""`needleplan path`: one execution without noise."""

from __future__ import annotations

import argparse
from typing import Any

from needleplan.cli.answer import complain, note, percent, print_json, print_lines
from needleplan.cli.options import (
    add_figure,
    add_greedy,
    add_json,
    add_start,
    add_table,
    pose_record,
    require_outputs,
    start_pose,
)

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "path",
        help="execute a policy once, without noise",
        description="Execute a policy once, without noise. Exit code 1: the path does not reach the target.",
    )
    add_table(parser)
    add_start(parser)
    add_greedy(parser)
    add_figure(parser, "the path in the workspace")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    start = start_pose(options.start) if options.start is not None else None
    from needleplan.planning import Outcome, PolicyTable, Pose

    require_outputs([options.table], options.figure)
    table = PolicyTable.read(options.table)
    path = table.path(start or table.best_entry().pose, greedy=options.greedy)
    decision = table.lookup(*path.start)
    if options.figure:
        from needleplan.planning.drawing import path_figure
        from needleplan.plotting import save

        save(path_figure(table, path), options.figure)
        note(f"drew {options.figure}")
    turns = [Pose.of(turn) for turn in path.turns.tolist()]
    if options.json:
        print_json(
            {
                "start": pose_record(path.start),
                "outcome": str(path.outcome),
                "length_mm": path.length_mm,
                "cost": path.cost,
                "turns": [pose_record(turn) for turn in turns],
                "poses": path.poses.tolist(),
                "predicted_success": decision.success,
                "predicted_value": decision.value,
            }
        )
    else:
        lines = {
            "start": str(path.start),
            "outcome": str(path.outcome),
            "length": f"{path.length_mm:.1f} mm in {len(path.actions)} steps",
            "turns": ", ".join(f"({turn.x_mm:.1f}, {turn.y_mm:.1f})" for turn in turns) or "none",
            "end": str(Pose.of(path.poses[-1].tolist())),
            "with noise": f"predicted success {percent(decision.success)}, cost {decision.value:.4g}",
        }
        print_lines(table.scenario.title or options.table, lines)
    if path.outcome is not Outcome.TARGET:
        return complain(f"the path does not reach the target: {path.outcome}")
    return 0
