"""Everything of chapter 2, in the order of the chapter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from needleplan.reports.chapters import Effort
from needleplan_thesis.chapter2.bank_table import tables_2_1_and_2_2
from needleplan_thesis.chapter2.figures import draw_all
from needleplan_thesis.chapter2.parameters import forward, loops, robust_starts, table_2_3_and_loops

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "run"]

_STARTS = {Effort.QUICK: 2, Effort.DEFAULT: 8, Effort.FULL: 32}
_ROBUST = {Effort.QUICK: 0, Effort.DEFAULT: 2, Effort.FULL: 32}


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into its folder."""
    return tuple(f"fig_2_{number}.png" for number in range(2, 10))


def run(request: Request) -> list[Comparison]:
    """Reproduce the chapter; figures where there is a folder."""
    comparisons = forward()
    request.note("chapter 2: the bank of filters as published")
    comparisons += tables_2_1_and_2_2(_STARTS[request.effort])
    request.note("chapter 2: identification of the five combinations")
    made = loops()
    comparisons += table_2_3_and_loops(made)
    if count := _ROBUST[request.effort]:
        request.note("chapter 2: starts that are far off")
        comparisons += robust_starts(count)
    if request.folder:
        request.note("chapter 2: figures")
        draw_all(made, request.folder)
    return comparisons
