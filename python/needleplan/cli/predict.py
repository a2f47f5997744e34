"""`needleplan predict`: the end of an insertion from its beginning and from earlier insertions."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, print_json, working
from needleplan.cli.data_options import add_reading, read_data
from needleplan.cli.identify_options import sensors_at
from needleplan.cli.options import add_answer, numbers
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.models.path import ImagePlane

__all__ = ["add_to", "run"]

# Largest age (s) of an image, as in the settings of the tip filter.
_LONGEST_DELAY_S = 2.0


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
        "--earlier", dest="data", nargs="+", required=True, metavar="DATA", help="files of the earlier insertions"
    )
    parser.add_argument(
        "--depth", type=float, metavar="MM", help="depth of the end (default: the depth that all earlier ones reach)"
    )
    parser.add_argument("--until", type=float, metavar="MM", help="leave out samples of PATH beyond this depth")
    parser.add_argument(
        "--sensors",
        metavar="MM,MM",
        help="shape of the needle by curvature sensors at these distances from the tip",
    )
    parser.add_argument(
        "--image-plane",
        metavar="O,U,V",
        help="tip in ultrasound images: point of the image at 0, 0 in mm, and directions of its two axes, as nine "
        "numbers in the frame of the files",
    )
    parser.add_argument(
        "--image-delay", type=float, metavar="S", help="age of an image when it arrives, in s (default: 0)"
    )
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
        fibre = sensors_at(options.sensors) if options.sensors else None
        end = predict_end(
            begun[0], earlier, depth_mm=options.depth, until_mm=options.until, fibre=fibre, plane=_plane(options),
            image_latency_s=options.image_delay or 0.0,
        )  # fmt: skip
    for remark in end.remarks:
        note(remark)
    if options.json:
        print_json(json_values(end.record()))
    else:
        print("\n".join(end.lines()))
    return 1 if end.inside is False else 0


def _plane(options: argparse.Namespace) -> ImagePlane | None:
    """Return the image plane of `--image-plane`, or None without the option. Raises InputError or ModelError."""
    from needleplan.models.path import ImagePlane

    delay = options.image_delay
    if delay is not None and not (options.image_plane and 0 <= delay <= _LONGEST_DELAY_S):
        rule = f"must be from 0 to {_LONGEST_DELAY_S:g} s, with --image-plane"
        raise InputError(Mistake("--image-delay", f"{delay:g}", rule))
    if not options.image_plane:
        return None
    values = numbers("--image-plane", options.image_plane, 9)
    return ImagePlane(tuple(values[:3]), tuple(values[3:6]), tuple(values[6:]))
