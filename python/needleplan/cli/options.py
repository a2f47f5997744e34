"""Options that several commands share, and reading and printing of poses."""

from __future__ import annotations

import argparse
import math
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.errors import InputError, Mistake, PoseError, SafetyError, TableError

if TYPE_CHECKING:
    from needleplan.config import Rule
    from needleplan.control.safety import SafetyLimits
    from needleplan.planning import Entry, Pose, Table
    from needleplan.scenario import Scenario

__all__ = [
    "EDGES",
    "add_answer",
    "add_edge",
    "add_figure",
    "add_force",
    "add_limits",
    "add_nearest",
    "add_output",
    "add_start",
    "add_table",
    "add_verify_key",
    "entry_record",
    "given_mistakes",
    "grid_line",
    "guide_line",
    "guide_record",
    "numbers",
    "options_named",
    "pose_record",
    "read_table",
    "require_absent",
    "require_ending",
    "require_free",
    "require_inputs_kept",
    "require_outputs",
    "require_rules",
    "require_table",
    "safety_limits",
    "sign_key",
    "split_numbers",
    "start_pose",
    "verify_key",
]

EDGES = ("left", "right", "bottom", "top")

# Largest heading on the command line (degrees): one full turn, as for headings in Python.
_FULL_TURN_DEG = 360.0


@contextmanager
def options_named(options: Mapping[str, str]) -> Iterator[None]:
    """Name options in the mistakes of a function instead of the arguments that they give; maps arguments to options."""
    try:
        yield
    except InputError as error:
        mistakes = [replace(mistake, key=options.get(mistake.key, mistake.key)) for mistake in error.mistakes]
        raise type(error)(mistakes, error.source) from None


def add_table(parser: argparse.ArgumentParser) -> None:
    """Declare the argument for the policy table."""
    parser.add_argument("table", metavar="TABLE.h5", help="a policy table that `needleplan plan` wrote")
    add_verify_key(parser)


def add_verify_key(parser: argparse._ActionsContainer) -> None:
    """Declare `--verify-key`, the key with which the policy table must be signed."""
    parser.add_argument("--verify-key", metavar="FILE", help="refuse a table that is not signed with this secret key")


def read_table(options: argparse.Namespace) -> Table:
    """Return the table that the options name, in the plane or in 3D; `--verify-key` demands its signature.

    A table whose signature is not verified may come from anybody, so a child process tries it first.
    """
    from needleplan.planning import Table

    require_table(options.table)
    return Table.read(options.table, verify_key=verify_key(options))


def require_table(file: str) -> None:
    """Raise TableError, which names the command to run first, if a scenario or an anatomy is given for a table."""
    from needleplan.artifacts import FileKind, file_format
    from needleplan.scenario import shipped

    kind = file_format(file).kind
    if kind is None and file in shipped() and not Path(file).is_file():
        kind = FileKind.SCENARIO
    if kind in (FileKind.SCENARIO, FileKind.ANATOMY):
        article = "an" if kind is FileKind.ANATOMY else "a"
        made = shlex.join(["needleplan", "plan", file, "-o", f"{Path(file).stem}.h5"])
        raise TableError(f"is {article} {kind}, and a policy table is needed: `{made}` makes one", file)


def verify_key(options: argparse.Namespace) -> bytes | None:
    """Return the key of `--verify-key`, or None. Raises InputError if it cannot be used."""
    from needleplan.artifacts import read_key

    return read_key(options.verify_key) if options.verify_key else None


def sign_key(options: argparse.Namespace) -> bytes | None:
    """Return the key of `--sign-key`, or None. Raises InputError if it cannot be used, or no table is written."""
    if not options.sign_key:
        return None
    if not options.output:
        raise InputError(Mistake("--sign-key", options.sign_key, "requires --output: a file is signed"))
    from needleplan.artifacts import read_key

    return read_key(options.sign_key)


def add_answer(parser: argparse._ActionsContainer, *, verbose: bool = True, json: bool = True) -> None:
    """Declare `--quiet`, and, if `json` or `verbose`, the options `--json` or `--verbose`."""
    if json:
        parser.add_argument("--json", action="store_true", help="print the answer as JSON")
    if verbose:
        parser.add_argument("-v", "--verbose", action="store_true", help="print all of the answer, not a summary")
    parser.add_argument(
        "-q", "--quiet", action="store_true", help="print neither progress nor remarks; errors are still printed"
    )


def add_output(parser: argparse._ActionsContainer, metavar: str, what: str, *, required: bool = False) -> None:
    """Declare `--output`, and `--force`, which allows overwriting files. `what` is the help text."""
    parser.add_argument("-o", "--output", required=required, metavar=metavar, help=what)
    add_force(parser)


