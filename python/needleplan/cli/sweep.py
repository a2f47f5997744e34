"""`needleplan sweep`: make the policy tables of a sweep."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json, print_summary, working
from needleplan.cli.options import add_answer
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.sweep import Sweep, TableSetReport

__all__ = ["add_to", "run", "unconverged_text"]

# Time (s) between lines of progress if standard error is a file, as that of a job on a cluster.
_LINE_S = 60.0

# Number of failures in the summary without --verbose.
_SHOWN_FAILURES = 3


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "sweep",
        help="make the policy tables of a sweep over scenario keys",
        description="Make the policy tables of a sweep that its folder does not have yet. Exit code 1: tables are "
        "missing; the next run makes them.",
    )
    parser.add_argument("sweep", metavar="SWEEP.toml", help="a sweep file, or the name of a shipped sweep")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="STORE",
        help="write into this folder: a new table set, or one to add to",
    )
    parser.add_argument(
        "--workers", type=whole, metavar="N", help="processes of this machine (default: one per processor)"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="run on the Dask cluster of this scheduler, such as tcp://10.0.0.5:8786"
    )
    parser.add_argument(
        "--array", metavar="K/N", help="make only the K-th of N parts, in one process unless --workers is given"
    )
    parser.add_argument(
        "--wait",
        type=float,
        default=60.0,
        metavar="S",
        help="longest time to wait for a scheduler or its workers, s (default: 60)",
    )
    parser.add_argument(
        "--check", action="store_true", help="read all tables that are there, and make damaged ones again"
    )
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 1 if tables are missing, else 0.

    Raises InputError (SweepError, ScenarioError, OutputError) for wrong options, sweeps, folders and clusters.
    """
    from needleplan.errors import SweepError
    from needleplan.sweep import Engine, Sweep, make_table_set

    part = _part(options.array)
    workers = options.workers or (1 if options.array and not options.scheduler else None)
    engine = Engine(options.scheduler, workers, options.wait)
    sweep = Sweep.read(options.sweep)
    with working(options, f"making {sweep.tables} tables") as tell:
        try:
            report = make_table_set(
                sweep,
                options.output,
                engine,
                part=part,
                check=options.check,
                progress=_Progress(tell),
                tell=note,
            )
        except SweepError as error:
            raise SweepError(error.mistakes, error.source or options.sweep) from None
    if options.json:
        print_json({"sweep": sweep.title, "store": options.output, **asdict(report), "complete": report.complete})
    else:
        _print(sweep, report, options)
    if report.stopped:
        return complain(f"{options.output}: given up: {report.stopped}; the finished tables stay, run again to go on")
    if report.missing:
        return complain(f"{report.missing} tables are missing: the cluster was lost; run again to make them")
    if report.failures:
        return complain(f"{len(report.failures)} of {report.points} tables could not be made")
    return 0


def unconverged_text(statuses: Mapping[str, int]) -> str:
    """Return the text on tables that are not converged, by status: `needleplan plan` refuses them with exit code 1."""
    return ", ".join(f"{number} tables: {status.replace('_', ' ')}" for status, number in statuses.items())


class _Progress:
    """Shows how many tables have ended and how long the others will take; without a terminal, a line each minute."""

    def __init__(self, tell: Callable[..., None]) -> None:
        self._tell = tell
        self._began = self._printed = time.monotonic()
        self._before: int | None = None

    def __call__(self, done: int, of: int) -> None:
        """Take the number of tables that have ended and that of all tables of the run."""
        now = time.monotonic()
        self._before = done if self._before is None else self._before
        text = f"{done:,} of {of:,} tables"
        if done > self._before and done < of:
            text += f", {_duration((now - self._began) / (done - self._before) * (of - done))} left"
        self._tell(text, done / max(of, 1))
        if now - self._printed > _LINE_S and not sys.stderr.isatty():
            self._printed = now
            note(text)


def _duration(seconds: float) -> str:
    """Return a duration as a text with one unit, such as `12 min`."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"


def _part(text: str | None) -> tuple[int, int]:
    """Return (k, n) of a text K/N; (1, 1) without a text. Raises InputError."""
    if text is None:
        return 1, 1
    number, _, parts = text.partition("/")
    if not (number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts)):
        raise InputError(Mistake("--array", text, "must be K/N with whole numbers, K from 1 to N"))
    return int(number), int(parts)


def _print(sweep: Sweep, report: TableSetReport, options: argparse.Namespace) -> None:
    made = f"{report.solved} solved, {report.present} there before"
    if report.read:
        made += f", {report.read} read again"
    lines = {"tables": f"{made}, of {report.points}"}
    if options.check:
        lines["checked"] = f"{report.checked} tables were read"
    if report.bytes:
        lines["size"] = f"{report.bytes / report.solved / 1e6:.2f} MB a table"
    if report.unconverged:
        lines["unconverged"] = unconverged_text(report.unconverged)
    shown = len(report.failures) if options.verbose else _SHOWN_FAILURES
    for number, (point, why) in enumerate(list(report.failures.items())[:shown]):
        lines["failed" if not number else " " * (number + 1)] = f"{point}: {why}"
    if len(report.failures) > shown:
        lines["..."] = f"{len(report.failures) - shown} more failures with --verbose"
    lines["table set"] = options.output
    print_summary(options, sweep.title or options.sweep, lines)
