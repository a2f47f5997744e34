"""Options that several commands share, and the poses that they read and print."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from needleplan.errors import Mistake, PoseError

if TYPE_CHECKING:
    from needleplan.planning import Entry, Pose

__all__ = [
    "EDGES",
    "add_edge",
    "add_figure",
    "add_greedy",
    "add_json",
    "add_start",
    "add_table",
    "entry_record",
    "pose_record",
    "require_outputs",
    "start_pose",
]

EDGES = ("left", "right", "bottom", "top")


def add_table(parser: argparse.ArgumentParser) -> None:
    """Declare the policy table."""
    parser.add_argument("table", metavar="TABLE.h5", help="a policy table that `needleplan plan` wrote")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare the option that prints JSON."""
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def add_figure(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare the option that draws."""
    parser.add_argument("--figure", metavar="PNG", help=f"draw {what} (.png, .pdf or .svg)")


def add_start(parser: argparse.ArgumentParser) -> None:
    """Declare the pose at which an execution begins."""
    parser.add_argument(
        "--start",
        metavar="X,Y,DEG[,BEVEL]",
        help="position in mm, heading in degrees, bevel -1 or +1; without a bevel the better one, without a start the "
        "best entry on the left edge; write --start=-1,... where it begins with a minus",
    )


def add_greedy(parser: argparse.ArgumentParser) -> None:
    """Declare the option that decides from interpolated values."""
    parser.add_argument(
        "--greedy",
        action="store_true",
        help="decide by the values interpolated at the true pose, not by the policy of the nearest state",
    )


def add_edge(parser: argparse.ArgumentParser) -> None:
    """Declare the edge at which the needle enters."""
    parser.add_argument("--edge", choices=EDGES, default="left", help="edge of the workspace to enter at (left)")


def start_pose(text: str) -> tuple[float, ...]:
    """Return x_mm, y_mm, heading_rad and, where given, the bevel. Raises PoseError."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    bevel = numbers[3] if len(numbers) == 4 else 1
    if len(numbers) not in (3, 4) or not all(map(math.isfinite, numbers)) or abs(bevel) != 1:
        raise PoseError(Mistake("--start", text, "must be X,Y,DEG or X,Y,DEG,BEVEL: numbers with commas between them"))
    return (numbers[0], numbers[1], math.radians(numbers[2]), *numbers[3:])


def require_outputs(inputs: Iterable[str], figure: str | None, *others: str | None) -> None:
    """Raise OutputError, before the work, for what could not be written after it."""
    from needleplan.artifacts import require_different, require_writable

    outputs = [output for output in (*others, figure) if output]
    require_different(inputs, outputs)
    for output in outputs:
        require_writable(output)
    if figure:
        from needleplan.plotting import require_drawable

        require_drawable(figure)


def pose_record(pose: Pose) -> dict[str, Any]:
    """Return a pose for JSON."""
    return {
        "x_mm": pose.x_mm,
        "y_mm": pose.y_mm,
        "heading_rad": pose.heading_rad,
        "heading_deg": math.degrees(pose.heading_rad),
        "bevel": pose.bevel,
    }


def entry_record(entry: Entry) -> dict[str, Any]:
    """Return an entry for JSON."""
    return {**pose_record(entry.pose), "success": entry.success, "value": entry.value}
