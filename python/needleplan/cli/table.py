"""The commands that read a policy table: `path`, `evaluate`, `entry` and `info`."""

from __future__ import annotations

import argparse
import math
from typing import Any

from needleplan.cli.anatomy import add_anatomy, is_anatomy, run_anatomy_entries
from needleplan.cli.answer import by_table, complain, note, one_line, percent, print_json, print_summary, working
from needleplan.cli.force_library import add_search, is_library, require_no_search, run_info
from needleplan.cli.interrupt import ended_at_once
from needleplan.cli.options import (
    add_answer,
    add_edge,
    add_figure,
    add_nearest,
    add_output,
    add_start,
    add_table,
    add_verify_key,
    options_named,
    read_table,
    require_outputs,
)
from needleplan.cli.parser import Parser, whole
from needleplan.cli.table_set_info import is_store, run_table_set_info
from needleplan.cli.uncertainty import add_uncertainty
from needleplan.errors import ChecksumError

__all__ = ["add_to"]


def add_to(commands: Any) -> None:
    """Declare the four commands."""
    for declare in (_add_path, _add_evaluate, _add_entry, _add_info):
        declare(commands)


def _add_path(commands: Any) -> None:
    """Declare `path`."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "path",
        help="execute a policy once, without noise",
        description="Execute a policy once, without noise. Exit code 1: the path does not reach the target.",
    )
    add_table(parser)
    add_start(parser, in_space=True)
    add_nearest(parser)
    add_figure(parser, "the path in the workspace")
    add_answer(parser)
    parser.set_defaults(run=_run_path)


def _run_path(options: argparse.Namespace) -> int:
    """Run `path` and return the exit code: 1 if the path does not reach the target, else 0."""
    from needleplan.cli.table_poses import poses_of
    from needleplan.planning import Outcome

    require_outputs(options, [options.table])
    table = read_table(options)
    poses = poses_of(table)
    how = poses.nearest_choice(options.nearest)
    path = table.path(poses.start(options.start), **how)
    decision = table.lookup(path.start, **how)
    if options.figure:
        from needleplan.plotting import legend_below, save, sheet

        figure, (axes,) = sheet(table.scenario.workspace, 1)
        legend_below(path.plot(axes))
        save(figure, options.figure)
        note(f"drew {options.figure}")
    turns = [poses.pose(turn) for turn in path.turns.tolist()]
    if options.json:
        print_json(
            {
                "start": poses.record(path.start),
                "outcome": str(path.outcome),
                "length_mm": path.length_mm,
                "straight_mm": path.straight_mm,
                "cost": path.cost,
                "clearance_mm": path.clearance_mm if math.isfinite(path.clearance_mm) else None,
                "turns": [poses.record(turn) for turn in turns],
                "poses": poses.rows(path.poses),
                "predicted_success": decision.success,
                "predicted_value": decision.value,
            }
        )
    else:
        lines = {
            "start": poses.text(path.start),
            "outcome": str(path.outcome),
            "length": f"{path.length_mm:.1f} mm{poses.steps_text(path)}, {len(turns)} turns"
            + (f", {path.straight_mm:.1f} mm straight" if path.straight_mm else ""),
            "with noise": f"predicted success {by_table(decision.success)}, cost {decision.value:.4g}",
        }
        more = {
            "turns": ", ".join(poses.place_text(turn) for turn in turns) or "none",
            "end": poses.text(path.end),
        }
        print_summary(options, table.scenario.title or options.table, lines, more)
    if path.outcome is not Outcome.TARGET:
        return complain(f"the path does not reach the target: {path.outcome}")
    return 0


def _add_evaluate(commands: Any) -> None:
    """Declare `evaluate`."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "evaluate",
        help="execute a policy many times, with noise",
        description="Execute a policy many times with tip noise in the continuous model, and print the success with "
        "its 95 % interval beside the predicted success. Exit code 1: no run reached the target.",
    )
    add_table(parser)
    add_start(parser, in_space=True)
    parser.add_argument("--runs", type=whole, default=10_000, metavar="N", help="number of executions (default: 10000)")
    parser.add_argument(
        "--seed", type=whole, default=0, metavar="N", help="seed; the same seed gives the same executions (default: 0)"
    )
    add_nearest(parser)
    add_answer(parser)
    parser.set_defaults(run=_run_evaluate)


