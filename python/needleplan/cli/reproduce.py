"""`needleplan reproduce`: compare computed with published results."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, print_json, working
from needleplan.cli.options import add_answer, add_output, require_free
from needleplan.cli.parser import Parser, whole

if TYPE_CHECKING:
    from needleplan.reports.comparison import Comparison

__all__ = ["add_to", "run"]

# Widths of the columns for names and numbers (characters).
_NAME, _NUMBER = 58, 14

# Title of a table and heading of its first column, by origin; context stands in the tables of the thesis.
_TITLES = {"thesis": "", "earlier computation": "beside an earlier computation of this project",
           "own goal": "goals of this project", "none": ""}  # fmt: skip
_COLUMNS = {"": "thesis", _TITLES["earlier computation"]: "earlier", _TITLES["own goal"]: "goal"}
# Heading of the counts, by origin.
_COUNTED = {
    "thesis": "compared with the thesis: verdicts by kind",
    "earlier computation": "compared with an earlier computation of this project: no evidence about the thesis",
    "own goal": "goals of this project: no evidence about the thesis",
    "none": "context, compared with nothing",
}


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: Parser = commands.add_parser(
        "reproduce",
        help="print published results beside computed ones",
        description="Print published results beside computed ones, and write the figures. The exit code is 0 also if a "
        "published statement does not hold.",
    )
    parser.add_argument(
        "chapters",
        nargs="*",
        metavar="CHAPTER",
        help="ch2, ch3, ch4, ch5, ch6, diagnosis (default: all)",
    )
    add_output(parser, "DIR", "write figures and results into this folder")
    parser.add_argument(
        "--experiments", action="store_true", help="ch6: repeat the experiments of section 6.5 in the lab twin"
    )
    parser.add_argument(
        "--runs",
        type=whole,
        metavar="N",
        help="number of insertions of each hidden effect, for diagnosis (default: 40)",
    )
    parser.add_argument(
        "--json", action="store_true", help="print a list of {id, published, ours, unit, verdict, kind, reason}"
    )
    add_answer(parser, verbose=False, json=False)
    parser.rename("--figures", "--output")
    parser.rename("--seeds", "--runs")
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
        print_json([_document(comparison) for comparison in comparisons])
    else:
        for line in (*_lines(comparisons), *_counts(comparisons)):
            print(line)
    missed = sum(comparison.verdict is Agreement.MISSED for comparison in comparisons)
    if missed:
        goals = sum(comparison.verdict in (Agreement.MET, Agreement.MISSED) for comparison in comparisons)
        note(f"{missed} of {goals} goals missed")
    return 0


def _document(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as a JSON object. `published` is null unless the thesis prints the figure."""
    from needleplan.reports.comparison import Agreement, Origin

    earlier = comparison.origin is Origin.EARLIER
    return {
        "id": comparison.id,
        "published": None if earlier else comparison.published,
        "earlier": comparison.published if earlier else None,
        "ours": comparison.ours,
        "unit": comparison.unit,
        "verdict": comparison.verdict,
        "factor": comparison.factor if comparison.verdict is Agreement.SAME_ORDER else None,
        "kind": comparison.kind,
        "origin": comparison.origin,
        "source": comparison.source,
        "reason": comparison.reason,
    }


def _counts(comparisons: Sequence[Comparison]) -> Iterator[str]:
    """Yield a table for each origin with the number of comparisons by verdict and kind."""
    from needleplan.reports.comparison import SAME_ORDER_FACTOR, Origin, by_evidence

    for origin in Origin:
        rows = [row for row in comparisons if row.origin is origin]
        if rows:
            yield ""
            yield _COUNTED[origin]
        for verdict, kinds in by_evidence(rows).items():
            parts = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if str(kind) != str(verdict))
            yield f"  {verdict:<22} {sum(kinds.values()):>4}" + (f"  {parts}" if parts else "")
    yield ""
    yield f"same order: two numbers within a factor of {SAME_ORDER_FACTOR:g}; each row prints its factor"


def _lines(comparisons: Iterable[Comparison]) -> Iterator[str]:
    """Yield the lines of a table for every section and origin.

    A reason shared by several rows is printed once below the table.
    """
    for section, group in groupby(comparisons, key=lambda each: "/".join(each.id.split("/")[:2])):
        members = list(group)
        for title in dict.fromkeys(_TITLES[row.origin] for row in members):
            yield from _table(section, title, [row for row in members if _TITLES[row.origin] == title])


def _table(section: str, title: str, rows: Sequence[Comparison]) -> Iterator[str]:
    """Yield the lines of a table of comparisons with the same kind of origin."""
    heading = _COLUMNS[title]
    shared = [reason for reason, times in Counter(row.reason for row in rows).items() if reason and times > 1]
    yield ""
    yield f"{section}, {title}" if title else section
    if not all(_spoken(row) for row in rows):
        yield f"  {'':{_NAME}} {heading:>{_NUMBER}} {'ours':>{_NUMBER}} {'ratio':>9}  {'unit':<14} verdict"
    for row in rows:
        note = f" [{shared.index(row.reason) + 1}]" if row.reason in shared else f"; {row.reason}" if row.reason else ""
        yield from _row(row, row.id.removeprefix(f"{section}/"), heading, f"{_verdict(row)}{note}")
    if sources := {row.source.partition(":")[0]: None for row in rows if row.source}:
        yield f"  source: {'; '.join(sources)}"
    yield from (f"  [{number}] {reason}" for number, reason in enumerate(shared, start=1))


def _verdict(row: Comparison) -> str:
    """Return the verdict with its kind in brackets, and with the factor of the same order."""
    from needleplan.reports.comparison import Agreement

    verdict = f"{row.verdict}"
    if row.verdict is Agreement.SAME_ORDER and row.factor:
        verdict += f", factor {row.factor:.2f}"
    return verdict if str(row.verdict) == str(row.kind) else f"{verdict} ({row.kind})"


def _row(row: Comparison, name: str, heading: str, verdict: str) -> Iterator[str]:
    if not _spoken(row):
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        numbers = f"{_number(row.published):>{_NUMBER}} {_number(row.ours):>{_NUMBER}} {ratio:>9}"
        yield f"  {name:<{_NAME}} {numbers}  {row.unit:<14} {verdict}"
    elif row.published is None:
        yield f"  {name}: {row.ours}; {verdict}"
    else:
        yield f"  {name}: {verdict}"
        yield f"      {heading:<10} {row.published}"
        yield f"      {'ours':<10} {'-' if row.ours is None else row.ours}"


def _spoken(row: Comparison) -> bool:
    return isinstance(row.published, str) or isinstance(row.ours, str)


def _number(number: float | str | None) -> str:
    if number is None or isinstance(number, str):
        return number or "-"
    if number == int(number):
        return f"{int(number):,}"
    return f"{number:,.1f}" if abs(number) >= 1000 else f"{number:.4g}"
