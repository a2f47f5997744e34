"""`needleplan predict`: the end of an insertion from its beginning and from earlier insertions."""

from __future__ import annotations

import argparse
from typing import Any

from needleplan.cli.answer import note, print_json, working
from needleplan.cli.data_options import add_reading, read_data
from needleplan.cli.needle_sensors import add_needle_sensors, read_needle_sensors
from needleplan.cli.options import add_answer
from needleplan.errors import InputError, Mistake

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "predict",
        help="predict the end of an insertion from its beginning",
        description="Predict where the tip will be at the end of an insertion without rotation, with a 95 % region, "
        "from the measured beginning of its path and from earlier insertions into the same tissue. Writes nothing. "
        "Exit code 1: the record goes to the end, and the measured end is outside of the region.",
    )
    parser.add_argument("path", metavar="PATH", help="file of the insertion that has begun, .csv, .h5 or .mat")
    parser.add_argument(
        "--earlier",
        dest="data",
        action="extend",
        nargs="+",
        required=True,
        metavar="DATA",
        help="files of the earlier insertions, in the order of their times; may be repeated",
    )
    parser.add_argument(
        "--depth", type=float, metavar="MM", help="depth of the end (default: the depth that all earlier ones reach)"
    )
    parser.add_argument("--until", type=float, metavar="MM", help="leave out samples of PATH beyond this depth")
    add_needle_sensors(parser, "files")
    add_reading(parser)
    add_answer(parser, verbose=False)
    parser.set_defaults(run=run, holdout=[], noise=[], reference=[])


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 1 if the measured end is outside of the region, else 0."""
    from needleplan.artifacts import json_values
    from needleplan.identification import predict_end
    from needleplan.signals import Role

    options.holdout = [options.path]
    with working(options, "predicting"):
        records = read_data(options)
        begun = [record for record in records if record.role is Role.HOLDOUT]
        if len(begun) != 1:
            raise InputError(Mistake("PATH", options.path, f"must hold one insertion, not {len(begun)}"))
        earlier = [record for record in records if record.role is Role.TRAIN]
        fibre, plane = read_needle_sensors(options)
        end = predict_end(
            begun[0], earlier, depth_mm=options.depth, until_mm=options.until, fibre=fibre, plane=plane,
            image_latency_s=options.image_delay or 0.0,
        )  # fmt: skip
    for remark in end.remarks:
        note(remark)
    if options.json:
        print_json(json_values(end.record()))
    else:
        print("\n".join(end.lines()))
    return 1 if end.inside is False else 0