def _run_evaluate(options: argparse.Namespace) -> int:
    """Run `evaluate` and return the exit code: 1 if no execution reached the target, else 0."""
    from needleplan.cli.table_poses import poses_of
    from needleplan.planning import disagrees

    table = read_table(options)
    poses = poses_of(table)
    how, start = poses.nearest_choice(options.nearest), poses.start(options.start)
    named = options_named({"runs": "--runs", "seed": "--seed"})
    with named, ended_at_once(), working(options, f"executing the policy {options.runs:,} times"):
        found = table.rollout(start, options.runs, options.seed, **how)
    low, high = found.interval
    if disagrees(found):
        predicted = f"the prediction, {percent(found.predicted_success)}, differs by more than chance and 2 points"
        note(f"{predicted} from the executions, {percent(low)} to {percent(high)}: {poses.better_prediction}")
    if options.json:
        print_json(
            {
                "start": poses.record(found.start),
                "runs": found.runs,
                "seed": found.seed,
                "nearest": options.nearest,
                "success": found.success,
                "confidence_interval": [low, high],
                "predicted_success": found.predicted_success,
                "outcomes": found.outcomes,
                "mean_turns": found.mean_turns,
                "mean_length_mm": found.mean_length_mm,
                "mean_straight_mm": found.mean_straight_mm,
                "mean_cost": found.mean_cost,
                "predicted_cost": found.predicted_value,
            }
        )
    else:
        lines = {
            "start": poses.text(found.start),
            "success": f"{percent(found.success)} of {found.runs:,} runs, 95 % interval {percent(low)} to "
            f"{percent(high)}; predicted {by_table(found.predicted_success)}",
            "cost": f"{found.mean_cost:.5g}; predicted {found.predicted_value:.5g}",
            "mean": f"{found.mean_turns:.2f} turns, {found.mean_length_mm:.1f} mm"
            + (f", {found.mean_straight_mm:.1f} mm straight" if found.mean_straight_mm else ""),
        }
        more = {"outcomes": ", ".join(f"{outcome} {number:,}" for outcome, number in found.outcomes.items() if number)}
        print_summary(options, table.scenario.title or options.table, lines, more)
    if found.success == 0:
        return complain("no run reached the target")
    return 0


def _add_entry(commands: Any) -> None:
    """Declare `entry`."""
    parser: Parser = commands.add_parser(
        "entry",
        help="find the best entry of a policy table, or rank the entries in 3D",
        description="Find the entry with the highest success, and among equals the lowest cost. In 3D, rank the points "
        "of the entry region; an anatomy, a file .toml with a segmented volume, is solved first. "
        "Exit code 1: the target is unreachable.",
    )
    parser.add_argument("table", metavar="FILE", help="a policy table (.h5) or an anatomy (.toml)")
    add_verify_key(parser)
    add_edge(parser)
    parser.add_argument("--at", type=float, metavar="MM", help="search only at this position on the edge")
    parser.add_argument(
        "--needle", metavar="MODEL.toml", help="model of the needle: also print the pose of its guide for this entry"
    )
    add_uncertainty(parser)
    add_anatomy(parser, whole)
    add_output(parser, "MAP.csv", "write all entry points in 3D, best first")
    add_figure(parser, "the entry map in 3D, and slices with the best path")
    add_answer(parser)
    parser.set_defaults(run=_run_entry)


def _run_entry(options: argparse.Namespace) -> int:
    """Run `entry` on a table or an anatomy; return the exit code: 1 if the target is unreachable, else 0."""
    if is_anatomy(options.table):
        return run_anatomy_entries(options)
    from needleplan.cli.table_entry import run_entry

    return int(run_entry(read_table(options), options))


def _add_info(commands: Any) -> None:
    """Declare `info`."""
    parser: Parser = commands.add_parser(
        "info",
        help="show what a table or a table set holds and verify its checksums, or search a force library",
        description="Show the contents of a table, or of a table set, and verify the checksums; or list and "
        "search a force library. Exit code 1: a checksum is wrong, or no combination of the library fits.",
    )
    parser.add_argument(
        "table", metavar="FILE",
        help="a policy table (.h5), the folder of a table set, a force library (.toml), or `published`",
    )  # fmt: skip
    add_verify_key(parser)
    add_search(parser)
    parser.add_argument("--print-scenario", action="store_true", help="print the scenario of the table as TOML")
    parser.rename("--scenario", "--print-scenario")
    add_answer(parser)
    parser.set_defaults(run=_run_info)


def _run_info(options: argparse.Namespace) -> int:
    """Run `info` and return the exit code: 1 if a checksum is wrong or no combination matches, else 0."""
    if is_library(options.table):
        return run_info(options)
    require_no_search(options)
    if is_store(options.table):
        return run_table_set_info(options)
    from needleplan.cli.table_info import table_lines, table_record
    from needleplan.planning import TABLE_FORMAT, is_signed

    try:
        table = read_table(options)
    except ChecksumError as error:
        if options.json:
            print_json({"table": options.table, "verified": False, "reason": str(error)})
        return complain(str(error))
    if options.print_scenario:
        print(table.scenario.to_toml(), end="")
        return 0
    signature = "verified" if options.verify_key else "not verified" if is_signed(options.table) else "none"
    if options.json:
        record = {
            "table": options.table, "verified": True, "signature": signature, "format": TABLE_FORMAT,
            "title": table.scenario.title, "scenario_digest": table.scenario.digest, "digest": table.digest,
        }  # fmt: skip
        print_json(record | table_record(table))
        return 0
    signed = "" if signature == "none" else f", signature {signature}"
    lines, details = table_lines(table)
    print_summary(
        options,
        one_line(table.scenario.title or options.table),
        {**lines, "digest": f"{table.digest}, checksums verified{signed}"},
        {"format": TABLE_FORMAT, "scenario": table.scenario.digest, **details},
    )
    return 0
