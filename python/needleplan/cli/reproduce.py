"""`needleplan reproduce`: compare computed with published results."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, print_json, working
from needleplan.cli.options import add_answer, add_output, require_free
from needleplan.cli.parser import add_old_spelling, whole

if TYPE_CHECKING:
    from needleplan.reports.comparison import Comparison

__all__ = ["add_to", "run"]

# Widths of the columns for names and numbers (characters).
_NAME, _NUMBER = 58, 14


def add_to(commands: Any) -> None:
    """Declare the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "reproduce",
        help="print published results beside computed ones",
        description="Print published results beside computed ones, and write the figures. The exit code is 0 also if a "
        "published statement does not hold.",
    )
    parser.add_argument(
        "chapters",
        nargs="*",
        metavar="CHAPTER",
        help="ch2, ch3, ch4, ch5, ch6, diagnosis (all)",
    )
    add_output(parser, "DIR", "write figures and results into this folder")
    parser.add_argument(
        "--experiments", action="store_true", help="ch6: repeat the experiments of section 6.5 in the lab twin"
    )
    parser.add_argument("--runs", type=whole, metavar="N", help="diagnosis: insertions for each hidden effect (40)")
    parser.add_argument(
        "--json", action="store_true", help="print a list of {id, published, ours, unit, verdict, kind, reason}"
    )
    add_answer(parser, verbose=False, json=False)
    add_old_spelling(parser, "--figures", "--output")
    add_old_spelling(parser, "--seeds", "--runs", convert=whole)
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="coarse grids, to see that everything runs")
    effort.add_argument("--full", action="store_true", help="finer grids too; takes much longer")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code 0, also if results differ from the published ones."""
    from needleplan.reports.chapters import Effort, Request, reproduce
    from needleplan.reports.comparison import Agreement

    effort = Effort.QUICK if options.quick else Effort.FULL if options.full else Effort.DEFAULT
    folder = Path(options.output) if options.output else None
    with working(options, "reproducing") as tell:

        def told(step: str) -> None:
            note(step)
            tell(step)

        request = Request(folder, effort, told, options.experiments, options.runs)
        comparisons = reproduce(options.chapters, request, require_new=partial(require_free, options))
    if options.json:
        print_json([_document(each) for each in comparisons])
    else:
        for line in (*_lines(comparisons), *_counts(comparisons)):
            print(line)
    missed = sum(each.verdict is Agreement.MISSED for each in comparisons)
    if missed:
        note(
            f"{missed} of {sum(each.verdict in (Agreement.MET, Agreement.MISSED) for each in comparisons)} goals missed"
        )
    return 0


def _document(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as a JSON object: the kind stands behind the verdict, the reason last."""
    document = asdict(comparison)
    return document | {"reason": document.pop("reason")}


def _counts(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Yield a table with the number of comparisons by verdict and kind."""
    from needleplan.reports.comparison import by_evidence

    yield ""
    yield "verdicts by kind"
    for verdict, kinds in by_evidence(comparisons).items():
        parts = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if str(kind) != str(verdict))
        yield f"  {verdict:<22} {sum(kinds.values()):>4}" + (f"  {parts}" if parts else "")


def _lines(comparisons: Iterable[Comparison]) -> Iterator[str]:
    """Yield the lines of a table for every section. A reason shared by several rows is printed once below the table."""
    for section, group in groupby(comparisons, key=lambda each: "/".join(each.id.split("/")[:2])):
        rows = list(group)
        shared = [reason for reason, times in Counter(row.reason for row in rows).items() if reason and times > 1]
        yield ""
        yield section
        if not all(_spoken(row) for row in rows):
            yield f"  {'':{_NAME}} {'published':>{_NUMBER}} {'ours':>{_NUMBER}} {'ratio':>9}  {'unit':<14} verdict"
        for row in rows:
            note = (
                f" [{shared.index(row.reason) + 1}]"
                if row.reason in shared
                else f"; {row.reason}"
                if row.reason
                else ""
            )
            yield from _row(row, row.id.removeprefix(f"{section}/"), f"{_verdict(row)}{note}")
        yield from (f"  [{number}] {reason}" for number, reason in enumerate(shared, start=1))


def _verdict(row: Comparison) -> str:
    """Return the verdict with its kind in brackets."""
    return row.verdict if str(row.verdict) == str(row.kind) else f"{row.verdict} ({row.kind})"


def _row(row: Comparison, name: str, verdict: str) -> Iterator[str]:
    if not _spoken(row):
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        numbers = f"{_number(row.published):>{_NUMBER}} {_number(row.ours):>{_NUMBER}} {ratio:>9}"
        yield f"  {name:<{_NAME}} {numbers}  {row.unit:<14} {verdict}"
    elif row.published is None:
        yield f"  {name}: {row.ours}; {verdict}"
    else:
        yield f"  {name}: {verdict}"
        yield f"      published  {row.published}"
        yield f"      ours       {'-' if row.ours is None else row.ours}"


def _spoken(row: Comparison) -> bool:
    return isinstance(row.published, str) or isinstance(row.ours, str)


def _number(number: float | str | None) -> str:
    if number is None or isinstance(number, str):
        return number or "-"
    if number == int(number):
        return f"{int(number):,}"
    return f"{number:,.1f}" if abs(number) >= 1000 else f"{number:.4g}"