def add_figure(parser: argparse._ActionsContainer, what: str) -> None:
    """Declare `--figure`, and `--force`, which allows overwriting files. `what` names the drawn things."""
    parser.add_argument("--figure", metavar="FILE", help=f"draw {what} (.png, .pdf or .svg)")
    add_force(parser)


def add_force(parser: argparse._ActionsContainer) -> None:
    """Declare `--force`, which allows overwriting files, unless it is declared already."""
    if "--force" not in parser._option_string_actions:
        parser.add_argument("--force", dest="overwrite", action="store_true", help="overwrite files that exist")


def add_start(parser: argparse._ActionsContainer, *, in_space: bool = False) -> None:
    """Declare `--start`, the pose at which an execution begins; if `in_space`, 3D tables have starts, too."""
    space = "; with a 3D table R,A,S,DR,DA,DS: position in RAS mm, and direction (default: the best entry)"
    parser.add_argument(
        "--start",
        metavar="X,Y,DEG[,BEVEL]",
        help="position in mm, heading in degrees, bevel -1 or +1 (default: the better bevel; without a start the best "
        "entry on the left edge)"
        f"{space if in_space else ''}",
    )


def add_limits(parser: argparse._ActionsContainer) -> None:
    """Declare `--limits`, a file of safety limits, and `--accept-limits`, without which lax limits are refused."""
    parser.add_argument("--limits", metavar="FILE", help="safety limits, in a table [safety]")
    parser.add_argument(
        "--accept-limits", metavar="REASON", help="why limits laxer than the defaults are accepted; a run records it"
    )


def safety_limits(options: argparse.Namespace) -> SafetyLimits:
    """Return the limits of the file of `--limits`, by default those of `SafetyLimits`.

    Raises SafetyError if the file is wrong, or if limits are laxer than the defaults and no reason is given.
    """
    from needleplan.control.safety import SafetyLimits

    limits = SafetyLimits.read(options.limits) if options.limits else SafetyLimits()
    reason = options.accept_limits
    if reason is not None and not reason.strip():
        raise InputError(Mistake("--accept-limits", "", "must be a reason, as a text"))
    try:
        limits.require_accepted(reason or "", "with --accept-limits REASON")
    except SafetyError as error:
        raise SafetyError(error.mistakes, options.limits) from None
    return limits


def add_nearest(parser: argparse.ArgumentParser) -> None:
    """Declare `--nearest`, which takes decisions and predictions from the nearest state of the table."""
    parser.add_argument(
        "--nearest",
        action="store_true",
        help="decide and predict by the nearest state of the table (the thesis), not by a look one step ahead",
    )
    # The name of the time when the look ahead was not the default; it has no effect.
    parser.add_argument("--greedy", action="store_true", help=argparse.SUPPRESS)


def add_edge(parser: argparse.ArgumentParser) -> None:
    """Declare `--edge`, the edge of the workspace at which the needle enters."""
    parser.add_argument("--edge", choices=EDGES, help=f"edge of the workspace to enter at (default: {EDGES[0]})")


def start_pose(text: str) -> tuple[float, ...]:
    """Return (x_mm, y_mm, heading_rad), followed by the bevel if the text contains a bevel.

    Raises PoseError if the text is not 3 or 4 finite numbers, the bevel is not -1 or 1, or the heading is beyond 360
    degrees.
    """
    found = split_numbers(text)
    bevel = found[3] if len(found) == 4 else 1
    if len(found) not in (3, 4) or abs(bevel) != 1:
        rule = "must be X,Y,DEG or X,Y,DEG,BEVEL: finite numbers with commas between them, BEVEL -1 or 1"
        raise PoseError(Mistake("--start", text, rule))
    if abs(found[2]) > _FULL_TURN_DEG:
        raise PoseError(Mistake("--start", text, "its heading must lie between -360 and 360 degrees"))
    return (found[0], found[1], math.radians(found[2]), *found[3:])


def numbers(option: str, text: str, *counts: int, form: str = "") -> list[float]:
    """Return the comma-separated numbers in `text`, the value of an option.

    `counts` are the allowed counts; `form` describes the value in the message. Raises InputError if the count is wrong
    or a number is not finite.
    """
    found = split_numbers(text)
    if len(found) not in counts:
        wanted = f"{form}:" if form else f"{counts[0]}"
        raise InputError(Mistake(option, text, f"must be {wanted} numbers with commas between them"))
    return found


