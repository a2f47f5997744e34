"""Entry point of `needleplan reproduce ch2`: all comparisons and figures, in the order of the chapter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from needleplan.reports.chapters import Effort
from needleplan_thesis.chapter2.bank_table import tables_2_1_and_2_2
from needleplan_thesis.chapter2.figures import draw_figures
from needleplan_thesis.chapter2.parameters import forward, identified_forces, robust_starts, table_2_3_and_open_loops
from needleplan_thesis.citations import cited

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "run"]

# Number of starting values by effort: for the bank, and for the joint filter.
_STARTS = {Effort.QUICK: 2, Effort.DEFAULT: 8, Effort.FULL: 32}
_ROBUST = {Effort.QUICK: 0, Effort.DEFAULT: 2, Effort.FULL: 32}


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into the output folder."""
    return tuple(f"fig_2_{number}.png" for number in range(2, 10))


def run(request: Request) -> list[Comparison]:
    """Return the comparisons of the chapter; draw the figures if the request names a folder."""
    comparisons = forward()
    request.note("chapter 2: the published bank of filters")
    comparisons += tables_2_1_and_2_2(_STARTS[request.effort])
    request.note("chapter 2: identification of the five combinations")
    identified = identified_forces()
    comparisons += table_2_3_and_open_loops(identified)
    if count := _ROBUST[request.effort]:
        request.note("chapter 2: starting values far from the truth")
        comparisons += robust_starts(count)
    if request.folder:
        request.note("chapter 2: figures")
        draw_figures(identified, request.folder)
    return cited(comparisons)
