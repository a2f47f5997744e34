"""`needleplan reproduce`: published numbers beside ours."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from itertools import groupby
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json

if TYPE_CHECKING:
    from needleplan.workflow.comparison import Comparison

__all__ = ["add_to", "run"]

_NAME, _NUMBER = 58, 14


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "reproduce",
        help="print published results beside ours",
        description="Print published tables beside ours, and draw the figures. Exit code 1: a goal of our own is "
        "missed; a published statement that does not hold for ours is an answer, not a failure.",
    )
    parser.add_argument("chapters", nargs="*", metavar="CHAPTER", help="ch6 (others follow); all where none is given")
    parser.add_argument("-o", "--figures", metavar="FOLDER", help="draw the figures into this folder")
    parser.add_argument(
        "--json", action="store_true", help="print a list of {id, published, ours, unit, verdict, reason}"
    )
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="coarse grids: whether everything runs, not the numbers")
    effort.add_argument("--full", action="store_true", help="finer grids besides; much longer")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from needleplan.workflow.comparison import Verdict
    from needleplan.workflow.reproduce import Effort, reproduce

    effort = Effort.QUICK if options.quick else Effort.FULL if options.full else Effort.DEFAULT
    comparisons = reproduce(options.chapters, options.figures, effort, note)
    if options.json:
        print_json([asdict(each) for each in comparisons])
    else:
        for line in _lines(comparisons):
            print(line)
    missed = [each.id for each in comparisons if each.verdict is Verdict.MISSED]
    return complain(f"{len(missed)} of our own goals missed: {'; '.join(missed)}") if missed else 0


def _lines(comparisons: Iterable[Comparison]) -> Iterator[str]:
    """Yield a table for every section, statements as paragraphs, and the reasons as numbered notes below."""
    for section, group in groupby(comparisons, key=lambda each: each.id.rsplit("/", each.id.count("/") - 1)[0]):
        rows, notes = list(group), dict[str, int]()
        yield ""
        yield section
        if any(not _spoken(row) for row in rows):
            yield f"  {'':{_NAME}} {'published':>{_NUMBER}} {'ours':>{_NUMBER}} {'ratio':>9}  {'unit':<14} verdict"
        for row in rows:
            mark = f" [{notes.setdefault(row.reason, len(notes) + 1)}]" if row.reason else ""
            yield from _row(row, row.id.removeprefix(f"{section}/"), mark)
        yield from (f"  [{number}] {reason}" for reason, number in notes.items())


def _row(row: Comparison, name: str, mark: str) -> Iterator[str]:
    if _spoken(row):
        yield f"  {name}: {row.verdict}{mark}"
        yield from (
            f"      {who:<10} {what}" for who, what in (("published", row.published), ("ours", row.ours)) if what
        )
        return
    ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
    numbers = f"{_number(row.published):>{_NUMBER}} {_number(row.ours):>{_NUMBER}} {ratio:>9}"
    yield f"  {name:<{_NAME}} {numbers}  {row.unit:<14} {row.verdict}{mark}"


def _spoken(row: Comparison) -> bool:
    return isinstance(row.published, str) or isinstance(row.ours, str)


def _number(number: float | str | None) -> str:
    if number is None:
        return "-"
    if isinstance(number, str) or number == int(number):
        return f"{number:,}" if not isinstance(number, str) else number
    return f"{number:,.1f}" if abs(number) >= 1000 else f"{number:.4g}"
