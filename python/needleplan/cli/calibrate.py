"""`needleplan calibrate`: determine the distance of a coil from the tip of its needle."""

from __future__ import annotations

import argparse
from typing import Any

from needleplan.cli.answer import complain, note, print_json, print_summary, working
from needleplan.cli.options import add_answer
from needleplan.cli.register import add_poses, pivot_lines, pivot_record, pose_noise, verdict_record

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "calibrate",
        help="calibrate a tracked needle: coil to tip (pivot calibration)",
        description="Compute the distance of the coil of a tracked needle from its tip, from poses while the needle "
        "pivots about its tip, and judge it. `needleplan register` calibrates from the same poses, and registers the "
        "tracker to the plan. Exit code 1: refused.",
    )
    parser.add_argument("poses", metavar="POSES", help="poses of the coil while the needle pivots, .csv")
    add_poses(parser)
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 0 if the calibration passed or was accepted, else 1."""
    from needleplan.estimation.registration import calibrate_needle

    with working(options, "calibrating"):
        noise = pose_noise(options)
        done = calibrate_needle(options.poses, noise, columns=options.columns, accepted=options.accept or "")
    record = {"verdict": verdict_record(done.verdict), "pivot": pivot_record(done.pivot), "remarks": done.remarks}
    if options.json:
        print_json(record)
    else:
        print_summary(options, "calibration", {**pivot_lines(done.pivot), "verdict": done.verdict.status.value})
        for remark in done.remarks:
            note(f"remark: {remark}")
    if not done.ok:
        return complain("refused: " + "; ".join(done.verdict.reasons))
    for reason in done.verdict.reasons:
        note(f"accepted in spite of {reason}")
    return 0