def split_numbers(text: str) -> list[float]:
    """Return the comma-separated numbers in `text`, or an empty list if one of them is not a finite number."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        return []
    return found if all(map(math.isfinite, found)) else []


def guide_line(guide: Pose) -> str:
    """Return a line of text: the pose of the needle guide for the best entry."""
    return f"{guide}, for this entry of the tip"


def guide_record(guide: Pose) -> dict[str, Any]:
    """Return the pose of the needle guide for the best entry, as a JSON object with the key `guide`."""
    place = {"x_mm": guide.x_mm, "y_mm": guide.y_mm, "heading_rad": guide.heading_rad, "bevel": guide.bevel}
    return {"guide": place}


def require_outputs(options: argparse.Namespace, inputs: Iterable[str | None], *outputs: str | None) -> None:
    """Raise OutputError if an output cannot be written. Commands call this before their work begins.

    Parameters
    ----------
    options
        Options of the command. If the command has an option `figure`, its value is an output too and must end in .png,
        .pdf or .svg.
    inputs
        Files that the command reads; None is ignored. No output may replace one of these files. Files that only an
        input file names are the business of `require_inputs_kept`.
    outputs
        Files that the command writes; None is ignored. They must not exist, unless the user allows overwriting.

    """
    from needleplan.artifacts import require_different, require_writable

    figure = getattr(options, "figure", None)
    files = [output for output in (*outputs, figure) if output]
    options.checked_outputs = files
    require_different([file for file in inputs if file], files)
    for file in files:
        require_writable(file)
    require_free(options, files)
    if figure:
        from needleplan.plotting import require_drawable

        require_drawable(figure)


def require_inputs_kept(options: argparse.Namespace) -> None:
    """Raise OutputError if an output of `require_outputs` would replace any file that the command has read meanwhile.

    Commands whose input files name other files call this when they have read all of them, and before their work.
    """
    from needleplan.artifacts import require_unread

    require_unread(options.checked_outputs)


def given_mistakes(options: argparse.Namespace, names: Iterable[str], rule: str) -> list[Mistake]:
    """Return a mistake for each option that was given although another choice leaves no use for it.

    Parameters
    ----------
    options : argparse.Namespace
        Options of the command.
    names : iterable of str
        Options, such as `--speed`, without a default. Options that the command does not have are left out.
    rule : str
        Rule of the mistakes.

    Returns
    -------
    list of Mistake
    """
    values = {name: getattr(options, name.removeprefix("--").replace("-", "_"), None) for name in names}
    return [
        Mistake(name, "" if value is True else str(value), rule)
        for name, value in values.items()
        if value is not None and value is not False and value != []
    ]


def require_absent(options: argparse.Namespace, names: Iterable[str], rule: str) -> None:
    """Raise InputError with the mistakes of `given_mistakes`."""
    if mistakes := given_mistakes(options, names, rule):
        raise InputError(mistakes)


def require_rules(options: argparse.Namespace, rules: Mapping[str, Rule], *more: Mistake) -> None:
    """Raise InputError with the options whose values break their rules, and further mistakes.

    Parameters
    ----------
    options : argparse.Namespace
        Options of the command.
    rules : mapping
        Rules by option, such as `--speed`. An option that was not given is left out.
    *more : Mistake
        Further mistakes of the options.
    """
    from needleplan.config import mistakes_of

    if mistakes := [*mistakes_of(options, rules), *more]:
        raise InputError(mistakes)


def require_ending(option: str, file: str | None, *endings: str) -> None:
    """Raise InputError if the name of an output has none of these endings; None and devices have any name."""
    from needleplan.artifacts import is_device

    if file and not file.lower().endswith(endings) and not is_device(file):
        raise InputError(Mistake(option, file, f"must end in {' or '.join(endings)}"))


def require_free(options: argparse.Namespace, files: Iterable[str | os.PathLike[str]]) -> None:
    """Raise OutputError if one of the files exists and the user does not allow overwriting."""
    from needleplan.artifacts import expect_new, require_new

    new = [] if options.overwrite else list(files)
    require_new(new)
    expect_new(new)


def pose_record(pose: Pose) -> dict[str, Any]:
    """Return the JSON record of a pose."""
    return {
        "x_mm": pose.x_mm,
        "y_mm": pose.y_mm,
        "heading_rad": pose.heading_rad,
        "heading_deg": math.degrees(pose.heading_rad),
        "bevel": pose.bevel,
    }


def grid_line(scenario: Scenario) -> str:
    """Return what a summary says of the grid: its shape, the number of states, the transition and its refinement."""
    refined = f", solved {scenario.grid.refinement} times finer" if (scenario.grid.refinement or 1) > 1 else ""
    shape = " x ".join(map(str, scenario.shape))
    return f"{shape} = {scenario.states:,} states, {scenario.grid.transition}{refined}"


def entry_record(entry: Entry[Pose]) -> dict[str, Any]:
    """Return the JSON record of an entry."""
    from needleplan.planning import Success

    return {**pose_record(entry.pose), **Success(entry.success).record(), "value": entry.value}
