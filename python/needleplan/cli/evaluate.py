"""`needleplan evaluate`: how often the plan succeeds, predicted beside realised."""

from __future__ import annotations

import argparse
from typing import Any

from needleplan.cli.answer import complain, percent, print_json, print_lines
from needleplan.cli.options import add_greedy, add_json, add_start, add_table, pose_record, start_pose

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "evaluate",
        help="execute a policy many times, with noise",
        description="Execute a policy many times with tip noise in the continuous model; print the success with its "
        "confidence interval beside the prediction. Exit code 1: no run reached the target.",
    )
    add_table(parser)
    add_start(parser)
    parser.add_argument("--runs", type=int, default=10_000, metavar="N", help="number of executions (10000)")
    parser.add_argument("--seed", type=int, default=0, help="the same seed gives the same executions (0)")
    add_greedy(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    start = start_pose(options.start) if options.start is not None else None
    from needleplan.planning import PolicyTable

    table = PolicyTable.read(options.table)
    found = table.rollout(start or table.best_entry().pose, options.runs, options.seed, greedy=options.greedy)
    low, high = found.interval
    if options.json:
        print_json(
            {
                "start": pose_record(found.start),
                "runs": found.runs,
                "seed": found.seed,
                "greedy": options.greedy,
                "success": found.success,
                "confidence_interval": [low, high],
                "predicted_success": found.predicted_success,
                "outcomes": found.outcomes,
                "mean_turns": found.mean_turns,
                "mean_length_mm": found.mean_length_mm,
                "mean_cost": found.mean_cost,
                "predicted_cost": found.predicted_value,
            }
        )
    else:
        lines = {
            "start": str(found.start),
            "success": f"{percent(found.success)} of {found.runs:,} runs, 95 % interval {percent(low)} to "
            f"{percent(high)}; predicted {percent(found.predicted_success)}",
            "cost": f"{found.mean_cost:.5g}; predicted {found.predicted_value:.5g}",
            "outcomes": ", ".join(f"{outcome} {number:,}" for outcome, number in found.outcomes.items() if number),
            "mean": f"{found.mean_turns:.2f} turns, {found.mean_length_mm:.1f} mm",
        }
        print_lines(table.scenario.title or options.table, lines)
    if found.success == 0:
        return complain("no run reached the target")
    return 0
